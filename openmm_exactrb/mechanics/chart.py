"""Coordinates of constrained clusters without constraints, for minimisers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.clusters import Clusters

Array = NDArray[np.float64]

# Newton's steps, and the part of the square of a length that may be missed after them.
_NEWTON, _REACHED = 30, 1e-12


class OutOfReachError(ArithmeticError):
    """A displacement from which the constraints cannot be reached."""


class Chart:
    """Displacements of all atoms from a place on the constraints, each with the place on them that belongs to it.

    A displaced atom is put back along the constraints as they were at the origin (3, M), x = x0 + u + M^-1 G(x0)^T
    lambda, as in J.-P. Ryckaert, G. Ciccotti and H. J. C. Berendsen, doi:10.1016/0021-9991(77)90098-5.
    """

    def __init__(self, clusters: Clusters, origin: Array) -> None:
        self._origin = origin
        self._kinds = [(kind, columns, _vectors(origin, columns, kind.pairs)) for kind, columns in clusters.columns()]

    def placed(self, u: Array) -> Array:
        """Return the places (3, M) that belong to displacements; OutOfReachError if there are none."""
        x = self._origin + u
        for kind, columns, r0 in self._kinds:
            r, multipliers = _vectors(x, columns, kind.pairs), np.zeros(r0.shape[:2])
            square = kind.lengths**2
            for _ in range(_NEWTON):
                now = r + np.einsum("cd,ndi->nci", kind.coupling, multipliers[..., None] * r0)
                missed = 0.5 * (square - (now * now).sum(axis=2))
                if (np.abs(missed) <= _REACHED * square).all():
                    break
                multipliers = multipliers + _multipliers(kind.coupling, now, r0, missed)
            else:
                raise OutOfReachError("atoms were moved to where no place on the constraints belongs to them")
            _add_on_atoms(x, columns, kind.pairs, multipliers[..., None] * r0, 1.0 / kind.masses)
        return x

    def slope(self, x: Array, force: Array) -> Array:
        """Return the force (3, M) along displacements from the one on the atoms at their places x."""
        slope = force.copy()
        for kind, columns, r0 in self._kinds:
            r = _vectors(x, columns, kind.pairs)
            i, j = kind.pairs.T
            a = (force[:, columns] / kind.masses).transpose(1, 2, 0)
            along = (r0 * (a[:, i] - a[:, j])).sum(axis=2)
            multipliers = _multipliers(kind.coupling, r0, r, along)
            _add_on_atoms(slope, columns, kind.pairs, -multipliers[..., None] * r, np.ones(len(kind.masses)))
        return slope


def _vectors(x: Array, columns: NDArray[np.int64], pairs: NDArray[np.int64]) -> Array:
    """Return x_i - x_j of all constraints, (N, m, 3)."""
    i, j = pairs.T
    r: Array = (x[:, columns[:, i]] - x[:, columns[:, j]]).transpose(1, 2, 0)
    return r


def _multipliers(coupling: Array, r: Array, r0: Array, right: Array) -> Array:
    """Solve sum_d B_cd r_c . r0_d lambda_d = right_c for the multipliers (N, m)."""
    matrix = coupling * np.einsum("nci,ndi->ncd", r, r0)
    try:
        return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0], dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise OutOfReachError("atoms were moved to where constraints cannot be told apart") from error


def _add_on_atoms(x: Array, columns: NDArray[np.int64], pairs: NDArray[np.int64], F: Array, weights: Array) -> None:
    """Add weighted forces F (N, m, 3) of constraints to the columns of their two atoms."""
    for c, (i, j) in enumerate(pairs):
        x[:, columns[:, i]] += weights[i] * F[:, c].T
        x[:, columns[:, j]] -= weights[j] * F[:, c].T
