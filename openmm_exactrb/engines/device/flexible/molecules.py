"""What flexible molecules in a Context consist of, and which of them the kernels serve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context.synchronisation import require_positions
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.device.flexible.blocks import Group
from openmm_exactrb.engines.device.flexible.constraints import LARGEST
from openmm_exactrb.engines.device.flexible.inner import InnerSteps
from openmm_exactrb.kernels.records import Terms
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.multiple_time_steps.bonded import BONDED_FORCES
from openmm_exactrb.multiple_time_steps.compiled_forces import NO_TERMS, terms_of, unknown
from openmm_exactrb.multiple_time_steps.excerpt import Excerpt, bonded_excerpt
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces, fast_forces
from openmm_exactrb.openmm_access import arrays

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class NotServedError(Exception):
    """The kernels do not serve some molecules or forces; the text says which, and what to do."""


@dataclass(frozen=True)
class Molecules:
    """What flexible molecules consist of.

    Attributes
    ----------
    groups : sequence of Group
        Their clusters, single atoms and atoms without mass included.
    masses : (n_particles,) array
        Of all particles of the System.
    body_of : (n_particles,) array
        The body of each particle, among all; -1 for none.
    terms : Terms
        Their fast forces, of particles of the System.
    inner : InnerSteps or None
        None without fast forces.
    late : bool
        Whether drifts between the last heat exchange and the end of a step begin the next one.
    """

    groups: Sequence[Group]
    masses: Array
    body_of: Indices
    terms: Terms = NO_TERMS
    inner: InnerSteps | None = None
    late: bool = False


class Found(NamedTuple):
    """The bodies of a Context and its fast forces.

    Attributes
    ----------
    bodies : RigidBodies
        With flexible molecules, two particles with a constraint between them are a cluster.
    whole : RigidBodies
        The same as the host has them: such a pair is a linear body.
    fast : FastForces or None
    """

    bodies: RigidBodies
    whole: RigidBodies
    fast: FastForces | None


def found(context: Any, settings: Any) -> Found:
    """Return the bodies of a Context and its fast forces."""
    require_positions(context)
    system, x = context.getSystem(), arrays.positions(context.getState(positions=True))
    box = arrays.periodic_box(context)
    whole = find_bodies(system, x, settings.named, box)
    fast = fast_forces(system, whole, settings.fast)
    if not len(whole.clusters) and fast is None:
        return Found(whole, whole, None)
    bodies = find_bodies(system, x, settings.named, box, pairs=True)
    if fast is None or fast.excerpt is not None:  # which bodies are in an excerpt depends on pairs
        fast = fast_forces(system, bodies, settings.fast)
    return Found(bodies, whole, fast)


def molecules_of(
    system: openmm.System, bodies: RigidBodies, fast: FastForces | None, settings: Any
) -> Molecules | None:
    """Return the molecules whose atoms constraints hold or fast forces move, None if there are none.

    Parameters
    ----------
    system : openmm.System
    bodies : RigidBodies
    fast : FastForces or None
        Both as `found` returns them.
    settings : Settings

    Raises
    ------
    NotServedError
        If a cluster is too large, or fast forces are of other kinds, or act on rigid bodies.
    """
    _refuse_large(bodies)
    scheme, h = settings.splitting, settings.h
    excerpt = None if fast is None or not fast.acts(scheme, h) else _excerpt(system, bodies, fast)
    masses = np.array([mass._value for mass in map(system.getParticleMass, range(system.getNumParticles()))])
    clusters = [Group(kind.particles, kind.pairs, kind.lengths) for kind in bodies.clusters.kinds]
    if fast is None or excerpt is None:
        return Molecules(clusters, masses, bodies.owner) if clusters else None
    single = np.setdiff1d(excerpt.particles, bodies.clusters.particles)
    repetitions = fast.repetitions(scheme, h)
    return Molecules(
        [*clusters, Group(single[:, None], np.zeros((0, 2), dtype=np.int64), np.zeros(0))],
        masses,
        bodies.owner,
        _terms(excerpt, settings.groups),
        InnerSteps(fast.inner(scheme).sequence, lambda part: repetitions(part * h)),
        late=fast.excerpt is not None,
    )


def _refuse_large(bodies: RigidBodies) -> None:
    for kind in bodies.clusters.kinds:
        if kind.particles.shape[1] > LARGEST:
            raise NotServedError(
                f"constraints hold {kind.particles.shape[1]} atoms together, {kind.name(0)}, and the device has "
                f"kernels for {LARGEST} at most: create the System with constraints=HBonds"
            )


def _excerpt(system: openmm.System, bodies: RigidBodies, fast: FastForces) -> Excerpt | None:
    """Return the fast forces on the atoms of molecules."""
    excerpt = fast.excerpt
    if excerpt is None:
        named = [group for group in range(32) if fast.groups >> group & 1]
        for force in system.getForces():
            if force.getForceGroup() in named and not isinstance(force, BONDED_FORCES):
                raise NotServedError(f"the device has no kernel for a fast {type(force).__name__}")
        excerpt = bonded_excerpt(system, bodies, named)
    if excerpt is None:
        return None
    turning = excerpt.part.turning
    if len(turning):
        raise NotServedError(f"fast forces act on {bodies.name(int(turning[0]))}, which the device keeps rigid")
    if force := unknown(excerpt.system):
        raise NotServedError(f"the device has no kernel for the fast force {force}")
    return excerpt


def _terms(excerpt: Excerpt, groups: int) -> Terms:
    """Return the terms of an excerpt in some groups (bits), numbered as in the whole System."""
    terms, number = terms_of(excerpt.system, groups), excerpt.particles
    assert terms is not None  # all of them are known
    maps = np.concatenate([number[terms.maps[:, :8]], terms.maps[:, 8:]], axis=1)
    names = ("bonds", "angles", "torsions", "pairs", "impropers")
    return terms._replace(maps=maps, **{name: number[getattr(terms, name)] for name in names})
