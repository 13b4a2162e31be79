"""The exact flow of the free rigid body for moments in any order, and the choice of its kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb import kernels
from openmm_exactrb.kernels.plain import exact as plain
from openmm_exactrb.rotors.flow import Flow, ascending
from openmm_exactrb.support.types import Array


def compiled(inertia: Array) -> Flow:
    """Return the compiled exact flow for moments (3, 1) or (3, N); see `in_numpy`."""
    return _in_any_order(inertia, kernels.load("exact").advance)


def in_numpy(inertia: Array) -> Flow:
    """Return the exact flow in NumPy for moments (3, 1) or (3, N); the flow also accepts double-doubles (2, ., N)."""
    return _in_any_order(inertia, plain.advance)


def _in_any_order(inertia: Array, advance: Callable[..., None]) -> Flow:
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
        advance(body, q, m, times, q1, m1)
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
