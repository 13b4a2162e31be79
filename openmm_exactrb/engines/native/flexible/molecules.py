"""The flexible molecules of a Context, and the check that the kernels support them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import openmm

from openmm_exactrb.constraints.tables import Group
from openmm_exactrb.engines.native.flexible.evaluated import Evaluated
from openmm_exactrb.engines.native.flexible.expressions import Custom
from openmm_exactrb.engines.native.flexible.inner import InnerSteps
from openmm_exactrb.errors import NotServedError
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.multiple_time_steps.bonded import BONDED_FORCES, Bonded, acting, groups_of
from openmm_exactrb.multiple_time_steps.excerpt import Excerpt, bonded_excerpt
from openmm_exactrb.multiple_time_steps.excerpt_forces import has_known_form, terms_of
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces
from openmm_exactrb.multiple_time_steps.terms import NO_TERMS, Terms, particles
from openmm_exactrb.openmm_access import parameters, platforms
from openmm_exactrb.support.types import Array, Indices

#: The largest number of atoms of a cluster on a GPU, where a single thread moves each cluster.
LARGEST = 32
#: The largest number of bonded terms of a particle on a GPU, where a block stores the other particles of these terms in
#: local memory.
MOST_TERMS = 400


@dataclass(frozen=True)
class Molecules:
    """Flexible molecules of a System: clusters, masses, bodies and fast forces.

    Attributes
    ----------
    groups : sequence of Group
        The clusters of the molecules; single atoms and massless atoms count as clusters of one atom.
    masses : (n_particles,) array
        Masses of all particles of the System.
    body_of : (n_particles,) array
        The index of the body of each particle, or -1 for a particle that belongs to no body.
    terms : Terms
        The fast forces of the molecules, with the particle indices of the System.
    customs : tuple of Custom
        The fast forces whose energies are expressions.
    inner : InnerSteps or None
        The inner steps, or None if there are no fast forces.
    late : bool
        Whether the drifts between the last heat exchange and the end of a step are performed at the start of the next
        step.
    """

    groups: Sequence[Group]
    masses: Array
    body_of: Indices
    terms: Terms = NO_TERMS
    customs: tuple[Custom, ...] = ()
    inner: InnerSteps | None = None
    late: bool = False

    @property
    def particles_of_terms(self) -> list[Indices]:
        """The particles (T, k) of the terms of each kind."""
        return [*particles(self.terms), *(custom.particles for custom in self.customs)]


class Served(NamedTuple):
    """The flexible molecules with and without fast forces, and the fast forces that OpenMM evaluates in inner steps."""

    molecules: tuple[Molecules, ...]
    evaluated: Evaluated | None = None


def served(context: Any, bodies: RigidBodies, fast: FastForces | None, settings: Any) -> Served:
    """Return the flexible molecules that kernels support, and the fast forces that OpenMM must evaluate.

    Parameters
    ----------
    context : openmm.Context
    bodies : RigidBodies
    fast : FastForces or None
        The fast forces, which `found` returns together with the bodies.
    settings : Settings

    Raises
    ------
    NotServedError
        If a cluster is too large, if a particle has too many bonded terms, or if no kernel supports the fast forces and
        `fast` does not name their force groups.
    """
    on_gpu = platforms.no_gpu(context) is None
    require_small_clusters(bodies, LARGEST if on_gpu else None)
    system, scheme, h = context.getSystem(), settings.splitting, settings.h
    masses = parameters.masses(system)
    clusters = [Group(kind.particles, kind.graph) for kind in bodies.clusters.kinds]
    without_terms = (Molecules(clusters, masses, bodies.owner),) if clusters else ()
    if fast is None or not fast.acts(scheme, h):
        return Served(without_terms)
    repetitions = fast.repetitions(scheme, h)
    inner = InnerSteps(fast.inner(scheme).sequence, lambda part: repetitions(part * h))
    excerpt = fast.excerpt or bonded_excerpt(system, bodies, fast.named)
    if what := _without_kernel(system, bodies, fast, excerpt):
        if not fast.groups:
            raise NotServedError(
                f"the native engine has no kernel for {what}: put the fast forces into a separate force group, as "
                "separate_bonded(system) does, and name this group in fast=, such as (1,)"
            )
        return Served(without_terms, Evaluated(fast.groups, inner, what))
    if excerpt is None:
        return Served(without_terms)
    single = np.setdiff1d(excerpt.particles, bodies.clusters.particles)
    groups = [*_chosen(clusters, excerpt.particles, True), Group(single[:, None])]
    without = _chosen(clusters, excerpt.particles, False)
    fixed, customs = _by_form(excerpt.forces, settings.groups)
    terms = terms_of(fixed, settings.groups)
    assert terms is not None  # the kernels support all fast forces here
    with_terms = Molecules(groups, masses, bodies.owner, terms, customs, inner, late=fast.excerpt is not None)
    require_few_terms(with_terms.particles_of_terms, MOST_TERMS if on_gpu else None)
    return Served((with_terms, *([Molecules(without, masses, bodies.owner)] if without else [])))


def _chosen(groups: Sequence[Group], particles: Indices, wanted: bool) -> list[Group]:
    """Return the clusters with (or, unless `wanted`, without) fast forces, which act on the given particles."""
    some = [(group, np.isin(group.particles, particles).any(axis=1) == wanted) for group in groups]
    return [group._replace(particles=group.particles[chosen]) for group, chosen in some if chosen.any()]


def require_small_clusters(bodies: RigidBodies, largest: int | None) -> None:
    """Raise NotServedError if a cluster has more than `largest` atoms; None means any number."""
    for kind in bodies.clusters.kinds:
        if largest is not None and kind.particles.shape[1] > largest:
            raise NotServedError(
                f"constraints join {kind.particles.shape[1]} atoms in {kind.name(0)}, but the native engine supports "
                f"at most {largest} on a GPU: create the System with constraints=HBonds"
            )


def _by_form(forces: Sequence[Bonded], groups: int) -> tuple[list[Bonded], tuple[Custom, ...]]:
    """Return the forces that have kernels of their own, and those in given groups (bits) that are expressions."""
    fixed = [force for force in forces if has_known_form(force.force)]
    others = [force for force in forces if not has_known_form(force.force)]
    return fixed, tuple(Custom.of(force) for force in others if groups >> force.force.getForceGroup() & 1)


def require_few_terms(particles_of_terms: Sequence[Indices], most: int | None) -> None:
    """Raise NotServedError if a particle is in more than `most` bonded terms; None means any number."""
    count = np.bincount(np.concatenate([of_kind.ravel() for of_kind in particles_of_terms]), minlength=1)
    if most is not None and count.max() > most:
        raise NotServedError(
            f"particle {count.argmax()} is in {count.max()} bonded terms, but the native engine supports at most "
            f"{most} on a GPU: distribute the terms over several particles, or use a CustomExternalForce for restraints"
        )


def _without_kernel(
    system: openmm.System, bodies: RigidBodies, fast: FastForces, excerpt: Excerpt | None
) -> str | None:
    """Return a description of the fast forces that no kernel supports, or None."""
    for force in acting(system):
        if groups_of(force) & set(fast.named) and not isinstance(force, BONDED_FORCES):
            return f"the fast force {force.getName()}, which is not a bonded force"
    if excerpt is None:
        return None
    if excerpt.on_sites:
        return f"the fast force {excerpt.on_sites[0].force.getName()} on virtual sites"
    if len(excerpt.part.turning):
        return f"fast forces on {bodies.name(int(excerpt.part.turning[0]))}, which is rigid"
    periodic = (of.force.getName() for of in excerpt.forces if of.force.usesPeriodicBoundaryConditions())
    return next((f"the fast force {name}, which uses periodic boundary conditions" for name in periodic), None)
