"""Sums high + low, compiled: the twin of `plain.sums`."""

from __future__ import annotations

from openmm_exactrb.kernels.build import compiled, inlined


@inlined
def two_sum(high, low, step):
    """Return high + low + step as a sum."""
    step = step + low
    total = high + step
    shadow = total - high
    return total, (high - (total - shadow)) + (step - shadow)


@compiled("f3 f2 f F3")
def advance(x, rate, t, total):
    """Write x + t rate of sums x (2, k, N) and rates (k, N)."""
    rows, n = rate.shape
    for row in range(rows):
        for i in range(n):
            total[0, row, i], total[1, row, i] = two_sum(x[0, row, i], x[1, row, i], t * rate[row, i])
