"""The bodies of a Context together with its fast forces, which decide how constrained pairs of particles move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import openmm

from openmm_exactrb.context.synchronisation import require_positions
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.images import Shapes
from openmm_exactrb.multiple_time_steps import virtual_sites
from openmm_exactrb.multiple_time_steps.bonded import BondedNumbers
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces, MultipleTimeSteps, fast_forces
from openmm_exactrb.multiple_time_steps.resonance import Resonances
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.support.types import Array


class Found(NamedTuple):
    """The bodies of a Context and its fast forces.

    Attributes
    ----------
    bodies : RigidBodies
        If there are flexible molecules, a constrained pair of particles is a cluster.
    whole : RigidBodies
        The same bodies, but with each constrained pair of particles as a linear body.
    fast : FastForces or None
    masses : (n_particles,) array
        The masses of particles, including those of virtual sites with bonded terms.
    """

    bodies: RigidBodies
    whole: RigidBodies
    fast: FastForces | None
    masses: Array

    def renewed(self, system: openmm.System, settings: MultipleTimeSteps | None) -> Found:
        """Return the fast forces with the present numbers of the forces of the System."""
        return self._replace(fast=_among(self.bodies, fast_forces(system, self.whole, settings, self.masses)))

    def numbers(self, system: openmm.System) -> BondedNumbers | None:
        """Return the numbers of the bonded forces between bodies, or None if there are no such forces."""
        return BondedNumbers.of(system, virtual_sites.owners(system, self.bodies.owner))

    def resonances(self, system: openmm.System) -> Resonances | None:
        """Return the resonances of the fast forces, or None if there are none."""
        if self.fast is None:
            return None
        excerpt = self.fast.excerpt
        forces = None if excerpt is None else excerpt.forces
        return Resonances(system, self.fast.named or range(32), forces, self.masses)


def found(context: Any, named: Sequence[Sequence[int]] | None, settings: MultipleTimeSteps | None) -> Found:
    """Return the bodies of a Context, those `named` included, and its fast forces by the settings of inner steps."""
    require_positions(context)
    system, x = context.getSystem(), arrays.positions(context.getState(positions=True))
    box = arrays.periodic_box(context)
    whole = find_bodies(system, x, named, box)
    joined = cache(lambda: x if box is None else Shapes(whole).whole(x, box))
    masses = virtual_sites.masses(system, joined)
    fast = fast_forces(system, whole, settings, masses)
    if not len(whole.clusters) and fast is None:
        return Found(whole, whole, None, masses)
    bodies = find_bodies(system, joined(), named, pairs=True)
    return Found(bodies, whole, _among(bodies, fast), masses)


def _among(bodies: RigidBodies, fast: FastForces | None) -> FastForces | None:
    """Return fast forces that act on given bodies."""
    if fast is None or fast.excerpt is None:
        return fast
    return replace(fast, excerpt=replace(fast.excerpt, bodies=bodies))
