"""The bodies of a Context together with its fast forces, which decide how constrained pairs of particles move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import openmm

from openmm_exactrb.context.synchronisation import require_positions
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.images import Shapes
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces, MultipleTimeSteps, fast_forces
from openmm_exactrb.multiple_time_steps.resonance import Resonances
from openmm_exactrb.openmm_access import arrays


class Found(NamedTuple):
    """The bodies of a Context and its fast forces.

    Attributes
    ----------
    bodies : RigidBodies
        If there are flexible molecules, a constrained pair of particles is a cluster.
    whole : RigidBodies
        The same bodies, but with each constrained pair of particles as a linear body.
    fast : FastForces or None
    """

    bodies: RigidBodies
    whole: RigidBodies
    fast: FastForces | None

    def renewed(self, system: openmm.System, settings: MultipleTimeSteps | None) -> Found:
        """Return the fast forces with the present numbers of the forces of the System."""
        return self._replace(fast=_among(self.bodies, fast_forces(system, self.whole, settings)))

    def resonances(self, system: openmm.System) -> Resonances | None:
        """Return the resonances of the fast forces, or None if there are none."""
        if self.fast is None:
            return None
        excerpt = self.fast.excerpt
        return Resonances(system, self.fast.named or range(32), None if excerpt is None else excerpt.forces)


def found(context: Any, named: Sequence[Sequence[int]] | None, settings: MultipleTimeSteps | None) -> Found:
    """Return the bodies of a Context, those `named` included, and its fast forces by the settings of inner steps."""
    require_positions(context)
    system, x = context.getSystem(), arrays.positions(context.getState(positions=True))
    box = arrays.periodic_box(context)
    whole = find_bodies(system, x, named, box)
    fast = fast_forces(system, whole, settings)
    if not len(whole.clusters) and fast is None:
        return Found(whole, whole, None)
    joined = x if box is None else Shapes(whole).whole(x, box)
    bodies = find_bodies(system, joined, named, pairs=True)
    return Found(bodies, whole, _among(bodies, fast))


def _among(bodies: RigidBodies, fast: FastForces | None) -> FastForces | None:
    """Return fast forces that act on given bodies."""
    if fast is None or fast.excerpt is None:
        return fast
    return replace(fast, excerpt=replace(fast.excerpt, bodies=bodies))
