"""Kinetic energies and degrees of freedom of groups of bodies, such as domains, linkers and solvent."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import ChosenBodies, RigidBodies
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.support import checks


class Motion(NamedTuple):
    """Kinetic energies in kJ/mol, and degrees of freedom, of translation and of rotation."""

    energies: tuple[float, float]
    freedom: tuple[float, float]


def of_groups(
    bodies: RigidBodies, state: State, groups: Mapping[str, Iterable[int]], removes_motion: bool
) -> dict[str, Motion]:
    """Return the motion of groups of particles, which must consist of whole bodies and clusters.

    If the centre of mass of the System is kept at rest, the motion is relative to this centre. Each group then loses
    three translational degrees of freedom times its fraction of the total mass. A ValueError is raised if a group
    contains only part of a body or cluster.
    """
    lists = checks.lists_of_indices(list(groups.values()), "groups")
    drift = bodies.drift(state.rounded) if removes_motion else None
    found = {}
    for name, particles in zip(groups, lists, strict=True):
        chosen = _chosen(bodies, name, particles)
        part = ChosenBodies(bodies.chosen(chosen, np.arange(bodies.n_particles), bodies.n_particles), chosen)
        lost = 3.0 * removes_motion * float(part.bodies.mass.sum() / bodies.mass.sum())
        freedom = part.bodies.translational_freedom - lost, part.bodies.rotational_freedom
        found[name] = Motion(part.bodies.kinetic_energies(part.of(state).rounded, drift), freedom)
    return found


def _chosen(bodies: RigidBodies, name: str, particles: list[int]) -> NDArray[np.bool_]:
    """Return a mask (N,) of the bodies in a group of particles; massless particles are ignored."""
    beyond = [k for k in particles if not 0 <= k < bodies.n_particles]
    if beyond:
        raise ValueError(
            f"the particles of group {name!r} must be numbers from 0 to {bodies.n_particles - 1}, not {beyond[0]}: "
            "choose particles of the System"
        )
    chosen, owner = bodies.touched(np.array(particles, dtype=np.intp)), bodies.owner
    left_out = np.append(chosen, False)[owner]  # the last entry is for particles in no body
    left_out[particles] = False
    if left_out.any():
        raise ValueError(
            f"group {name!r} contains only some particles of {bodies.name(int(owner[np.argmax(left_out)]))}: name "
            "all particles of this body, or none"
        )
    return chosen
