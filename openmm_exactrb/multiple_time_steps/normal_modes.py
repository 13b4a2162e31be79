"""The highest frequency of coupled bonds and angles."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.support.types import Array, Indices

# Sines of angles are taken to be at least this large: the directions in which the ends of a straight angle move are
# undefined. Couplings that are too large for this reason are bounded by those of parallel motions.
_SMALLEST_SINE = 1e-3
# Up to this number of bonds and angles, the matrix is diagonalised as a whole.
_FEW = 200


class OfPairs:
    """Numbers that belong to pairs of indices; later entries override earlier ones."""

    def __init__(self, pairs: Indices, values: Array) -> None:
        keys = self._keys(pairs)
        order = np.argsort(keys, kind="stable")
        self._sorted, self._values = keys[order], np.append(values[order], np.nan)

    @staticmethod
    def _keys(pairs: Indices) -> Indices:
        return np.asarray((pairs.min(axis=1) << 32) + pairs.max(axis=1))

    def of(self, pairs: Indices) -> Array:
        """Return the values of pairs (n, 2), or nan for pairs without a value."""
        place = np.searchsorted(self._sorted, keys := self._keys(pairs), side="right") - 1
        return np.where(np.append(self._sorted, -1)[place] == keys, self._values[place], np.nan)

    def has(self, pairs: Indices) -> NDArray[np.bool_]:
        """Return a mask of the pairs that have a value."""
        return ~np.isnan(self.of(pairs))


class Springs(NamedTuple):
    """Bonds or angles.

    Attributes
    ----------
    particles : (n, 2) or (n, 3) array
    coordinate : (n,) array
        Lengths (nm) or angles at the energy minima.
    strength : (n,) array
        Second derivatives of the energies, in kJ/mol/nm² for bonds and in kJ/mol for angles.
    square : (n,) array
        Squared frequencies (1/ps²) in isolation.
    """

    particles: Indices
    coordinate: Array
    strength: Array
    square: Array

    def chosen(self, which: NDArray[np.bool_]) -> Springs:
        """Return those that a mask (n,) selects."""
        return Springs(self.particles[which], self.coordinate[which], self.strength[which], self.square[which])


def highest(bonds: Springs, angles: Springs, distances: OfPairs, inverse: Array) -> float:
    """Return the highest frequency (1/ps) of coupled bonds and angles, or 0 if there are none.

    The squared frequencies are the eigenvalues of the matrix sqrt(k_s k_t) sum_a (grad_a s . grad_a t)/m_a for
    coordinates s and t with the strengths k (E. B. Wilson, J. Chem. Phys. 9, 76 (1941), doi:10.1063/1.1750829). Its
    elements depend on angles between bonds, and on torsions. In order that the result follow from the System alone,
    angles are those at the energy minima, and elements are averaged over rotations about bonds. This average couples
    only coordinates about a common particle: its bonds, and the angles of which it is the middle. Bonds with an unknown
    angle count as parallel, which gives an upper bound. Constraints are neglected; they can only lower frequencies.

    Parameters
    ----------
    bonds, angles : Springs
        Only with positive squared frequencies.
    distances : OfPairs
        Distances (nm) of particles at the energy minima.
    inverse : (n_particles,) array
        Inverse masses in 1/amu.
    """
    from scipy import sparse  # imported here, so that the package is imported faster
    from scipy.sparse.linalg import eigsh

    square = np.concatenate([bonds.square, angles.square])
    if not len(square):
        return 0.0
    terms, place, coefficients = _gradients(bonds, angles, distances)
    strength = np.concatenate([bonds.strength, angles.strength])
    values = coefficients * np.sqrt(strength[terms] * inverse[place[:, 1]])
    places, column = _unique(place)
    expansion = sparse.csr_array((values, (terms, column)), shape=(len(square), len(places)))
    matrix: Any = (expansion @ _scalar_products(places, angles, distances) @ expansion.T).tocoo()
    i, j = matrix.coords
    bound = np.sqrt(square[i] * square[j])
    matrix.data = np.where(i == j, 0.0, np.clip(matrix.data, -bound, bound))
    matrix = matrix + sparse.diags_array(square)
    if len(square) <= _FEW:
        return float(np.sqrt(np.linalg.eigvalsh(matrix.toarray())[-1]))
    start = np.random.default_rng(0).random(len(square))
    return float(np.sqrt(eigsh(matrix.tocsr(), k=1, which="LA", v0=start, tol=1e-4, return_eigenvectors=False)[0]))


def _gradients(bonds: Springs, angles: Springs, distances: OfPairs) -> tuple[Indices, Indices, Array]:
    """Return the gradients of coordinates as sums of unit vectors along bonds.

    Returns
    -------
    term : (n,) array
        The index of a bond, or the number of bonds plus the index of an angle.
    place : (n, 3) array
        The particle at which the bond begins, the particle that moves, and the particle at which the bond ends.
    coefficient : (n,) array
    """
    (i, j), n = bonds.particles.T, len(bonds.particles)
    ones, own = np.ones(n), np.arange(n)
    found = [(own, (i, i, j), -ones), (own, (j, j, i), -ones)]
    own = n + np.arange(len(angles.particles))
    i, middle, k = angles.particles.T
    cosine, sine = np.cos(angles.coordinate), np.maximum(np.abs(np.sin(angles.coordinate)), _SMALLEST_SINE)
    for end, other in ((i, k), (k, i)):
        scale = 1.0 / (distances.of(np.stack([end, middle], axis=1)) * sine)
        for moving, sign in ((end, 1.0), (middle, -1.0)):
            found.append((own, (middle, moving, end), sign * scale * cosine))
            found.append((own, (middle, moving, other), -sign * scale))
    terms, places, coefficients = zip(*found, strict=True)
    place = np.concatenate([np.stack(each, axis=1) for each in places])
    return np.concatenate(terms), place, np.concatenate(coefficients)


def _scalar_products(places: Indices, angles: Springs, distances: OfPairs) -> Any:
    """Return the scalar products of unit vectors along bonds, for pairs with the same first and moving particle.

    The rows of `places` (n, 3) are unique and sorted.
    """
    from scipy import sparse

    start = np.flatnonzero(np.diff(places[:, 0] << 32 | places[:, 1], prepend=-1))
    count = np.diff(start, append=len(places))
    start, count = np.repeat(start, count), np.repeat(count, count)
    row = np.repeat(np.arange(len(places)), count)
    column = start[row] + np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    cosine = _cosines(places[:, [0, 2]], np.stack([row, column], axis=1), angles, distances)
    return sparse.csr_array((cosine, (row, column)), shape=(len(places), len(places)))


def _cosines(vectors: Indices, pairs: Indices, angles: Springs, distances: OfPairs) -> Array:
    """Return the cosines of angles between pairs of vectors with a common beginning.

    The vectors have the first and last particles (m, 2), and pairs (n, 2) are indices of vectors. Angles are defined by
    terms, or by distances; unknown ones count as 0, so that the vectors are parallel.
    """
    i, middle, k = angles.particles.T
    of_angles = np.stack([middle, i, middle, k], axis=1).reshape(-1, 2)
    every = np.concatenate([vectors, of_angles])
    number = np.unique(every[:, 0] << 32 | every[:, 1], return_inverse=True)[1]
    of_vectors, of_terms = number[: len(vectors)], number[len(vectors) :].reshape(-1, 2)
    by_terms = OfPairs(of_terms, np.cos(angles.coordinate)).of(of_vectors[pairs])
    a, b = distances.of(vectors)[pairs].T
    c = distances.of(vectors[pairs, 1])
    with np.errstate(all="ignore"):  # a bond of no length has no direction
        by_distances = np.clip((a * a + b * b - c * c) / (2.0 * a * b), -1.0, 1.0)
    found = np.where(np.isnan(by_terms), by_distances, by_terms)
    return np.where((of_vectors[pairs[:, 0]] == of_vectors[pairs[:, 1]]) | np.isnan(found), 1.0, found)


def _unique(rows: Indices) -> tuple[Indices, Indices]:
    """Return the unique rows (m, 3) in ascending order, and the place of each row (n, 3) among them.

    The function is faster than `numpy.unique` for rows.
    """
    _, leading = np.unique(rows[:, 0] << 32 | rows[:, 1], return_inverse=True)
    _, first, place = np.unique(leading << 32 | rows[:, 2], return_index=True, return_inverse=True)
    return rows[first], place
