"""The energy at the last heat exchange, where the errors of a step are of the order of its scheme."""

from __future__ import annotations

from typing import Any

from openmm_exactrb.context.forces import ContextForces
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.free_motion import free_motion
from openmm_exactrb.schemes.sequence import inverse
from openmm_exactrb.schemes.thermostatted import behind_exchange


def energy_at_exchange(sync: Any, settings: Any, timings: Timings) -> float:
    """Return the total energy (kJ/mol) at the last heat exchange of a step that moves all bodies freely.

    Parameters
    ----------
    sync : Synchronised
        Up to date. The Context is moved to the positions at the exchange and back.
    settings : Settings
    timings : Timings
    """
    drift, state = free_motion(sync.bodies, settings.rotor).drift, sync.state
    for _, part in inverse(behind_exchange(settings.scheme.sequence)):
        state = drift(state, part * settings.h)
    try:
        potential = ContextForces(sync.positions, settings.groups, timings).energy_at(state)
    finally:
        sync.push()
    return float(sum(sync.bodies.kinetic_energies(state.rounded)) + potential)
