"""The symmetric splitting of the free rotor into rotations about its principal axes, of order 2.

The norm of the angular momentum, and the angular momentum in the space frame, are conserved to roundoff; the kinetic
energy is conserved only to second order.

A. Dullweber, B. Leimkuhler and R. McLachlan, J. Chem. Phys. 107, 5840 (1997), doi:10.1063/1.474310.
"""

from __future__ import annotations

import numpy as np

from openmm_exactrb.mathematics.quaternions import renormalise
from openmm_exactrb.rotors.flow import Rotation
from openmm_exactrb.support.types import Array

# Axis of each rotation, and its fraction of the time step.
_SPLITTING = ((0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5))


def rotor(inertia: Array) -> Rotation:
    """Return the splitting flow of free bodies with these principal moments of inertia, (3, 1) or (3, N)."""
    inverse = 1.0 / inertia

    def flow(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        q, m = q.copy(), m.copy()
        for axis, part in _SPLITTING:
            _turn(q, m, axis, (part * t) * inverse[axis] * m[axis])
        return renormalise(q), m

    return flow


def _turn(q: Array, m: Array, axis: int, angle: Array) -> None:
    """Turn bodies about a principal axis, in place: q <- q exp(angle e/2), m <- exp(-angle e) m."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine = np.cos(angle), np.sin(angle)
    m[j], m[k] = cosine * m[j] + sine * m[k], cosine * m[k] - sine * m[j]
    half_cosine, half_sine = np.cos(0.5 * angle), np.sin(0.5 * angle)
    w, vi, vj, vk = q[0], q[1 + axis], q[1 + j], q[1 + k]
    q[0], q[1 + axis], q[1 + j], q[1 + k] = (
        half_cosine * w - half_sine * vi,
        half_cosine * vi + half_sine * w,
        half_cosine * vj + half_sine * vk,
        half_cosine * vk - half_sine * vj,
    )
