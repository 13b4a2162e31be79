"""Bonded terms as arrays, for their forces in NumPy and in the kernels."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from openmm_exactrb.support.types import Array, Indices

#: Kinds of terms in the order of the kernel's tables.
KINDS = ("bonds", "angles", "torsions", "pairs", "impropers", "maps")
#: Kinds whose numbers are always in double precision.
EXACT = ("maps",)


class Kind(NamedTuple):
    """The T terms of a kind: `particles` (T, k), further integers `others` (j, T) for the kernel, and `numbers`."""

    particles: Indices
    others: Indices
    numbers: Array


class Terms(NamedTuple):
    """Bonded terms: the particles of each term, in rows, and its numbers, in columns."""

    bonds: Indices
    of_bonds: Array  #: lengths and strengths (2, .)
    angles: Indices
    of_angles: Array  #: cosines and sines of angles, and strengths (3, .)
    torsions: Indices
    of_torsions: Array  #: coefficients of cosines and sines (2, N, .)
    pairs: Indices
    of_pairs: Array  #: products of charges in kJ nm/mol, sigmas and epsilons (3, .)
    impropers: Indices
    of_impropers: Array  #: phi0, k of k (phi - phi0)², and the period of phi in OpenMM's formula (3, .)
    maps: Indices  #: particles of two torsions, first patch of a map, and its number of patches per direction (., 10)
    patches: Array  #: coefficients of bicubic polynomials, highest powers first (., 4, 4)


#: Empty arrays for terms of all types.
NO_TERMS = Terms(
    *(np.zeros((0, 2), np.int64), np.zeros((2, 0))),
    *(np.zeros((0, 3), np.int64), np.zeros((3, 0))),
    *(np.zeros((0, 4), np.int64), np.zeros((2, 0, 0))),
    *(np.zeros((0, 2), np.int64), np.zeros((3, 0))),
    *(np.zeros((0, 4), np.int64), np.zeros((3, 0))),
    *(np.zeros((0, 10), np.int64), np.zeros((0, 4, 4))),
)


def kinds_of(terms: Terms, precision: type[np.floating[Any]]) -> dict[str, Kind]:
    """Convert the terms of the host's kernel to kinds by name, with the numbers that the kernel needs."""
    length, strength = terms.of_bonds
    square = length * length
    near = square.astype(precision).astype(np.float64)
    numbers = (
        np.stack([length, near, square - near, strength]),
        terms.of_angles,
        terms.of_torsions.reshape(2 * terms.of_torsions.shape[1], len(terms.torsions)),
        terms.of_pairs,
        terms.of_impropers,
        np.zeros((0, len(terms.maps))),
    )
    kinds = {
        name: Kind(of_kind, np.zeros((0, len(of_kind)), dtype=np.int64), values)
        for name, of_kind, values in zip(KINDS, particles(terms), numbers, strict=True)
    }
    return kinds | {"maps": kinds["maps"]._replace(others=terms.maps[:, 8:].T)}


def particles(terms: Terms) -> list[Indices]:
    """Return the particles (T, k) of the terms of each kind."""
    return [terms.bonds, terms.angles, terms.torsions, terms.pairs, terms.impropers, terms.maps[:, :8]]
