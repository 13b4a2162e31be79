"""Reduction of roundoff: double-double numbers, and norms that do not drift.

A million small steps of free motion in double-doubles accumulate no more roundoff than a single large step. An array of
double-doubles has the shape (2, ...): ``x[0]`` is the number rounded to float64, and ``x[1]`` is the rounding error.

`two_sum` and the functions that follow it are error-free transformations of arrays and of numbers.
"""

from __future__ import annotations

import numpy as np

from openmm_exactrb.mathematics.quaternions import Real
from openmm_exactrb.support.types import Array


def exactly(x: Array) -> Array:
    """Return an array as double-doubles (2, ...) with low parts of zero."""
    return np.array([x, np.zeros(x.shape)])


def add(x: Array, step: Array) -> Array:
    """Return x + step for double-doubles x (2, ...), or for a plain array given as x (1, ...)."""
    return x + step if len(x) == 1 else np.array(two_sum(x[0], step + x[1]))


def renewed(x: Array, high: Array) -> Array:
    """Return double-doubles with new high parts.

    A low part is kept where the high part is unchanged, and is zero elsewhere.
    """
    return np.array([high, np.where(high == x[0], x[1], 0.0)])


def keep_norm(m1: Array, m: Array, square: Array) -> Array:
    """Correct the norms of momenta m1 (3, N), in place, to those of m, which differ by roundoff; `square` is m.m.

    The difference of the squares, computed as (m - m1).(m + m1), is small and its rounding is unbiased. The rounding of
    1 - m1.m1/m.m would be biased, because floating-point numbers are denser below one than above one; the norm would
    then drift.
    """
    m1 += m1 * (np.einsum("in,in->n", m - m1, m + m1) * (0.5 / square))
    return m1


def two_sum(a: Real, b: Real) -> tuple[Real, Real]:
    """Return a + b, and its rounding error (D. E. Knuth, The Art of Computer Programming 2, 4.2.2, theorem B)."""
    total = a + b
    shadow = total - a
    return total, (a - (total - shadow)) + (b - shadow)


def two_difference(a: Real, b: Real) -> tuple[Real, Real]:
    """Return a - b, and its rounding error."""
    d = a - b
    shadow = d - a
    return d, (a - (d - shadow)) - (b + shadow)


def two_product(a: Real, b: Real) -> tuple[Real, Real]:
    """Return a b, and its rounding error (T. J. Dekker, Numer. Math. 18, 224 (1971), doi:10.1007/BF01397083)."""
    p = a * b
    a_high, a_low = halves(a)
    b_high, b_low = halves(b)
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


def halves(a: Real) -> tuple[Real, Real]:
    """Return the high and the low half of a number, whose 53 bits are split into 26 and 27."""
    t = 134217729.0 * a
    high = t - (t - a)
    return high, a - high


def times(a: Real, b: tuple[Real, Real]) -> tuple[Real, Real]:
    """Return the double-double a b, for a number a and a double-double b."""
    leading, error = two_product(a, b[0])
    error = error + a * b[1]
    total = leading + error  # Dekker's FastTwoSum
    return total, error - (total - leading)


def quotient(a: Array, b: Real) -> Array:
    """Return the double-double a/b, for a double-double a (2, ...) and a number b."""
    leading = a[0] / b
    product, error = two_product(leading, b)
    return np.array(two_sum(leading, ((a[0] - product) - error + a[1]) / b))


def times_squared(factor: tuple[Real, Real], x: Real) -> tuple[Real, Real]:
    """Return the product of a double-double factor and the square of a number x, as a double-double."""
    square, square_error = two_product(x, x)
    leading, error = two_product(factor[0], square)
    return leading, error + (factor[0] * square_error + factor[1] * square)
