"""The free rotor by quaternions: q = p(0)^-1 y p(t), where p turns the momentum to axis 3, and y turns about axis 3.

The smallest rotation of the momentum to axis 3 is p = (1 + x3, x2, -x1, 0)/sqrt(2 (1 + x3)), where x is the unit vector
of the momentum; this is the half-angle form of equations (33) to (37) of Celledoni et al. Each of their choices of p
differs from the smallest rotation by a rotation through an angle theta about axis 3. Such rotations commute with y, so
that the angle psi of y increases by theta(t) - theta(0).

Domain: the three moments differ, and the momentum is nonzero and neither on a principal axis nor on the separatrix.
Bodies outside of this domain use the `exact` flow.

E. Celledoni, F. Fassò, N. Säfström and A. Zanna, sections 2.3 and 2.4, doi:10.1137/070704393. The paper gives equation
(38) and the angle of choice (c) for case (a) only; case (b) is added here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from openmm_exactrb.mathematics.quaternions import multiply
from openmm_exactrb.rotors import euler, rotation
from openmm_exactrb.rotors.euler import Orbit, Phase, ThirdKind, carlson
from openmm_exactrb.rotors.flow import Rotation
from openmm_exactrb.support.types import Array


def kosenko(inertia: Array, third_kind: ThirdKind = carlson) -> Rotation:
    """Return the flow with choice (a) of Celledoni et al., theta = 0: I. I. Kosenko (1998), equation (38).

    The integrand (2T + omega3)/(1 + x3) equals (2T + omega3)(1 - x3)/(1 - x3²). Its part even in x3 gives the integral
    of the third kind of `_precession`, and its odd part gives an inverse tangent. The parameters are those of
    `rotation.rotor`.
    """

    def angle(orbit: Orbit) -> Array:
        change = _inverse_tangent(orbit, orbit.after) - _inverse_tangent(orbit, orbit.before)
        psi: Array = _precession(orbit, third_kind) - _b(orbit) / orbit.rate * orbit.third * change
        return psi

    return _flow(inertia, angle)


def moving_frame(inertia: Array) -> Rotation:
    """Return the flow with choice (b) of Celledoni et al.: the frame (mdot, m x mdot, m), as in `rotors.rotation`."""

    def theta(inertia: Array, x: Array) -> Array:
        v, w, _ = rotation.frame(inertia, x)
        angle: Array = np.arctan2(w[0] - v[1], v[0] + w[1])
        return angle

    def angle(orbit: Orbit) -> Array:
        return rotation.angle(orbit, carlson) + theta(orbit.inertia, orbit.end) - theta(orbit.inertia, orbit.start)

    return _flow(inertia, angle)


def van_zon_schofield(inertia: Array) -> Rotation:
    """Return the flow with choice (c) of Celledoni et al., the frame (m x e3, m x (m x e3), m).

    R. van Zon and J. Schofield, J. Comput. Phys. 225, 145 (2007), doi:10.1016/j.jcp.2006.11.019.
    """

    def angle(orbit: Orbit) -> Array:
        x, y = orbit.start, orbit.end
        psi: Array = _precession(orbit, carlson) + np.arctan2(y[0], y[1]) - np.arctan2(x[0], x[1])
        return psi

    return _flow(inertia, angle)


def _flow(inertia: Array, angle: Callable[[Orbit], Array]) -> Rotation:
    """Return the flow in which y rotates by a given angle psi + theta(t) - theta(0)."""

    def attitude(orbit: Orbit) -> Array:
        p0, p = _smallest_rotation(orbit.start), _smallest_rotation(orbit.end)
        p0[1:] *= -1.0
        half = 0.5 * angle(orbit)
        zero = np.zeros_like(half)
        return multiply(p0, multiply(np.stack([np.cos(half), zero, zero, np.sin(half)]), p))

    return euler.flow_of(inertia, attitude)


def _smallest_rotation(x: Array) -> Array:
    """Return quaternions of the smallest rotations of unit vectors x (3, N) to axis 3: lemma 2.4 with p3 = 0."""
    x1, x2, x3 = x
    # 1 + x3, which cancels where x3 is near -1.
    above = np.where(x3 > -0.5, 1.0 + x3, (x1 * x1 + x2 * x2) / (1.0 - x3))
    p: Array = np.stack([above, x2, -x1, np.zeros_like(x3)]) / np.sqrt(2.0 * above)
    return p


def _precession(orbit: Orbit, third_kind: ThirdKind) -> Array:
    """Return the integral of (2T - x3²/I3)/(1 - x3²) = 1/I3 + (2T - 1/I3)/(1 - x3²).

    In case (a) 1 - x3² = A1² (1 - n sn²) with n = -(A3/A1)²; in case (b) n = -I3 (I2 - I1)/(I1 (I3 - I2)).
    """
    I1, I2, I3 = orbit.inertia
    nc = np.where(orbit.high, 1.0 / orbit.first**2, I2 * (I3 - I1) / (I1 * (I3 - I2)))
    psi: Array = orbit.time / I3 + _b(orbit) / orbit.rate * third_kind(orbit, nc)
    return psi


def _inverse_tangent(orbit: Orbit, phase: Phase) -> Array:
    """Return the integral from 0 to a phase, of cn/(1 - n sn²) in case (a) and of dn/(1 - n sn²) in case (b)."""
    I1, I2, I3 = orbit.inertia
    root_a = np.sqrt(orbit.k2 + (orbit.third / orbit.first) ** 2)
    root_b = np.sqrt(I2 * (I3 - I1) / (I1 * (I3 - I2)))
    return np.where(orbit.high, np.arctan(root_a * phase.sn / phase.dn) / root_a, phase.continued(root_b) / root_b)


def _b(orbit: Orbit) -> Array:
    """Return 1/I1 - 1/I3."""
    I1, _, I3 = orbit.inertia
    difference: Array = (I3 - I1) / (I1 * I3)
    return difference
