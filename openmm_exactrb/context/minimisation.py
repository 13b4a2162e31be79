"""Minimisation of the potential energy of a Context: bodies stay rigid."""

from __future__ import annotations

from openmm_exactrb.context.forces import ContextForces, Positions
from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.minimise import minimised
from openmm_exactrb.mechanics.state import State


def minimise(sync: Synchronisation, timings: Timings, groups: int, tolerance: float, iterations: int) -> None:
    """Bring the bodies of a Context to a minimum of the potential energy of some force groups (bits).

    Other parameters and errors are those of `openmm_exactrb.mechanics.minimise.minimised`.
    """
    forces = ContextForces(Positions(sync.context, sync.bodies, sync.particles), groups, timings)
    start = sync.state.rounded
    found = minimised(
        sync.bodies, start, lambda state: forces.landscape(State.of(state)), tolerance, iterations, sync.box()
    )
    sync.replace(sync.state.renewed(found))
