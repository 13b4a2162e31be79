"""The states of the bodies at the last heat exchange of a step, and before and after it."""

from __future__ import annotations

from collections.abc import Sequence

from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.engines.engine import Settings
from openmm_exactrb.engines.native.flexible.molecules import Served
from openmm_exactrb.engines.native.sequences import Part
from openmm_exactrb.library.library import Machine
from openmm_exactrb.mechanics.free_motion import free_motion
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces
from openmm_exactrb.steps.sequence import behind_exchange, inverse


def at_exchange(settings: Settings, served: Served, fast: FastForces | None, sync: Synchronisation) -> State:
    """Return the state at the last heat exchange; raise ValueError if OpenMM evaluates fast forces after it."""
    behind = behind_exchange(settings.scheme.sequence)
    if behind and (evaluated := served.evaluated) is not None:
        raise ValueError(
            f"the native engine has no kernel for {evaluated.what}, so it cannot compute the energy at the heat "
            f"exchange of {settings.outer.name}: use engine='host'"
        )
    drift, state = free_motion(sync.bodies, settings.rotor).drift, sync.state
    for _, part in inverse(behind):
        state = drift(state, part * settings.h)
    if any(molecules.late for molecules in served.molecules):  # late steps end at the exchange
        assert fast is not None
        assert fast.excerpt is not None
        nested = fast.excerpt.part
        state = nested.into(state, nested.of(sync.state))
    return state


def around_exchange(sync: Synchronisation, machine: Machine, parts: Sequence[Part]) -> tuple[State, State]:
    """Return the states before and after the last heat exchange; positions and orientations may be later ones."""
    before, after = (State(*(a.copy() for a in sync.state)) for _ in range(2))
    for part in parts:
        part.read_exchange(machine, (before, after))
    return before, after
