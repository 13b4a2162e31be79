"""The momentum of a free rigid body in Jacobi's elliptic functions, shared by all formulations of Celledoni et al.

Let I1 < I2 < I3 and x = m/norm(m). In case (a), 2T I2 > 1, the momentum circles axis j = 1, and l is 3. In case (b), 2T
I2 < 1, the momentum circles axis j = 3, and l is 1. A half turn about a principal axis makes x1, x3 >= 0. Both signs in
equations (5) and (6) are then plus: x_j = A_j dn u, x2 = A2 sn u, x_l = A_l cn u, u = u0 + lambda t.

E. Celledoni, F. Fassò, N. Säfström and A. Zanna, section 2.1, doi:10.1137/070704393. The paper's 1 - 2T I_i and 1 - k²
are computed here without cancellation, except for 1 - 2T I2, which vanishes on the separatrix. At a relative distance S
from the separatrix, a step in which the momentum passes the middle axis has an error of up to about eps h
norm(omega)/S; the `exact` flow does not have this error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mathematics.compensated import keep_norm
from openmm_exactrb.mathematics.elliptic import jacobi, third_kind_legendre
from openmm_exactrb.mathematics.quaternions import multiply, renormalise
from openmm_exactrb.rotors import exact
from openmm_exactrb.rotors.closed_form import SAFE
from openmm_exactrb.rotors.flow import Rotation, ascending
from openmm_exactrb.support.types import Array

#: Bodies within this relative distance of symmetry, the separatrix or stationary rotation use the exact flow.
NEAREST = 1e-14


@dataclass(frozen=True)
class Phase:
    """Jacobi's functions of the phase u at one time, and the integer nearest to u / 2K (odd where cn is negative)."""

    sn: Array
    cn: Array
    dn: Array
    half_turns: Array

    def continued(self, ratio: Array | float = 1.0) -> Array:
        """Return atan(ratio sn/cn) for a positive ratio, continued past half periods; a ratio of one gives am u."""
        folded = np.where(self.cn < 0.0, -self.sn, self.sn)
        return self.half_turns * np.pi + np.arctan2(ratio * folded, np.abs(self.cn))


@dataclass(frozen=True)
class Orbit:
    """Bodies during a step, in units with norm(m) = 1; arrays are (N,) unless another shape is stated."""

    inertia: Array  #: moments in ascending order, (3, 1) or (3, N)
    time: Array  #: the step times norm(m)
    start: Array  #: unit momenta at the start, (3, N)
    end: Array  #: unit momenta at the end, (3, N)
    energy: Array  #: 2T of the unit momentum
    excess: Array  #: 1 - 2T I2: negative in case (a), positive in case (b)
    first: Array  #: the largest value A1 of x1 on the orbit
    third: Array  #: the largest value A3 of x3 on the orbit
    rate: Array  #: lambda of equations (5) and (6), positive
    k2: Array  #: k²
    kc2: Array  #: 1 - k²
    before: Phase
    after: Phase

    @property
    def high(self) -> NDArray[np.bool_]:
        """A mask (N,) of the bodies in case (a)."""
        return self.excess < 0.0


#: third_kind(orbit, nc): the difference over the step of Legendre's integral of the third kind, with 1 - n = nc.
ThirdKind = Callable[[Orbit, Array], Array]
#: A function of an orbit: the rotation of the step as a quaternion (4, N), not yet renormalised.
Attitude = Callable[[Orbit], Array]


def flow_of(inertia: Array, attitude: Attitude) -> Rotation:
    """Return the flow for moments (3, 1) or (3, N), with momenta by Jacobi's solution and rotations by `attitude`.

    Bodies for which Jacobi's solution is singular use the exact flow: see `is_regular`.
    """
    order, back, handedness = ascending(inertia)
    scale = np.ldexp(1.0, np.frexp(inertia.max(axis=0))[1])
    moments = np.take_along_axis(inertia, order, axis=0) / scale
    shared = inertia.shape[1] == 1

    def regular_flow(q: Array, m: Array, t: Array, chosen: NDArray[np.bool_]) -> tuple[Array, Array]:
        places, replaces = (np.broadcast_to(p if shared else p[:, chosen], m.shape) for p in (order, back))
        hand, unit, body = (a if shared else a[..., chosen] for a in (handedness, scale, moments))
        turn, m1 = _step(body, np.take_along_axis(m, places, axis=0) * hand, t / unit, attitude)
        turn[1:] = np.take_along_axis(turn[1:], replaces, axis=0) * hand
        return renormalise(multiply(q, turn)), np.take_along_axis(m1, replaces, axis=0) * hand

    def flow(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        t = np.broadcast_to(t, m.shape[1:])
        sorted_m = np.take_along_axis(m, np.broadcast_to(order, m.shape), axis=0)
        regular = is_regular(moments, sorted_m)
        if regular.all():
            return regular_flow(q, m, t, regular)
        q1, m1 = np.empty_like(q), np.empty_like(m)
        q1[:, regular], m1[:, regular] = regular_flow(q[:, regular], m[:, regular], t[regular], regular)
        other = ~regular
        rest = inertia if shared else inertia[:, other]
        q1[:, other], m1[:, other] = exact.in_numpy(rest)(q[:, other], m[:, other], t[other])
        return q1, m1

    return flow


def is_regular(inertia: Array, m: Array) -> NDArray[np.bool_]:
    """Return a mask (N,) of the bodies that Jacobi's solution covers, for ascending moments and momenta m (3, N).

    The three moments of such a body differ by more than a relative distance of `NEAREST`. Its momentum is finite and
    nonzero, and is more than this distance away from the principal axes and from the separatrix.
    """
    I1, I2, I3 = inertia
    with np.errstate(all="ignore"):
        G = np.sqrt(np.einsum("in,in->n", m, m))
        safe = (SAFE[0] < G) & (SAFE[1] > G)
        x1, x2, x3 = np.abs(m / np.where(safe, G, 1.0))
    asymmetric = (I2 - I1 > NEAREST * I3) & (I3 - I2 > NEAREST * I3)
    moving = x1 * x2 + x2 * x3 + x3 * x1 > NEAREST
    one, three = x1 * x1 * (I2 - I1) * I3, x3 * x3 * (I3 - I2) * I1
    off_separatrix = np.abs(one - three) > NEAREST * (one + three)
    regular: NDArray[np.bool_] = safe & asymmetric & moving & off_separatrix
    return regular


def carlson(orbit: Orbit, nc: Array) -> Array:
    """Return the exact difference of the integral of the third kind over the step, by Carlson's R_J."""
    before, after = (
        third_kind_legendre(phase.sn, phase.cn, phase.dn, phase.half_turns, orbit.kc2, nc)
        for phase in (orbit.before, orbit.after)
    )
    return orbit.rate * orbit.time + (after - before)


def gauss(points: int) -> ThirdKind:
    """Return a `ThirdKind` that integrates over the amplitude by Gauss's rule with `points` points: equation (39).

    The error is of order 2 points + 1 in the step. This error is large if the amplitude changes by more than about one
    radian during the step; near the separatrix, smaller changes suffice.
    """
    nodes, weights = np.polynomial.legendre.leggauss(points)
    nodes, weights = 0.5 * (1.0 + nodes[:, None]), 0.5 * weights

    def third_kind(orbit: Orbit, nc: Array) -> Array:
        start = orbit.before.continued()
        change = orbit.after.continued() - start
        angle = start + nodes * change
        sine2, cosine2 = np.sin(angle) ** 2, np.cos(angle) ** 2
        rule: Array = weights @ (1.0 / ((cosine2 + nc * sine2) * np.sqrt(cosine2 + orbit.kc2 * sine2)))
        return change * rule

    return third_kind


def _step(inertia: Array, m: Array, t: Array, attitude: Attitude) -> tuple[Array, Array]:
    """Return the rotation of the step as a quaternion (4, N) and the new momentum, in sorted principal axes."""
    G = np.sqrt(np.einsum("in,in->n", m, m))
    half_turn = np.copysign(1.0, m)
    half_turn[1] = half_turn[0] * half_turn[2]
    orbit = solve(inertia, half_turn * m / G, G * t)
    turn = attitude(orbit)
    turn[1:] *= half_turn
    return turn, keep_norm(G * half_turn * orbit.end, m, G * G)


def solve(inertia: Array, x: Array, time: Array) -> Orbit:
    """Solve Euler's equations (4) to (8) for unit momenta x (3, N) with x1, x3 >= 0 and ascending moments."""
    from scipy.special import elliprf  # imported here, because it is slow to import

    I1, I2, I3 = inertia
    x1, x2, x3 = x
    a1_squared = x1 * x1 * (I3 - I1) / I1 + x2 * x2 * (I3 - I2) / I2  # 2T I3 - 1
    a3_squared = x3 * x3 * (I3 - I1) / I3 + x2 * x2 * (I2 - I1) / I2  # 1 - 2T I1
    energy = x1 * x1 / I1 + x2 * x2 / I2 + x3 * x3 / I3
    excess = x3 * x3 * (I3 - I2) / I3 - x1 * x1 * (I2 - I1) / I1  # 1 - 2T I2
    high = excess < 0.0
    first, third = np.sqrt(I1 * a1_squared / (I3 - I1)), np.sqrt(I3 * a3_squared / (I3 - I1))
    second = np.sqrt(I2 * np.where(high, a3_squared / (I2 - I1), a1_squared / (I3 - I2)))
    drive = np.where(high, a1_squared * (I2 - I1), a3_squared * (I3 - I2))
    rate = np.sqrt(drive / (I1 * I2 * I3))
    k2 = np.where(high, a3_squared * (I3 - I2), a1_squared * (I2 - I1)) / drive
    kc2 = np.minimum(np.abs(excess) * (I3 - I1) / drive, 1.0)

    sn, cn = x2 / second, np.where(high, x3 / third, x1 / first)
    norm = np.hypot(sn, cn)
    sn, cn = sn / norm, cn / norm
    dn = np.sqrt(cn * cn + kc2 * sn * sn)
    before = Phase(sn, cn, dn, np.zeros_like(sn))
    after = Phase(*jacobi(sn * elliprf(cn * cn, dn * dn, 1.0) + rate * time, kc2))

    x1, x3 = first * np.where(high, after.dn, after.cn), third * np.where(high, after.cn, after.dn)
    end = np.stack([x1, second * after.sn, x3])
    return Orbit(inertia, time, x, renormalise(end), energy, excess, first, third, rate, k2, kc2, before, after)
