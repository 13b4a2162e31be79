"""The bonded forces and the exceptions of a System, restricted to the particles on which they act.

These particles are few compared with those of a solvent. The user's System is not changed.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import ChosenBodies, RigidBodies
from openmm_exactrb.multiple_time_steps.bonded import BONDED_FORCES, Bonded, interacting_exceptions
from openmm_exactrb.multiple_time_steps.virtual_sites import (
    add_particles,
    are_sites,
    owners,
    with_bonded_terms,
    with_parents,
)
from openmm_exactrb.openmm_access import parameters
from openmm_exactrb.support.types import Indices


@dataclass(frozen=True)
class Excerpt:
    """A selection of forces of a System.

    Attributes
    ----------
    whole : openmm.System
    forces : sequence of Bonded
        The selected forces, with the particle indices of the whole System.
    particles : (n,) array of int
        The indices of the particles on which these forces act, of those on which virtual sites among them depend, and
        of all other particles of their bodies.
    bodies : RigidBodies
        All bodies of the whole System.
    """

    whole: openmm.System
    forces: Sequence[Bonded]
    particles: Indices
    bodies: RigidBodies

    @cached_property
    def part(self) -> ChosenBodies:
        """The bodies that consist of these particles, which are numbered as in `system`."""
        chosen = self.bodies.touched(self.particles)
        return ChosenBodies(self.bodies.chosen(chosen, self._number, len(self.particles)), chosen)

    @cached_property
    def on_sites(self) -> Sequence[Bonded]:
        """The forces on virtual sites, for which there are no kernels."""
        sites = are_sites(self.whole)
        found = [(force, np.asarray(sites[force.particles].any(axis=1))) for force in self.forces]
        return [force.chosen(which) for force, which in found if which.any()]

    @cached_property
    def numbered(self) -> Sequence[Bonded]:
        """The forces, with particles numbered as in `system`."""
        return [force.numbered(self._number) for force in self.forces]

    @cached_property
    def system(self) -> openmm.System:
        """A System of these particles, in which OpenMM evaluates these forces."""
        own, number = openmm.System(), self._number
        add_particles(self.whole, self.particles.tolist(), own)
        pairs, lengths = parameters.constraints(self.whole)
        inside = (number[pairs] >= 0).all(axis=1)
        for (i, j), length in zip(number[pairs[inside]].tolist(), lengths[inside].tolist(), strict=True):
            own.addConstraint(i, j, length)
        for force in self.numbered:
            own.addForce(force.made())
        own.setDefaultPeriodicBoxVectors(*self.whole.getDefaultPeriodicBoxVectors())
        return own

    @cached_property
    def _number(self) -> Indices:
        """The index in `system` of each particle of the whole System, or -1."""
        number = np.full(self.whole.getNumParticles(), -1)
        number[self.particles] = np.arange(len(self.particles))
        return number


def bonded_excerpt(
    system: openmm.System, bodies: RigidBodies, groups: Collection[int] | None = None, sites: bool = True
) -> Excerpt | None:
    """Return the bonded forces and the exceptions of NonbondedForces that move bodies relative to each other.

    If `groups` are given, only bonded forces in these groups are returned, without exceptions. Exceptions of virtual
    sites are excluded, as are bonded terms of sites of unsupported types and, unless `sites`, of all virtual sites. The
    function returns None if there are no such bonded forces.
    """
    owner, of_sites = owners(system, bodies.owner), are_sites(system)
    excluded = of_sites.copy()
    excluded[with_bonded_terms(system) if sites else []] = False
    own = [force for force in system.getForces() if isinstance(force, BONDED_FORCES)]
    bonded = [Bonded.of(force) for force in own if groups is None or force.getForceGroup() in groups]
    forces = _acting(bonded, owner, excluded)
    if not forces:
        return None
    every = [force for force in system.getForces() if groups is None and isinstance(force, openmm.NonbondedForce)]
    forces += _acting(chain.from_iterable(map(interacting_exceptions, every)), owner, of_sites)
    named = np.flatnonzero(np.bincount(np.concatenate([force.particles.ravel() for force in forces])))
    touched = np.union1d(named, np.array(with_parents(system, named[of_sites[named]].tolist()), dtype=np.intp))
    members = np.flatnonzero(np.append(bodies.touched(touched), False)[bodies.owner])  # -1: no body
    return Excerpt(system, forces, np.union1d(members, touched), bodies)


def _acting(forces: Any, owner: Indices, excluded: NDArray[np.bool_]) -> list[Bonded]:
    """Return the terms of forces that connect different bodies and involve no excluded particles."""
    found = []
    for force in forces:
        bodies = owner[force.particles]
        between = (bodies != bodies[:, :1]).any(axis=1) & ~excluded[force.particles].any(axis=1)
        if between.any():
            found.append(force.chosen(between))
    return found
