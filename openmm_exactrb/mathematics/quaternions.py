"""Unit quaternions (..., 4), scalar first: q = (w, x, y, z) maps body coordinates to space coordinates.

Inner loops use component-first arrays (4, N), with one contiguous row per component.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from openmm_exactrb.mathematics.constants import TO_GRID
from openmm_exactrb.support.types import Array

#: An array or a number.
Real: TypeAlias = Any


def multiply(p: Array, q: Array) -> Array:
    """Return the products p q of component-first quaternions (4, N); q may be a single quaternion (4, 1)."""
    return np.array(product(*p, *q))


def product(p0: Real, p1: Real, p2: Real, p3: Real, q0: Real, q1: Real, q2: Real, q3: Real) -> tuple[Real, ...]:
    """Return the components of the product p q, for arrays or for numbers."""
    return (
        p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
        p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
        p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1,
        p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0,
    )


def exponential(turn: Array) -> Array:
    """Return the quaternions (4, N) of rotations about vectors (3, N), whose lengths are the angles in rad."""
    half = 0.5 * np.sqrt(np.einsum("in,in->n", turn, turn))
    return np.concatenate([np.cos(half)[None], 0.5 * np.sinc(half / np.pi) * turn])


def renormalise(x: Array) -> Array:
    """Normalise, in place, component-first vectors whose length is 1 up to roundoff.

    The correction x (1 - x.x)/2 is added, because the rounding errors of division by a square root have a bias, which
    causes a drift over a million steps.
    """
    x += x * (0.5 * (1.0 - np.einsum("in,in->n", x, x)))
    return x


def norm_defect(q: Array) -> Array:
    """Return 1 - q.q of component-first unit quaternions (4, N), with an error of 1e-24.

    A sum in float64 has an error of 1e-16 that depends on q. A norm that is corrected by this sum, and hence the force,
    would depend on the error, so that the energy would drift. The squares of numbers on a grid of 2^-26 are exact, and
    their sum is also exact.
    """
    coarse = (q + TO_GRID) - TO_GRID
    rest = np.einsum("in,in->n", q - coarse, q + coarse)
    defect: Array = (1.0 - np.einsum("in,in->n", coarse, coarse)) - rest
    return defect


def rotation_matrix(q: ArrayLike) -> Array:
    """Return the rotation matrices Q (..., 3, 3) of unit quaternions (..., 4), from body to space coordinates.

    The formula is equation (17) of Celledoni et al. (doi:10.1137/070704393).
    """
    q = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    return np.ascontiguousarray(np.moveaxis(matrix(q), (0, 1), (-2, -1)))


def matrix(q: Array) -> Array:
    """Return the rotation matrices (3, 3, ...) of component-first unit quaternions (4, ...)."""
    w, x, y, z = q
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    rows = (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )
    return np.array(rows)


def from_matrix(Q: Array) -> Array:
    """Return component-first quaternions (4, N) of rotation matrices (3, 3, N).

    The method divides by the largest component: S. W. Shepperd, J. Guid. Control 1, 223 (1978), doi:10.2514/3.55767b.
    """
    d = np.stack([Q[0, 0], Q[1, 1], Q[2, 2]])
    trace = d.sum(axis=0)
    n = Q.shape[2]
    # 4 q_i q_j for all i and j; the column of the largest diagonal entry is q times 4 q_i.
    products = np.empty((4, 4, n))
    products[0, 0] = 1.0 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[i + 1, i + 1] = 1.0 + 2.0 * d[i] - trace
        products[0, i + 1] = products[i + 1, 0] = Q[k, j] - Q[j, k]
        products[j + 1, k + 1] = products[k + 1, j + 1] = Q[k, j] + Q[j, k]
    largest = np.argmax(np.einsum("iin->in", products), axis=0)
    q = np.take_along_axis(products, largest[None, None], axis=0)[0]
    unit: Array = q / np.sqrt(np.einsum("in,in->n", q, q))
    return unit


def random(rng: np.random.Generator, n: int) -> Array:
    """Return n random orientations (n, 4), uniformly distributed over all rotations."""
    q = rng.standard_normal((n, 4))
    unit: Array = q / np.linalg.norm(q, axis=1, keepdims=True)
    return unit


def turned(Q: Array, sites: Array) -> Array:
    """Return the rotated sites Q b (n, k, 3) for orientations (n, 3, 3) and sites (1, k, 3) or (n, k, 3)."""
    n, (shapes, k, _) = len(Q), sites.shape
    if shapes > 1:
        own: Array = np.einsum("nij,nsj->nsi", Q, sites)
        return own
    shared: Array = (Q.reshape(3 * n, 3) @ sites[0].T).reshape(n, 3, k).swapaxes(1, 2)
    return shared
