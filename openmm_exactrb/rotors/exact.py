"""The exact flow of the free rigid body for moments in any order, by the library or in NumPy.

The library divides a step into short steps, which are exact as well, so that their number does not affect the result.
The steps of bodies that would need many, and all steps without the library, are those of
`openmm_exactrb.rotors.closed_form`, which takes a step of any length at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.library import functions
from openmm_exactrb.rotors import closed_form
from openmm_exactrb.rotors.constants import SHORT
from openmm_exactrb.rotors.flow import Rotation, ascending
from openmm_exactrb.support.types import Array

# The largest number of short steps of the library, which take 5 us; a call of NumPy takes 300 us, and 2 us for a body.
_MOST_PARTS = 64
_LIMITS = np.array([_MOST_PARTS * SHORT, *closed_form.SAFE, closed_form.VANISHING, closed_form.LARGEST_ANGLE])


def fastest(inertia: Array) -> Rotation:
    """Return the exact flow for moments (3, 1) or (3, N), by the library if there is one; see `in_numpy`."""
    return _in_any_order(inertia, _by_library if functions.available() else closed_form.advance)


def in_numpy(inertia: Array) -> Rotation:
    """Return the exact flow in NumPy for moments (3, 1) or (3, N); the flow also accepts double-doubles (2, ., N)."""
    return _in_any_order(inertia, closed_form.advance)


def _by_library(body: Array, q: Array, m: Array, t: Array, q1: Array, m1: Array) -> None:
    """Advance bodies like `closed_form.advance`."""
    kinds, n, done = body.shape[1], m.shape[2], np.empty(m.shape[2], dtype=np.bool_)
    if functions.call("rotate", n, int(kinds == 1), int(len(t) == 1), len(q) - 1, _LIMITS, body, t, q, m, q1, m1, done):
        own, times = (a if a.shape[-1] == 1 else a[..., ~done] for a in (body, t))
        q2, m2 = np.ascontiguousarray(q[..., ~done]), np.ascontiguousarray(m[..., ~done])
        closed_form.advance(own, q2, m2, times, q2, m2)
        q1[..., ~done], m1[..., ~done] = q2, m2


def _in_any_order(inertia: Array, advance: Callable[..., None]) -> Rotation:
    """Return the flow for moments in any order, given a kernel for ascending moments."""
    order, back, handedness = ascending(inertia)
    body = constants(np.take_along_axis(inertia, order, axis=0))
    ordered = bool((order == np.arange(3)[:, None]).all())

    def arrange(v: Array, places: NDArray[np.intp]) -> Array:
        arranged = v[..., places[:, 0], :] if places.shape[1] == 1 else np.take_along_axis(v, places[None], axis=1)
        return arranged * handedness

    def in_order(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        q, m, times = np.ascontiguousarray(q), np.ascontiguousarray(m), np.ascontiguousarray(t, dtype=np.float64)
        q1, m1 = np.empty_like(q), np.empty_like(m)
        advance(body, q, m, times.reshape(-1), q1, m1)
        return q1, m1

    def arranged(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        q1, m1 = in_order(np.concatenate([q[:, :1], arrange(q[:, 1:], order)], axis=1), arrange(m, order), t)
        q1[:, 1:] = arrange(q1[:, 1:], back)
        return q1, arrange(m1, back)

    of_sums = in_order if ordered else arranged

    def flow(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        if q.ndim == 3:
            return of_sums(q, m, t)
        q1, m1 = of_sums(q[None], m[None], t)
        return q1[0], m1[0]

    return flow


def constants(inertia: Array) -> Array:
    """Return b, rho, sigma, 1/I3 and the moments, divided by a power of two, as one array for sorted moments (3, N)."""
    scale = np.ldexp(1.0, np.frexp(inertia[2])[1])
    I1, I2, I3 = inertia = inertia / scale
    width = I3 - I1
    b = width / (I1 * I3 * scale)
    width[width == 0.0] = 1.0
    rho = I3 * (I2 - I1) / (I2 * width)
    sigma = np.where(b == 0.0, 1.0, I1 * (I3 - I2) / (I2 * width))
    return np.stack([b, rho, sigma, 1.0 / (I3 * scale), *inertia])
