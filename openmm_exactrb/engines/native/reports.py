"""What is read from the reports of a program: divergence, and temperatures that stay too high."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.context.updates import ContextUpdates
from openmm_exactrb.engines.engine import Settings
from openmm_exactrb.engines.native.flexible.part import FlexiblePart
from openmm_exactrb.engines.native.rigid import RigidPart
from openmm_exactrb.errors import DivergedError, IntegrationError
from openmm_exactrb.library.library import Machine
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.divergence import Overheating, of_step
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces
from openmm_exactrb.multiple_time_steps.resonance import Resonances
from openmm_exactrb.openmm_access.units import gas_constant_times
from openmm_exactrb.support.types import Array

Parts = Sequence[RigidPart | FlexiblePart]


def at_next_step(error: DivergedError, sync: Synchronisation) -> IntegrationError:
    """Return the error for the next step, which diverges; the Context contains the state before it."""
    sync.pull()
    number, time = sync.context.getStepCount() + 1, sync.context.getTime()._value
    return error.kind(of_step(number, time, error.what, sync.state, sync.box()))


def judged(translation: float, rotation: float, invalid: float) -> tuple[float, bool]:
    """Return the kinetic energy (kJ/mol) of a report, and whether the state of any body is invalid."""
    kinetic = translation + rotation
    return kinetic, bool(invalid) or not math.isfinite(kinetic)


def monitor(settings: Settings, bodies: RigidBodies, parts: Parts) -> Overheating | None:
    """Return the monitor of temperatures, or None if the settings exclude it."""
    if settings.watched is None:
        return None
    rigid = sum(3 * part.n for part in parts if isinstance(part, RigidPart))
    return Overheating((rigid, bodies.rotational_freedom, bodies.translational_freedom - rigid), *settings.watched)


def warn_of_resonances(settings: Settings, fast: FastForces | None, resonances: Resonances | None) -> None:
    """Warn once if slow forces may heat fast motions."""
    if fast is None or resonances is None or not settings.accepts_hot_states:
        return
    if fast.acts(settings.splitting, settings.h):
        resonances.warn(settings.splitting, abs(settings.h / settings.splits))


def thermal(settings: Settings, updates: ContextUpdates, sync: Synchronisation) -> float:
    """Return the largest kinetic energy (kJ/mol) attributed to thermostats: twice the canonical mean plus 20 kT."""
    kT = 0.0 if settings.thermostat is None else gas_constant_times(settings.thermostat.temperature)
    kT = max(kT, updates.hottest(sync.context))
    return kT * (sync.bodies.translational_freedom + sync.bodies.rotational_freedom + 20)


def kinetic_by_kind(machine: Machine, parts: Parts) -> Array:
    """Return the kinetic energies (kJ/mol) of the last report: translation, rotation and other particles."""
    return np.asarray(np.sum([part.kinetic_by_kind(machine) for part in parts], axis=0))
