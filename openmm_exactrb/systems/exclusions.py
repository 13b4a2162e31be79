"""Exclusion of pairs of particles within rigid bodies, between which forces have no effect."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.support import checks

Pair = tuple[int, int]


def exclude_within(system: openmm.System, bodies: Sequence[Sequence[int]]) -> int:
    """Exclude all pairs of particles within rigid bodies from the nonbonded forces of a System.

    Forces within a body do not move it, so the forces and torques on the bodies remain the same to roundoff. Pressures
    and the action of barostats do not change either, because OpenMM scales molecules as a whole. The energy changes by
    a constant, which depends on the parameters of the Context if the energy within bodies does, as in free energy
    calculations.

    Every `NonbondedForce` and `GayBerneForce` receives exceptions with zero parameters, and every
    `CustomNonbondedForce` receives exclusions of the same pairs, because OpenMM requires equal exclusions in all forces
    on GPUs. Existing exceptions within bodies, and their parameter offsets, become zero. Call this function before the
    Context is created.

    Parameters
    ----------
    system : openmm.System
        The System, which is changed in place.
    bodies : sequence of sequences of int
        Particles of the bodies, as for ``bodies=`` of the integrators. The integrator must move them as rigid bodies.
        The smallest distance between opposite sides of a periodic box must exceed the length of each body plus the
        cutoff. A virtual site belongs to a body if it depends only on particles of that body.

    Returns
    -------
    int
        Number of pairs within bodies.

    Raises
    ------
    ValueError
        If a particle is named twice or does not exist.
    """
    members = _members(system, checks.lists_of_indices(bodies, "bodies"))
    within = [pair for body in members for pair in itertools.combinations(body, 2)]
    for force in system.getForces():
        if isinstance(force, openmm.CustomNonbondedForce):
            present = {_sorted(force.getExclusionParticles(i)) for i in range(force.getNumExclusions())}
            for pair in within:
                if pair not in present:
                    force.addExclusion(*pair)
        elif isinstance(force, openmm.NonbondedForce | openmm.GayBerneForce):
            _except(force, within)
    return len(within)


def _except(force: Any, within: list[Pair]) -> None:
    """Add exceptions to a force such that pairs within bodies do not interact."""
    numbers = (0.0, 1.0, 0.0) if isinstance(force, openmm.NonbondedForce) else (1.0, 0.0)
    present = {_sorted(force.getExceptionParameters(i)[:2]): i for i in range(force.getNumExceptions())}
    for pair in within:
        if pair in present:
            force.setExceptionParameters(present[pair], *pair, *numbers)
        else:
            force.addException(*pair, *numbers)
    if isinstance(force, openmm.NonbondedForce):
        gone = {present[pair] for pair in within if pair in present}
        for i in range(force.getNumExceptionParameterOffsets()):
            parameter, exception, *_ = force.getExceptionParameterOffset(i)
            if exception in gone:
                force.setExceptionParameterOffset(i, parameter, exception, 0.0, 0.0, 0.0)


def _sorted(pair: Iterable[int]) -> Pair:
    i, j = pair
    return (i, j) if i < j else (j, i)


def _members(system: openmm.System, bodies: list[list[int]]) -> list[list[int]]:
    """Return the particles of each body in ascending order, with the virtual sites that depend only on the body."""
    owner = checks.owners(bodies, system.getNumParticles())
    for particle in map(int, np.flatnonzero(owner < 0)):
        if system.isVirtualSite(particle):
            site = system.getVirtualSite(particle)
            owners = {owner[site.getParticle(k)] for k in range(site.getNumParticles())}
            if len(owners) == 1:
                owner[particle] = owners.pop()
    members: list[list[int]] = [[] for _ in bodies]
    for particle in map(int, np.flatnonzero(owner >= 0)):
        members[owner[particle]].append(particle)
    return members
