"""Arithmetic with unevaluated sums high + low, compiled: the twins of the functions in `plain.exact`."""

from __future__ import annotations

from openmm_exactrb.kernels.build import inlined


@inlined
def times_squared(factor, factor_error, x):
    """Return factor x²."""
    square, square_error = exact_product(x, x)
    leading, error = exact_product(factor, square)
    return leading, error + (factor * square_error + factor_error * square)


@inlined
def times(a, b, b_error):
    """Return a times a sum b."""
    leading, error = exact_product(a, b)
    return sum_ordered(leading, error + a * b_error)


@inlined
def difference(a, b):
    """Return a - b exactly."""
    d = a - b
    shadow = d - a
    return d, (a - (d - shadow)) - (b + shadow)


@inlined
def sum_ordered(a, b):
    """Return a + b exactly for abs(a) >= abs(b)."""
    total = a + b
    return total, b - (total - a)


@inlined
def exact_product(a, b):
    """Return a b exactly."""
    p = a * b
    a_high, a_low = _halves(a)
    b_high, b_low = _halves(b)
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


@inlined
def _halves(a):
    t = 134217729.0 * a
    high = t - (t - a)
    return high, a - high
