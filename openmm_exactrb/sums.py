"""Unevaluated sums high + low, so that a million small steps round no more than one large one.

A sum is an array (2, ...): ``x[0]`` is the number rounded to float64, ``x[1]`` what the rounding left.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb import kernels

Array = NDArray[np.float64]


def exactly(x: Array) -> Array:
    """Return the sum (2, ...) of an array and nothing."""
    return np.array([x, np.zeros(x.shape)])


def add(x: Array, step: Array) -> Array:
    """Return x + step for a sum x (2, ...), or for a plain array as x (1, ...), rounded.

    The rounding of the high part is computed exactly: D. E. Knuth, The Art of Computer Programming 2, 4.2.2, theorem B.
    """
    total = np.empty(x.shape)
    if len(x) == 1:
        np.add(x[0], step, out=total[0])
        return total
    step = step + x[1]
    np.add(x[0], step, out=total[0])
    shadow = total[0] - x[0]
    np.add(x[0] - (total[0] - shadow), step - shadow, out=total[1])
    return total


def fastest_advance() -> Callable[[Array, Array, float], Array]:
    """Return advance(x, rate, t) -> x + t rate for a sum x (2, k, N) and rates (k, N), compiled where numba is."""
    if not kernels.available():
        return lambda x, rate, t: add(x, t * rate)
    compiled = kernels.load("sums_compiled").advance

    def advance(x: Array, rate: Array, t: float) -> Array:
        total = np.empty(x.shape)
        compiled(np.ascontiguousarray(x), np.ascontiguousarray(rate), t, total)
        return total

    return advance


def renewed(x: Array, high: Array) -> Array:
    """Return the sum with a new high part; the low part stays where the high part is what it was."""
    return np.array([high, np.where(high == x[0], x[1], 0.0)])
