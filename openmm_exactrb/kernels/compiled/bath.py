"""Momenta in a bath, compiled: the twin of `plain.bath`."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.kernels.build import compiled
from openmm_exactrb.kernels.compiled.noise import BLOCK, two_rows_of_normals
from openmm_exactrb.kernels.compiled.sums import two_sum


@compiled("f3 f2 f f i i i i i F3")
def relax(x, width, fade, spread, seed, step, stream, first, last, total):
    """Write x + fade x + spread width xi into the columns [first, last) of an array (2, k, N) or (1, k, N)."""
    xi = np.empty((2, BLOCK))
    rows = len(width)
    for pair in range(0, rows, 2):
        for start in range(first, last, BLOCK):
            two_rows_of_normals(seed, step, stream, pair, start, xi)
            for row in range(pair, min(pair + 2, rows)):
                for i in range(min(BLOCK, last - start)):
                    column = start + i
                    change = fade * x[0, row, column] + spread * width[row, column] * xi[row - pair, i]
                    if len(x) == 1:
                        total[0, row, column] = x[0, row, column] + change
                    else:
                        total[0, row, column], total[1, row, column] = two_sum(
                            x[0, row, column], x[1, row, column], change
                        )
