"""The free rotor by rotation matrices: the frame (mdot, m x mdot, m) and one planar angle.

Domain: the three moments differ, and the momentum is nonzero and neither on a principal axis nor on the separatrix.
Bodies outside of this domain, for which the frame or the elliptic functions are singular (symmetric and spherical
bodies, and bodies at rest or in stationary rotation), use the `exact` flow.

E. Celledoni, F. Fassò, N. Säfström and A. Zanna, section 2.2, doi:10.1137/070704393.
"""

from __future__ import annotations

import numpy as np

from openmm_exactrb.mathematics.quaternions import from_matrix
from openmm_exactrb.rotors import euler
from openmm_exactrb.rotors.euler import Orbit, ThirdKind, carlson
from openmm_exactrb.rotors.flow import Rotation
from openmm_exactrb.support.types import Array


def rotor(inertia: Array, third_kind: ThirdKind = carlson) -> Rotation:
    """Return the rotation-matrix flow of free bodies with moments of inertia (3, 1) or (3, N) in any order.

    `third_kind` evaluates the elliptic integral: `euler.carlson`, or a result of `euler.gauss`.
    """

    def attitude(orbit: Orbit) -> Array:
        psi = angle(orbit, third_kind)
        cosine, sine = np.cos(psi), np.sin(psi)
        v0, w0, m0 = frame(orbit.inertia, orbit.start)
        v, w, m = frame(orbit.inertia, orbit.end)
        # P(t0)^T Y P of proposition 2.1, with the columns v, w, m of P^T.
        outer = "in,jn->ijn"
        return from_matrix(
            np.einsum(outer, v0, cosine * v - sine * w)
            + np.einsum(outer, w0, sine * v + cosine * w)
            + np.einsum(outer, m0, m)
        )

    return euler.flow_of(inertia, attitude)


def frame(inertia: Array, x: Array) -> tuple[Array, Array, Array]:
    """Return v = xdot/norm(xdot), w = x cross v, and x, for unit momenta x (3, N) off the principal axes."""
    J, K = np.roll(inertia, -1, axis=0), np.roll(inertia, 1, axis=0)
    a, b, c = (J - K) / (J * K)  # 1/K - 1/J, which would cancel
    v = np.stack([a * x[1] * x[2], b * x[2] * x[0], c * x[0] * x[1]])
    v /= np.sqrt(np.einsum("in,in->n", v, v))
    return v, np.cross(x, v, axis=0), x


def angle(orbit: Orbit, third_kind: ThirdKind) -> Array:
    """Return the planar angle psi (N,) of a step, for the frame of `frame`: equation (14).

    In this equation, n = (I3 - I2)/(I2 a1²) in case (a) and n = (I2 - I1)/(I2 a3²) in case (b). In both cases 1 - n =
    abs(1 - 2T I2) / (b I2 A_j²) with b = 1/I1 - 1/I3, where A_j is the largest value of the component along the circled
    axis.
    """
    I1, I2, I3 = orbit.inertia
    circled = np.where(orbit.high, orbit.first, orbit.third)
    nc = np.abs(orbit.excess) / ((I3 - I1) / (I1 * I3) * I2 * circled**2)
    psi: Array = orbit.energy * orbit.time + orbit.excess / (I2 * orbit.rate) * third_kind(orbit, nc)
    return psi
