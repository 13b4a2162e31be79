"""The molecules to which particles and bodies belong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.support.types import Indices

#: Particles of bodies that a user named, in addition to the bodies that constraints define.
Named = Sequence[Sequence[int]] | None


def molecule_of(context: Any, named: Named) -> Indices:
    """Return the index (n_particles,) of the molecule of each particle; a body in `named` merges its molecules.

    Molecules are those of ``Context.getMolecules``: particles connected by constraints or bonds of any force.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    groups, n = [*context.getMolecules(), *(named or [])], context.getSystem().getNumParticles()
    pairs = np.array([(group[0], member) for group in groups for member in group])
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def in_flexible_molecules(context: Any, bodies: RigidBodies, named: Named) -> NDArray[np.bool_]:
    """Return a mask (N,) of the bodies in molecules of more than one body."""
    molecule = molecule_of(context, named)[bodies.first_particle]
    flexible: NDArray[np.bool_] = np.bincount(molecule)[molecule] > 1 if len(molecule) else np.zeros(0, dtype=bool)
    return flexible
