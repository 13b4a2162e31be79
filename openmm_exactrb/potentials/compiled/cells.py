"""The sum over pairs of soft dipoles within a cutoff in a large box, with a cell list, compiled in double precision.

The edges of a cell are at least half the cutoff. Each pair is computed once, in the row of one of its two dipoles. The
dipoles of a block of cells and of half of the surrounding cells are collected, the dipoles within the cutoff are
selected, and the arithmetic of the pairs is vectorised. The contributions of a plane of cells to itself and to the next
two planes are stored separately and added in a fixed order, so that results are bit-identical for any number of
threads.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from openmm_exactrb.kernels.build import at_first_call, inner_reordered
from openmm_exactrb.kernels.threads import in_threads
from openmm_exactrb.potentials.compiled.pair import pair
from openmm_exactrb.potentials.compiled.rows import add_columns
from openmm_exactrb.support.types import Array

Cells = tuple[int, int, int]

# Number of cells that the cutoff reaches in each direction, and number of pairs per block of vectorised arithmetic.
_REACH, _CHUNK = 2, 256
_LANES = 8
# Rows per dipole for the contributions of its own plane of cells and of the two previous planes, rounded up to a power
# of two; and the number of cells along z whose dipoles share their partners.
_ROWS, _BLOCK = np.uint64(4), 2


def cells(edges: tuple[float, float, float], end: float) -> Cells | None:
    """Return the number of cells along each edge of a box, or None if the box is too small for a cutoff² of `end`."""
    cutoff = math.sqrt(end)
    x, y, z = (int(_REACH * edge / cutoff) for edge in edges)
    m = x, y, z
    return m if min(m) > 2 * _REACH else None


def near_pairs(arrows: Array, n: int, m: Cells, law: tuple[Any, ...], threads: int) -> tuple[float, Array, Array]:
    """Return the energy, forces and fields (3, n) of the pairs of the first n `arrows` (6, n) within the cutoff.

    `law` contains the arguments of `pair` that follow the products of vectors; the last one is the truncation.
    """
    heads, dipoles, placed = _sorted(arrows, n, m, law[-1])
    energies, partial = np.empty(n), np.zeros((int(_ROWS) * n, _LANES))
    slabs = np.diff(heads[:: m[1] * m[2]])
    in_threads(lambda *part: _slabs(*part, heads, placed, m, *law, energies, partial), slabs, threads)
    forces, fields = np.zeros((2, 3, n))
    _add_up(dipoles, partial, forces, fields)
    return float(energies.sum()), forces, fields


@at_first_call
def _sorted(arrows, n, m, truncation):
    """Return the start of each cell, the dipoles sorted by cells, and their arrows within the box."""
    places, cell = np.empty((3, n)), np.zeros(n, np.int64)
    for d in range(3):
        edge = truncation[d]
        for i in range(n):
            x = arrows[d, i] - edge * math.floor(arrows[d, i] / edge)
            c = x * (m[d] / edge)
            places[d, i] = x
            cell[i] = cell[i] * m[d] + (min(int(c), m[d] - 1) if c > 0.0 else 0)
    heads, dipoles = by_cell(cell, m[0] * m[1] * m[2])
    placed = np.empty((6, n))
    for q in range(n):
        for d in range(3):
            placed[d, q], placed[3 + d, q] = places[d, dipoles[q]], arrows[3 + d, dipoles[q]]
    return heads, dipoles, placed


@at_first_call
def by_cell(cell, cells):
    """Return the start of each cell in the list of dipoles sorted by their `cell` (n,), and this list."""
    heads, dipoles = np.zeros(cells + 1, np.int64), np.empty(len(cell), np.int64)
    for i in range(len(cell)):
        heads[cell[i] + 1] += 1
    for c in range(cells):
        heads[c + 1] += heads[c]
    free = heads.copy()
    for i in range(len(cell)):
        dipoles[free[cell[i]]] = i
        free[cell[i]] += 1
    return heads, dipoles


@inner_reordered
def _collect(first, last, slab, sx, sy, sz, placed, found, who, row):
    """Append the dipoles from `first` to `last` - 1, displaced by a shift, to `found`; return its number of dipoles."""
    begin, to, more = np.uint64(first), np.uint64(row), np.uint64(last - first)
    for j in range(more):
        found[0, to + j] = placed[0, begin + j] + sx
    for j in range(more):
        found[1, to + j] = placed[1, begin + j] + sy
    for j in range(more):
        found[2, to + j] = placed[2, begin + j] + sz
    for j in range(more):
        who[to + j] = _ROWS * (begin + j) + np.uint64(slab)
    return row + last - first


@inner_reordered
def _partners(cell, block, heads, placed, m, truncation, found, who):
    """Collect the dipoles of a block of cells and of half of the surrounding cells; return their number."""
    x, y, z = cell // (m[1] * m[2]), cell // m[2] % m[1], cell % m[2]
    row = _collect(heads[cell], heads[cell + block], 0, 0.0, 0.0, 0.0, placed, found, who, 0)
    for dx in range(_REACH + 1):
        for dy in range(-_REACH if dx > 0 else 0, _REACH + 1):
            X, Y = (x + dx) % m[0], (y + dy) % m[1]
            low = z - _REACH if dx > 0 or dy > 0 else z + block
            high = z + _REACH + block
            column = (X * m[1] + Y) * m[2]
            sx, sy, edge = truncation[0] * ((x + dx) // m[0]), truncation[1] * ((y + dy) // m[1]), truncation[2]
            for turn in range(-1, 2):
                a, b = max(low, turn * m[2]) - turn * m[2], min(high, (turn + 1) * m[2]) - turn * m[2]
                if a < b:
                    here, sz = heads[column + a : column + b + 1], turn * edge
                    row = _collect(here[0], here[-1], dx, sx, sy, sz, placed, found, who, row)
    return row


@inner_reordered
def _arithmetic(k, u, work, repulsion, coupling, attraction, minimum, alpha, truncation):
    """Return the energy, force and field of a dipole u with k others, whose forces and fields are written to `work`.

    The rows of `work` are r², the vector r between the two dipoles, and the arrow u, the force and the field of the
    other dipole.
    """
    ux, uy, uz = u
    energy = fx = fy = fz = gx = gy = gz = 0.0
    for q in range(k):
        r2, x, y, z = work[q], work[_CHUNK + q], work[2 * _CHUNK + q], work[3 * _CHUNK + q]
        vx, vy, vz = work[4 * _CHUNK + q], work[5 * _CHUNK + q], work[6 * _CHUNK + q]
        uv, ur, vr = ux * vx + uy * vy + uz * vz, ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
        e, a, b, c = pair(r2, uv, ur, vr, repulsion, coupling, attraction, minimum, alpha, truncation)
        s, t = c * ur, c * vr
        px, py, pz = a * x + s * vx + t * ux, a * y + s * vy + t * uy, a * z + s * vz + t * uz
        energy += e
        fx, fy, fz = fx + px, fy + py, fz + pz
        gx, gy, gz = gx + t * x - b * vx, gy + t * y - b * vy, gz + t * z - b * vz
        work[7 * _CHUNK + q], work[8 * _CHUNK + q], work[9 * _CHUNK + q] = -px, -py, -pz
        work[10 * _CHUNK + q] = s * x - b * ux
        work[11 * _CHUNK + q] = s * y - b * uy
        work[12 * _CHUNK + q] = s * z - b * uz
    return energy, (fx, fy, fz, gx, gy, gz)


@at_first_call
def _slabs(
    first, last, heads, placed, m, repulsion, coupling, attraction, minimum, alpha, truncation, energies, partial
):
    """Add energies and forces of the pairs of dipoles in given planes of cells and in half of the cells around them."""
    n, end = placed.shape[1], truncation[3]
    found, far, work = np.empty((3, 2 * n)), np.empty(2 * n), np.zeros(13 * _CHUNK)
    who, hits = np.empty(2 * n, np.uint64), np.empty(2 * n + 1, np.uint64)  # unsigned, as no index is negative
    to, blocks = np.empty(_CHUNK, np.uint64), -(-m[2] // _BLOCK)
    for each in range(first * m[1] * blocks, last * m[1] * blocks):
        z = each % blocks * _BLOCK
        cell, block = each // blocks * m[2] + z, min(_BLOCK, m[2] - z)
        if heads[cell] == heads[cell + block]:
            continue
        number = np.uint64(_partners(cell, block, heads, placed, m, truncation, found, who))
        for i in range(heads[cell], heads[cell + block]):
            x, y, z = placed[0, i], placed[1, i], placed[2, i]
            u = placed[3, i], placed[4, i], placed[5, i]
            begin = np.uint64(i - heads[cell] + 1)
            for q in range(begin, number):
                dx, dy, dz = x - found[0, q], y - found[1, q], z - found[2, q]
                far[q] = dx * dx + dy * dy + dz * dz
            k = 0
            for q in range(begin, number):
                hits[k] = q
                k += far[q] < end
            energy = 0.0
            for start in range(0, k, _CHUNK):
                many = min(k - start, _CHUNK)
                full = -(-many // _LANES) * _LANES
                for h in range(many):
                    q = hits[start + h]
                    work[h] = far[q]
                    work[_CHUNK + h], work[2 * _CHUNK + h] = x - found[0, q], y - found[1, q]
                    to[h] = who[q]
                    j = who[q] // _ROWS
                    work[3 * _CHUNK + h], work[4 * _CHUNK + h] = z - found[2, q], placed[3, j]
                    work[5 * _CHUNK + h], work[6 * _CHUNK + h] = placed[4, j], placed[5, j]
                for h in range(many, full):  # padding, which adds nothing to the dipole
                    work[h], to[h] = np.inf, _ROWS * np.uint64(i)
                    for d in range(1, 7):
                        work[d * _CHUNK + h] = 0.0
                e, gained = _arithmetic(full, u, work, repulsion, coupling, attraction, minimum, alpha, truncation)
                energy += e
                for d in range(6):
                    partial[_ROWS * np.uint64(i), d] += gained[d]
                for h in range(0, full, _LANES):
                    add_columns(work, 7 * _CHUNK + h, _CHUNK, partial, to, h)
            energies[i] = energy


@at_first_call
def _add_up(dipoles, partial, forces, fields):
    """Add up the contributions of planes of cells to each dipole, in the original order of the dipoles."""
    for q in range(len(dipoles)):
        i = dipoles[q]
        for d in range(3):
            for row in range(4 * q, 4 * q + _REACH + 1):
                forces[d, i] += partial[row, d]
                fields[d, i] += partial[row, 3 + d]
