"""The conditions under which OpenMM's constraint solver is reliable."""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.mechanics.fit import REFUSED
from openmm_exactrb.mechanics.images import joined
from openmm_exactrb.mechanics.links import Links
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.openmm_access.parameters import TermRows
from openmm_exactrb.support.types import Array

# A distance that differs from the constrained length by more than this fraction of it indicates a split molecule.
_SPLIT = 0.5
# The same for positions after the solver has failed; the solver's tolerance is much smaller.
_MISSED = 0.01
# The relative tolerance of constraints that OpenMM's solver is to satisfy.
_TOLERANCE = 1e-6
# Smallest pivot of independent constraints, whose directions are unit vectors.
_DEPENDENT = 1e-6


def solvable(system: openmm.System, x: Array) -> bool:
    """Return whether OpenMM's solver handles the constraints of a System at positions (n_particles, 3).

    The solver fails if the box has split molecules, because it does not use nearest images. With redundant constraints,
    the solver may diverge, or leave motions that satisfy the constraints to first order but deform a rigid body.
    """
    pairs, lengths = _enforced(system)
    if not len(pairs):
        return True
    apart, distance = _distances(pairs, x)
    whole = np.abs(distance - lengths) <= _SPLIT * lengths
    return bool(whole.all()) and _independent(apart / distance[:, None], pairs, len(x))


def satisfied(system: openmm.System, x: Array) -> bool:
    """Return whether positions (n_particles, 3) that OpenMM's solver has computed satisfy the constraints to 1 %."""
    pairs, lengths = _enforced(system)
    return bool((np.abs(_distances(pairs, x)[1] - lengths) <= _MISSED * lengths).all())


def joined_by_constraints(context: Any, x: Array) -> Array:
    """Return positions (n_particles, 3) in which constrained particles are in the same image of the periodic box."""
    box = arrays.periodic_box(context)
    if box is None:
        return x
    return joined(x, Links(*_enforced(context.getSystem()), len(x)), box)


def mended(context: Any) -> float:
    """Let OpenMM's solver put positions on the constraints if they are too far from these for a first step.

    Molecules that the box has split are joined first. Positions that the solver cannot correct are unchanged.

    Returns
    -------
    float
        The largest error of a constrained length that was corrected, in nm, or 0.
    """
    system, x = context.getSystem(), arrays.positions(context.getState(positions=True))
    pairs, lengths = _enforced(system)
    whole = joined_by_constraints(context, x)
    apart, distance = _distances(pairs, whole)
    missed = float(np.abs(distance - lengths).max(initial=0.0))
    if (
        not REFUSED < missed < np.inf
        or not distance.all()
        or not _independent(apart / distance[:, None], pairs, len(x))
    ):
        return 0.0
    context.setPositions(whole)
    context.applyConstraints(_TOLERANCE)
    if satisfied(system, arrays.positions(context.getState(positions=True))):
        return missed
    context.setPositions(x)
    return 0.0


def _enforced(system: openmm.System) -> TermRows:
    """Return the constraints of a System, without those between frozen particles, which OpenMM ignores."""
    pairs, lengths = parameters.constraints(system)
    moving = parameters.masses(system)[pairs].any(axis=1)
    return pairs[moving], lengths[moving]


def _distances(pairs: NDArray[np.intp], x: Array) -> tuple[Array, Array]:
    """Return the vectors (m, 3) between the particles of each pair, and their lengths (m,)."""
    apart = x[pairs[:, 0]] - x[pairs[:, 1]]
    return apart, np.linalg.norm(apart, axis=1)


def _independent(directions: Array, pairs: NDArray[np.intp], n_particles: int) -> bool:
    """Return whether constraints with these directions (m, 3) are linearly independent."""
    from scipy.sparse import csr_array  # imported here, because it is slow to import
    from scipy.sparse.linalg import splu

    columns = (3 * pairs[:, :, None] + np.arange(3)).reshape(len(pairs), 6)
    entries, starts = np.hstack([directions, -directions]), 6 * np.arange(len(pairs) + 1)
    J = csr_array((entries.ravel(), columns.ravel(), starts), shape=(len(pairs), 3 * n_particles))
    try:
        pivots = splu((J @ J.T).tocsc()).U.diagonal()
    except RuntimeError:  # exactly singular
        return False
    return bool(np.abs(pivots).min() >= _DEPENDENT)
