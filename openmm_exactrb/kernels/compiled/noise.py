"""Random numbers that are looked up, compiled: the twin of `plain.noise`, whose formulas it compiles."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.kernels.build import compiled, inlined
from openmm_exactrb.kernels.plain import noise as formula

philox, unit = inlined(formula.philox), inlined(formula.unit)
radius, direction = inlined(formula.radius), inlined(formula.direction)

_PAIRS = np.uint64(formula.PAIRS)
_LOW, _32 = np.uint64(0xFFFFFFFF), np.uint64(32)

#: So many columns are computed together in vector registers, and then copied to where they belong.
BLOCK = 64


@inlined
def block_of(seed, step, stream, row, column):
    """Return the four random words of two rows of a column."""
    return philox(
        np.uint64(column),
        np.uint64(stream) * _PAIRS + np.uint64(row // 2),
        np.uint64(step) & _LOW,
        np.uint64(step) >> _32,
        np.uint64(seed) & _LOW,
        np.uint64(seed) >> _32,
    )


@inlined
def put(pair, row, start, last, out):
    """Copy two rows of a block of columns."""
    for i in range(min(BLOCK, last - start)):
        out[row, start + i] = pair[0, i]
        if row + 1 < len(out):
            out[row + 1, start + i] = pair[1, i]


@inlined
def two_rows_of_normals(seed, step, stream, row, start, pair):
    """Write normals of two rows of a block of columns into an array (2, BLOCK)."""
    for i in range(BLOCK):
        a, b, c, d = block_of(seed, step, stream, row, start + i)
        r = radius(unit(a, b))
        x, y = direction(unit(c, d), d)
        pair[0, i], pair[1, i] = r * x, r * y


@inlined
def two_rows_of_uniforms(seed, step, stream, row, start, pair):
    """Write numbers of (0, 1) of two rows of a block of columns into an array (2, BLOCK)."""
    for i in range(BLOCK):
        a, b, c, d = block_of(seed, step, stream, row, start + i)
        pair[0, i], pair[1, i] = unit(a, b), unit(c, d)


@compiled("i i i i i F2")
def normals(seed, step, stream, first, last, out):
    """Write standard normals into the columns [first, last) of an array (k, N)."""
    pair = np.empty((2, BLOCK))
    for row in range(0, len(out), 2):
        for start in range(first, last, BLOCK):
            two_rows_of_normals(seed, step, stream, row, start, pair)
            put(pair, row, start, last, out)


@compiled("i i i i i F2")
def uniforms(seed, step, stream, first, last, out):
    """Write numbers of (0, 1) into the columns [first, last) of an array (k, N)."""
    pair = np.empty((2, BLOCK))
    for row in range(0, len(out), 2):
        for start in range(first, last, BLOCK):
            two_rows_of_uniforms(seed, step, stream, row, start, pair)
            put(pair, row, start, last, out)
