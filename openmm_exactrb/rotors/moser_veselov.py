"""The preprocessed discrete Moser-Veselov algorithm, of orders 6, 8 and 10.

The discrete algorithm reproduces the exact motion of a free body with other moments of inertia and another time. The
algorithm therefore receives modified moments, 1/I~_i = s/I_i + d, with series s = 1 + ... and d = ... in the step. The
norm of the angular momentum, the angular momentum in the space frame and the kinetic energy are conserved to roundoff.

Domain: any moments and momenta, and steps that rotate the body by less than a quarter turn, h norm(I^-1 m) < pi/2. The
equations of a longer step have only a spurious root, far from the solution. The step is implicit; the fixed-point
iteration that solves its equations converges slowly near this limit. The results of a body are nan if the iteration
does not converge within `MOST_ITERATIONS`, the body rotates too far, or its modified moments are not positive; a
`NotConvergedWarning` states the number of such bodies. Convergence does not imply that the error of the series is
small; this error grows as the power `order` of the step.

E. Hairer and G. Vilmart, J. Phys. A 39, 13225 (2006), doi:10.1088/0305-4470/39/42/006.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.errors import NotConvergedWarning
from openmm_exactrb.mathematics.compensated import keep_norm
from openmm_exactrb.mathematics.quaternions import multiply, renormalise
from openmm_exactrb.rotors.flow import Rotation
from openmm_exactrb.support.types import Array
from openmm_exactrb.support.warn import warn

#: Number of fixed-point iterations after which a body is considered not converged.
MOST_ITERATIONS = 200
# The iteration ends when its last change is below this fraction of the momentum.
_CONVERGED = 1e-15
_QUARTER_TURN = 0.5 * np.pi


def rotor(order: int) -> Callable[[Array], Rotation]:
    """Return the factory of the preprocessed discrete Moser-Veselov flow of order 4, 6, 8 or 10."""

    def factory(inertia: Array) -> Rotation:
        scale = np.ldexp(1.0, np.frexp(inertia.max(axis=0))[1])
        moments = inertia / scale
        series = _series(moments, order)

        def flow(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
            # Powers of two avoid over- and underflow of the squares of momenta.
            exponent = np.frexp(np.abs(m).max(axis=0))[1]
            unit, h = np.ldexp(m, -exponent), np.ldexp(t / scale, exponent)
            with np.errstate(all="ignore"):  # numbers overflow if a step is far too long, which is reported
                inverse = _modified(moments, series, unit, h)
                angle, converged = _iterate(inverse, unit, h)
                turn, unit1 = _step(angle, unit)
                converged &= np.maximum(_turned(moments, unit, h), _turned(moments, unit1, h)) < _QUARTER_TURN
            q1, m1 = renormalise(multiply(q, turn)), np.ldexp(unit1, exponent)
            _report(q1, m1, ~converged & np.isfinite(m).all(axis=0) & np.isfinite(t), order)
            return q1, m1

        return flow

    return factory


def _turned(moments: Array, m: Array, h: Array) -> Array:
    """Return the angles h norm(I^-1 m) (N,) by which bodies rotate in a step, in rad."""
    omega = m / moments
    angle: Array = np.abs(h) * np.sqrt(np.einsum("in,in->n", omega, omega))
    return angle


def _modified(moments: Array, series: Sequence[tuple[Array, Array]], m: Array, h: Array) -> Array:
    """Return the inverse modified moments s/I_i + d (3, N), where s and d are polynomials in C and H; see `_series`."""
    C = 0.5 * np.einsum("in,in->n", m, m) * h * h
    H = 0.5 * np.einsum("in,in->n", m, m / moments) * h * h
    s, d = np.ones_like(C), np.zeros_like(C)
    for terms in series:
        degree = len(terms[0]) - 1
        powers = [C ** (degree - k) * H**k for k in range(degree + 1)]
        s, d = (x + sum(c * p for c, p in zip(t, powers, strict=True)) for x, t in zip((s, d), terms, strict=True))
    inverse: Array = s / moments + d
    return inverse


def _iterate(inverse: Array, m: Array, h: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Solve I~_1 a_1 = alpha h m_1 + (I~_2 - I~_3) a_2 a_3/2 and its cyclic permutations, with alpha = 1 + a.a/4.

    Return a (3, N), which is twice the Cayley vector of the rotation, and a mask (N,) of the converged bodies.
    Converged bodies are not iterated further, so that the result of a body does not depend on other bodies.
    """
    after, before = np.roll(inverse, -1, axis=0), np.roll(inverse, 1, axis=0)
    gyration = 0.5 * (before - after) / (before * after)
    free = h * m
    solution, converged = free.copy(), np.zeros(m.shape[1], dtype=bool)
    active = np.flatnonzero((inverse > 0.0).all(axis=0))
    for _ in range(MOST_ITERATIONS):
        old = solution[:, active]
        angle = inverse[:, active] * old
        alpha = 1.0 + 0.25 * np.einsum("in,in->n", angle, angle)
        new = alpha * free[:, active] + gyration[:, active] * np.roll(angle, -1, axis=0) * np.roll(angle, 1, axis=0)
        solution[:, active] = new
        change, size = np.abs(new - old).max(axis=0), np.abs(new).max(axis=0)
        done = change <= _CONVERGED * size
        converged[active[done]] = True
        active = active[~done & np.isfinite(size)]
        if not active.size:
            break
    return inverse * solution, converged


def _step(angle: Array, m: Array) -> tuple[Array, Array]:
    """Return the Cayley transforms of vectors as quaternions (4, N), and the momenta in the turned body frames."""
    c = 0.5 * angle
    alpha = 1.0 + np.einsum("in,in->n", c, c)
    across = np.cross(m, c, axis=0)
    m1 = m + (across + np.cross(across, c, axis=0)) * (2.0 / alpha)
    square = np.einsum("in,in->n", m, m)
    keep_norm(m1, m, np.where(square > 0.0, square, 1.0))
    return np.concatenate([np.ones((1, m.shape[1])), c]) / np.sqrt(alpha), m1


def _report(q: Array, m: Array, failed: NDArray[np.bool_], order: int) -> None:
    """Set the results of failed bodies to nan, in place, and issue a warning that states the number of these bodies."""
    if not failed.any():
        return
    q[:, failed] = m[:, failed] = np.nan
    warn(
        f"the step is too long for dmv{order}, so results are nan (bodies affected: {np.count_nonzero(failed)} of "
        f"{failed.size}): use a shorter step",
        NotConvergedWarning,
    )


def _series(I: Array, order: int) -> list[tuple[Array, Array]]:
    """Return the terms of s and d of degree 1, 2, ... in C = h² norm(m)²/2 and H = h² T.

    A term of degree k is an array (k + 1, N) or (k + 1, 1): the coefficients of C^k, C^(k-1) H, ..., H^k.
    """
    J, K = np.roll(I, -1, axis=0), np.roll(I, 1, axis=0)
    D = I.prod(axis=0)
    S = [(I**n).sum(axis=0) for n in range(5)]
    X = [(I**-n).sum(axis=0) for n in range(5)]

    def M(a: int, b: int) -> Array:
        total: Array = ((J**a + K**a) / I**b).sum(axis=0)
        return total

    one = np.ones_like(D)
    D2, D3, D4 = D * D, D**3, D**4
    terms = [
        (
            [S[1] / (6 * D), -X[1] / 3],
            [-one / (3 * D), S[1] / (6 * D)],
        ),
        (
            [(S[2] / D - X[1]) / (30 * D), (1 - M(1, 1)) / (30 * D), (3 * S[1] / D + 2 * X[2]) / 60],
            [-S[1] / (60 * D2), X[1] / (10 * D) - S[2] / (60 * D2), -(9 + M(1, 1)) / (60 * D)],
        ),
        (
            [
                (4 * D + 17 * S[3] - 15 * D * M(1, 1)) / (2520 * D3),
                (9 * S[1] + 10 * D * X[2] - 6 * M(2, 1)) / (420 * D2),
                ((6 * M(1, 2) - 100 * X[1]) * D + 53 * S[2]) / (2520 * D2),
                (15 - D * X[3] - 2 * M(1, 1)) / (630 * D),
            ],
            [
                (34 * D * X[1] - 19 * S[2]) / (2520 * D3),
                (S[3] + 2 * D * M(1, 1) - 85 * D) / (1260 * D3),
                (47 * S[1] + 13 * M(2, 1) - 38 * D * X[2]) / (2520 * D2),
                (9 * D * X[1] + D * M(1, 2) - 11 * S[2]) / (1260 * D2),
            ],
        ),
        (
            [
                (62 * S[4] - 94 * D * M(2, 1) + 66 * D2 * X[2] + 81 * D * S[1]) / (45360 * D4),
                (-77 * M(3, 1) + 75 * D * M(1, 2) + 214 * S[2] - 240 * D * X[1]) / (22680 * D3),
                (26 * D * M(2, 2) + 55 * S[3] + 204 * D - 50 * D2 * X[3] - 59 * D * M(1, 1)) / (7560 * D3),
                (137 * D * X[2] - D * M(1, 3) + 3 * S[1] - 69 * M(2, 1)) / (11340 * D2),
                (2 * D2 * X[4] + 5 * D * M(1, 2) - 171 * D * X[1] + 159 * S[2]) / (45360 * D2),
            ],
            [
                (60 * M(1, 1) * D - 61 * S[3] - 247 * D) / (45360 * D4),
                (54 * D * S[1] - S[4] + 218 * D * M(2, 1) - 426 * D2 * X[2]) / (45360 * D4),
                (125 * D * X[1] - 5 * M(3, 1) - 130 * S[2] + 4 * D * M(1, 2)) / (7560 * D3),
                (67 * S[3] - 735 * D - 15 * D * M(2, 2) + 87 * D * M(1, 1) + 34 * D2 * X[3]) / (22680 * D3),
                (165 * S[1] - D * M(1, 3) - 9 * M(2, 1) - 145 * D * X[2]) / (45360 * D2),
            ],
        ),
    ]
    return [(np.stack(s), np.stack(d)) for s, d in terms[: order // 2 - 1]]
