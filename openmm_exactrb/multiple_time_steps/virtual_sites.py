"""Virtual sites with bonded terms: the particles on which they depend, their bodies and their masses.

OpenMM distributes the force on a virtual site over the particles on which the site depends, which may be virtual sites
too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.multiple_time_steps.bonded import BONDED_FORCES, Bonded
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.support.types import Array, Indices

# The numbers that define a site of each type, in the order of its constructor. OpenMM does not return to Python the
# numbers of other types.
_NUMBERS: dict[type[Any], Any] = {
    openmm.TwoParticleAverageSite: lambda site: map(site.getWeight, range(2)),
    openmm.ThreeParticleAverageSite: lambda site: map(site.getWeight, range(3)),
    openmm.OutOfPlaneSite: lambda site: (site.getWeight12(), site.getWeight13(), site.getWeightCross()),
    openmm.LocalCoordinatesSite: lambda site: (
        *(site.getOriginWeights(), site.getXWeights(), site.getYWeights(), site.getLocalPosition()),
    ),
}


def are_sites(system: openmm.System) -> NDArray[np.bool_]:
    """Return a mask (n_particles,) of the virtual sites."""
    found = np.asarray(parameters.masses(system) == 0.0)
    found[found] = [system.isVirtualSite(i) for i in np.flatnonzero(found).tolist()]
    return found


def with_bonded_terms(system: openmm.System) -> list[int]:
    """Return the virtual sites with bonded terms that are, like those on which they depend, of supported types."""
    sites = are_sites(system)
    if not sites.any():
        return []
    terms = [Bonded.of(force).particles for force in system.getForces() if isinstance(force, BONDED_FORCES)]
    named = np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *(of.ravel() for of in terms)]))
    return [
        i
        for i in named[sites[named]].tolist()
        if all(type(system.getVirtualSite(k)) in _NUMBERS for k in with_parents(system, [i]) if sites[k])
    ]


def with_parents(system: openmm.System, particles: Iterable[int]) -> list[int]:
    """Return particles and all those on which virtual sites among them depend, in ascending order."""
    found, new = set[int](), set(particles)
    while new:
        found |= new
        new = {parent for i in new if system.isVirtualSite(i) for parent in _parents(system, i)} - found
    return sorted(found)


def owners(system: openmm.System, owner: Indices) -> Indices:
    """Return the body of each particle (n,), from that of particles with mass, also for sites with bonded terms.

    A site that depends on several bodies has a number of its own below -1. Other sites have the number -1, as particles
    without a body.
    """
    found = owner.copy()
    for site in with_bonded_terms(system):
        of = {int(owner[i]) for i in with_parents(system, [site]) if not system.isVirtualSite(i)}
        found[site] = of.pop() if len(of) == 1 else -2 - site
    return found


def masses(system: openmm.System, positions: Callable[[], Array]) -> Array:
    """Return masses (n,) in amu, also of virtual sites with bonded terms, given their positions().

    The positions (n, 3) in nm of whole molecules are requested only if there are such sites.

    The mass of a site is that with which it resists a force in the direction in which it moves most easily. If forces
    on the site exert the forces J f on particles of masses m, the inverse mass is the largest eigenvalue of
    the sum of J^T J / m.
    """
    found, sites = parameters.masses(system), with_bonded_terms(system)
    if not sites:
        return found
    twin, push, groups = openmm.System(), openmm.CustomExternalForce("a*x + b*y + c*z"), []
    for site in sites:  # each with its own copies of the particles on which it depends
        group = with_parents(system, [site])
        groups.append(group)
        add_particles(system, group, twin)
        push.addParticle(twin.getNumParticles() - len(group) + group.index(site))
    for name in "abc":
        push.addGlobalParameter(name, 0.0)
    twin.addForce(push)
    twin.setDefaultPeriodicBoxVectors(*system.getDefaultPeriodicBoxVectors())
    context = openmm.Context(twin, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions()[np.concatenate(groups)])
    context.computeVirtualSites()
    J = []
    for name in "abc":
        context.setParameter(name, 1.0)
        J.append(arrays.forces(context.getState(forces=True)))
        context.setParameter(name, 0.0)
    own = parameters.masses(twin)
    inverse = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0.0)
    products = np.einsum("apk,bpk,p->pab", J, J, inverse)
    mobility = np.add.reduceat(products, np.cumsum([0, *map(len, groups[:-1])]), axis=0)
    largest = np.linalg.eigvalsh(mobility)[:, -1]
    found[sites] = np.divide(1.0, largest, out=np.zeros_like(largest), where=largest > 0.0)
    return found


def add_particles(system: openmm.System, particles: list[int], to: openmm.System) -> None:
    """Add particles of a System to another System, with the virtual sites among them; all parents must be included."""
    first, number = to.getNumParticles(), {i: k for k, i in enumerate(particles)}
    for i in particles:
        to.addParticle(system.getParticleMass(i))
    for i, k in number.items():
        if system.isVirtualSite(i):
            site = system.getVirtualSite(i)
            parents = [first + number[parent] for parent in _parents(system, i)]
            leading = [parents] if isinstance(site, openmm.LocalCoordinatesSite) else parents
            to.setVirtualSite(first + k, type(site)(*leading, *_NUMBERS[type(site)](site)))


def _parents(system: openmm.System, site: int) -> list[int]:
    of = system.getVirtualSite(site)
    return [of.getParticle(k) for k in range(of.getNumParticles())]
