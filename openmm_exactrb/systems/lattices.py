"""Lattices of initial positions for molecules."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.support.types import Array

# From this number of sites on, fewer vectors are tried for a lattice.
_MANY = 100


def places_a_side(n: int) -> int:
    """Return the number of lattice sites along an edge of the smallest cube with at least n sites."""
    return next(k for k in range(1, n + 1) if k**3 >= n)


def cubic_lattice(n: int) -> Array:
    """Return the first n sites (n, 3) of a cubic lattice with constant 1."""
    return np.argwhere(np.ones(3 * (places_a_side(n),)))[:n].astype(np.float64)


def filling(n: int) -> tuple[Array, float]:
    """Return n sites (n, 3) that fill a periodic cube without vacancies at density 1, and the edge of the cube.

    The sites form a cubic lattice if n is a perfect cube. Otherwise they are the multiples of a vector (1, a, b)/n, in
    units of the edge. The vector is the first one whose multiples are at least as far apart as in a cubic lattice, or
    otherwise the one with the largest minimum distance. For n of 100 or more, only b = a² is tried (Korobov; Sloan and
    Joe, Lattice Methods for Multiple Integration, 1994).
    """
    k = places_a_side(n)
    if k**3 == n:
        return cubic_lattice(n), float(k)
    edge, half = float(np.cbrt(n)), np.arange(1, n // 2 + 1)[:, None]
    farthest, best = -1.0, (1, 1)
    for a in range(1 if n < _MANY else k, n // 2 + 1):
        for b in range(a, n // 2 + 1) if n < _MANY else [a * a % n]:
            away = half * (1, a, b) % n
            apart = edge / n * float(np.sqrt((np.minimum(away, n - away) ** 2).sum(axis=1).min()))
            if apart > farthest:
                farthest, best = apart, (a, b)
        if farthest >= 1.0:
            break
    multiples: Array = np.arange(n)[:, None] * np.array([1, *best]) % n * (edge / n)
    return multiples, edge
