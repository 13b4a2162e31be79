"""Double-doubles, compiled: the twin of `plain.sums`."""

from __future__ import annotations

from openmm_exactrb.kernels.build import compiled
from openmm_exactrb.kernels.compiled.formulas import two_sum


@compiled("f3 f2 f F3")
def advance(x, rate, t, total):
    """Write x + t rate of double-doubles x (2, k, N) and rates (k, N)."""
    rows, n = rate.shape
    for row in range(rows):
        for i in range(n):
            step = t * rate[row, i] + x[1, row, i]
            total[0, row, i], total[1, row, i] = two_sum(x[0, row, i], step)
