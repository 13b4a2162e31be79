"""Stationary averages of splittings with a heat exchange, by quadrature instead of simulation.

A step is a Markov chain in phase space. Its operator on functions is a matrix in polynomials that are orthonormal under
the canonical distribution; the vector that its transpose leaves alone is the stationary distribution. Two
motions are small enough: a particle in the well x⁴/4, with a fast spring in its drifts too, and a linear rotor in a
field. kT, mass and moment are 1.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from openmm_exactrb.schemes.step_errors import _around_exchange
from openmm_exactrb.steps.substeps import Drift


@dataclass(eq=False)
class Motion:
    """Functions of phase space at quadrature nodes z with weights w of the canonical distribution.

    `basis(z)` are functions (nodes, n), orthonormal under w; `exchange` and `flow` (n, n) are the generators of the
    heat exchange (friction 1) and of the exact motion in them. The potential V_s of the kicks has `curvature`
    tr M⁻¹V_s'', `second` v·V_s''v, `square` f_s·M⁻¹f_s and `work` f·M⁻¹f_s.
    """

    z: tuple
    w: np.ndarray
    exchange: np.ndarray
    flow: np.ndarray

    def basis(self, z):
        raise NotImplementedError

    def drift(self, z, t):
        raise NotImplementedError

    def kick(self, z, t, e):
        """Return z after a kick over t by V - e/2 f·M⁻¹f."""
        raise NotImplementedError

    def project(self, f):
        """Return the coefficients of a function that is given at the nodes."""
        return self.basis(self.z).T @ (self.w * f)

    def mean(self, f):
        return float(self.w @ f)

    def covariance(self, f, g):
        return self.mean(f * g) - self.mean(f) * self.mean(g)

    def through(self, z, rows, h):
        for substep, part in rows:
            if isinstance(substep, Drift):
                z = self.drift(z, part * h)
            else:
                z = self.kick(z, part * h, getattr(substep, "strength", 0.0) * (part * h) ** 2)
        return z

    def stationary(self, scheme, h, friction, observables):
        """Return the stationary averages of functions of z at the ends of steps."""
        rates, modes = self.relaxation
        exchange = modes * np.exp(h * friction * rates) @ modes.T
        density = exchange.T @ self.left_alone(exchange @ self.motion(scheme, h))
        read = self.through(self.z, _around_exchange(scheme)[0], h)
        weight = self.basis(self.z) @ density * self.w
        return np.array([weight @ f(read) for f in observables])

    @cached_property
    def relaxation(self):
        """Return eigenvalues and eigenvectors of the exchange, which is symmetric in an orthonormal basis."""
        np.testing.assert_allclose(self.exchange, self.exchange.T, atol=1e-12)
        return np.linalg.eigh(self.exchange)

    @lru_cache(maxsize=3)  # noqa: B019  # motions live as long as the tests
    def motion(self, scheme, h):
        """Return the operator of the motion between two exchanges."""
        moved = self.basis(self.through(self.z, sum(_around_exchange(scheme), ()), h))
        return (self.basis(self.z) * self.w[:, None]).T @ moved

    def left_alone(self, step):
        """Return the density, in the basis, that a step leaves alone."""
        # The first function is 1.
        return np.concatenate([[1.0], np.linalg.solve(np.eye(len(step) - 1) - step.T[1:, 1:], step.T[1:, 0])])

    def remaining(self, friction, source):
        """Return phi, at the nodes, of (friction * exchange - flow) phi = source."""
        operator = friction * self.exchange - self.flow
        phi = np.linalg.solve(operator[1:, 1:], self.project(source)[1:])
        return self.basis(self.z)[:, 1:] @ phi


class Quartic(Motion):
    """A particle in the well x⁴/4, whose drifts have the force of a spring in them: -spring x."""

    freedom, ricci = 1, 0.0

    def __init__(self, spring=0.0, degree=24, nodes=48):
        self.spring = spring
        x, wx, self._a, self._b = _gauss(lambda x: np.exp(-0.25 * x**4 - 0.5 * spring * x**2), 6.0, nodes)
        p, wp = np.polynomial.hermite_e.hermegauss(nodes)
        self.degree = degree
        pairs = np.meshgrid(x, p, indexing="ij")
        self.z, self.w = tuple(a.ravel() for a in pairs), np.outer(wx, wp / wp.sum()).ravel()
        of_x, slopes = self._polynomials(x)
        derivative = (of_x * wx[:, None]).T @ slopes
        lower = np.diag(np.sqrt(np.arange(1.0, degree)), 1)
        eye = np.eye(degree)
        self.exchange = -np.kron(eye, lower.T @ lower)
        # v d/dx - V' d/dp in both orthonormal families: the ladder of one times the other's transpose.
        self.flow = np.kron(derivative, lower.T) - np.kron(derivative.T, lower)

    def _polynomials(self, x):
        """Return the orthonormal polynomials of x, and their slopes."""
        n = self.degree
        values, slopes = np.zeros((len(x), n)), np.zeros((len(x), n))
        values[:, 0] = 1.0
        for k in range(n - 1):
            values[:, k + 1] = (x - self._a[k]) * values[:, k] - (self._b[k - 1] * values[:, k - 1] if k else 0.0)
            slopes[:, k + 1] = (
                values[:, k] + (x - self._a[k]) * slopes[:, k] - (self._b[k - 1] * slopes[:, k - 1] if k else 0.0)
            )
            values[:, k + 1] /= self._b[k]
            slopes[:, k + 1] /= self._b[k]
        return values, slopes

    def basis(self, z):
        x, p = z
        of_p = np.zeros((len(p), self.degree))
        of_p[:, 0], of_p[:, 1] = 1.0, p
        for k in range(1, self.degree - 1):
            of_p[:, k + 1] = (p * of_p[:, k] - np.sqrt(k) * of_p[:, k - 1]) / np.sqrt(k + 1.0)
        return (self._polynomials(x)[0][:, :, None] * of_p[:, None, :]).reshape(len(x), -1)

    def drift(self, z, t):
        w = np.sqrt(self.spring)
        over = t * np.sinc(w * t / np.pi)
        return z[0] * np.cos(w * t) + z[1] * over, z[1] * np.cos(w * t) - z[0] * w * w * over

    def kick(self, z, t, e):
        return z[0], z[1] - t * (z[0] ** 3 - e * 3.0 * z[0] ** 5)

    # Functions of z; the second of an observable is its slope along M⁻¹f_s.
    observables = (
        (lambda z: z[0] ** 2, lambda z: -2.0 * z[0] ** 4),
        (lambda z: 0.25 * z[0] ** 4, lambda z: -(z[0] ** 6)),
        (lambda z: z[0] ** 6, lambda z: -6.0 * z[0] ** 8),
    )

    def potential(self, z):
        return 0.25 * z[0] ** 4 + 0.5 * self.spring * z[0] ** 2

    def curvature(self, z):
        return 3.0 * z[0] ** 2

    def second(self, z):
        return 3.0 * z[0] ** 2 * z[1] ** 2

    def square(self, z):
        return z[0] ** 6

    def work(self, z):
        return z[0] ** 6 + self.spring * z[0] ** 4


class Rotor(Motion):
    """A linear rotor of the moment 1 in a field: V = -mu u, where u is the cosine to the field.

    Functions of u, of its rate s, and of e, the square of the angular velocity, are closed under its motion.
    """

    freedom, ricci = 2, 1.0

    def __init__(self, mu=2.0, degree=11, nodes=18):
        self.mu = mu
        u, wu, *_ = _gauss(lambda u: np.exp(mu * u), 1.0, nodes)
        p, wp = np.polynomial.hermite_e.hermegauss(nodes)
        wp = wp / wp.sum()
        u, along, across = (a.ravel() for a in np.meshgrid(u, p, p, indexing="ij"))
        self.w = (wu[:, None, None] * wp[:, None] * wp).ravel()
        self.z = u, np.sqrt(1.0 - u * u) * along, along**2 + across**2
        powers = [
            (a, b, c)
            for a in range(degree + 1)
            for b in range(degree + 1 - a)
            for c in range((degree - a - b) // 2 + 1)
        ]
        powers.sort(key=lambda abc: (abc[0] + abc[1] + 2 * abc[2], abc))
        self.powers = np.array(powers)
        values = self._monomials(self.z)
        _, triangle = np.linalg.qr(np.sqrt(self.w)[:, None] * values)
        triangle *= np.sign(np.diag(triangle))[:, None]
        self.transform = np.linalg.inv(triangle)
        (fu, fs, fe), (u, s, e) = self._slopes(self.z), self.z
        # <grad_w b_i . grad_w b_j>, where grad_w s is the field's tangent and grad_w e twice the angular velocity.
        cross = fs.T @ (self.w[:, None] * 2.0 * s[:, None] * fe)
        own = fs.T @ ((self.w * (1.0 - u * u))[:, None] * fs) + fe.T @ ((self.w * 4.0 * e)[:, None] * fe)
        self.exchange = -(own + cross + cross.T)
        moved = s[:, None] * fu + (mu * (1.0 - u * u) - e * u)[:, None] * fs + (2.0 * mu * s)[:, None] * fe
        self.flow = (self.basis(self.z) * self.w[:, None]).T @ moved

    def _monomials(self, z):
        (a, b, c), (u, s, q) = self.powers.T, self._powers(z)
        return u[:, a] * s[:, b] * q[:, c]

    def _powers(self, z):
        u, s, e = z
        return [x[:, None] ** np.arange(self.powers.max() + 1) for x in (u, s, 0.25 * e)]

    def _slopes(self, z):
        """Return the slopes of the basis in u, s and e."""
        (a, b, c), (u, s, q) = self.powers.T, self._powers(z)
        fu = a * u[:, np.maximum(a - 1, 0)] * s[:, b] * q[:, c]
        fs = b * u[:, a] * s[:, np.maximum(b - 1, 0)] * q[:, c]
        fe = 0.25 * c * u[:, a] * s[:, b] * q[:, np.maximum(c - 1, 0)]
        return tuple(f @ self.transform for f in (fu, fs, fe))

    def basis(self, z):
        return self._monomials(z) @ self.transform

    def drift(self, z, t):
        u, s, e = z
        w = np.sqrt(e)
        over = t * np.sinc(w * t / np.pi)
        return u * np.cos(w * t) + s * over, s * np.cos(w * t) - u * e * over, e

    def kick(self, z, t, e):
        u, s, square = z
        field = t * (self.mu - e * self.mu**2 * u)
        push = field * (1.0 - u * u)
        return u, s + push, square + 2.0 * field * s + field * push

    def through_chord(self, h, friction, nodes=4):
        """Return the means of the basis after the kick and the drift of LangevinMiddleIntegrator, by quadrature."""
        u, s, e = self.kick(self.z, h, 0.0)
        side = np.sqrt(1.0 - u * u)
        x, up, across = np.stack([side, 0 * u, u]), np.stack([-u, 0 * u, side]), np.stack([0 * u, 0 * u + 1.0, 0 * u])
        v = s / side * up + np.sqrt(np.maximum(e - (s / side) ** 2, 0.0)) * across
        decay = np.exp(-h * friction)
        noise, weights = np.polynomial.hermite_e.hermegauss(nodes)
        means = 0.0
        for i, j, k in np.ndindex(nodes, nodes, nodes):
            after = decay * v + np.sqrt(1.0 - decay**2) * (noise[i] * x + noise[j] * up + noise[k] * across)
            (_, _, z), (*_, s), e = (lambda n, w: (n, w, (w * w).sum(axis=0)))(*chord(x, v, after, h))
            means = means + weights[[i, j, k]].prod() / weights.sum() ** 3 * self.basis((z, s, e))
        return means

    @property
    def observables(self):
        mu = self.mu
        return (
            (lambda z: z[0], lambda z: mu * (1.0 - z[0] ** 2)),
            (lambda z: z[0] ** 2, lambda z: 2.0 * mu * z[0] * (1.0 - z[0] ** 2)),
        )

    def potential(self, z):
        return -self.mu * z[0]

    def curvature(self, z):
        return 2.0 * self.mu * z[0]

    def second(self, z):
        return self.mu * z[0] * z[2]

    def square(self, z):
        return self.mu**2 * (1.0 - z[0] ** 2)

    work = square


def chord(x, v, after, h):
    """Return the place (3, n) on the unit sphere and the velocity behind a drift of LangevinMiddleIntegrator.

    Half of it has the velocity v and half the one after the heat exchange, which may leave the sphere.
    """
    way = 0.5 * h * (v + after)
    along = way - (way * x).sum(axis=0) * x
    n = np.sqrt(1.0 - (along**2).sum(axis=0)) * x + along
    w = after + (n - x - way) / h
    return n, w - (w * n).sum(axis=0) * n


def _gauss(weight, edge, n):
    """Return nodes and weights of n-point Gauss quadrature, and the recurrence of its orthonormal polynomials."""
    x, w = np.polynomial.legendre.leggauss(400)
    x = edge * x
    w = w * weight(x)
    w /= w.sum()
    vectors = [np.ones_like(x)]
    a, b = [], []
    for _ in range(n):
        v = vectors[-1]
        a.append(w @ (x * v * v))
        r = (x - a[-1]) * v
        for q in vectors:  # once more than needed: the recurrence alone loses orthogonality
            r = r - (w @ (q * r)) * q
        b.append(np.sqrt(w @ (r * r)))
        vectors.append(r / b[-1])
    nodes, eigenvectors = np.linalg.eigh(np.diag(a) + np.diag(b[: n - 1], 1) + np.diag(b[: n - 1], -1))
    return nodes, eigenvectors[0] ** 2, np.array(a), np.array(b)
