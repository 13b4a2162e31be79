"""Against roundoff: unevaluated sums high + low, and norms that do not drift.

Of sums, a million small steps round no more than one large one.

A sum is an array (2, ...): ``x[0]`` is the number rounded to float64, ``x[1]`` what the rounding left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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


def renewed(x: Array, high: Array) -> Array:
    """Return the sum with a new high part; the low part stays where the high part is what it was."""
    return np.array([high, np.where(high == x[0], x[1], 0.0)])


def keep_norm(m1: Array, m: Array, square: Array) -> Array:
    """Bring momenta m1 (3, N) that have the norm of m up to roundoff to that norm, in place; `square` is m.m.

    The difference of the squares, as (m - m1).(m + m1), is small and its rounding has no bias; what 1 - m1.m1/m.m
    leaves has one, because floating-point numbers below one are denser than above, and the norm drifts.
    """
    m1 += m1 * (np.einsum("in,in->n", m - m1, m + m1) * (0.5 / square))
    return m1
