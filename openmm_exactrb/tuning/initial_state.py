"""The initial state of all runs, either as given or brought to a temperature."""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import openmm
from openmm import app, unit

from openmm_exactrb.context.solver import mended
from openmm_exactrb.context.updates import UPDATES, names_of_updates
from openmm_exactrb.errors import IntegrationError
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.integrators.states import loadState
from openmm_exactrb.openmm_access.platforms import mixed, platform_of
from openmm_exactrb.openmm_access.units import gas_constant_times, stripped
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array
from openmm_exactrb.tuning.budget import Budget
from openmm_exactrb.tuning.preparation import heat, minimise

# Largest fraction of the budget for bringing a start to a temperature.
_SHARE = 0.33
# Accepted deviation of the kinetic energy: a fraction, because a large system absorbs heat, plus a number of standard
# deviations.
_SLACK, _DEVIATIONS = 0.1, 5.0
# Number of parts of Langevin dynamics between two starts.
_APART = 4


@dataclass(frozen=True)
class InitialState:
    """A System, its state, and the platform that computes its forces."""

    system: openmm.System
    #: Positions, velocities, box and parameters.
    state: openmm.State
    platform: openmm.Platform
    properties: Mapping[str, str] = field(default_factory=dict)
    #: Particles of the bodies passed as `bodies`.
    bodies: list[list[int]] | None = None
    #: Bit mask of the active force groups.
    groups: int = -1

    def context(self, integrator: openmm.Integrator) -> openmm.Context:
        """Return a Context in this state."""
        integrator.setIntegrationForceGroups(self.groups)
        context = openmm.Context(self.system, integrator, self.platform, dict(self.properties))
        loadState(context, self.state)
        return context

    def updated(self, context: openmm.Context) -> InitialState:
        """Return a copy with the state of a Context."""
        return replace(self, state=context.getState(positions=True, velocities=True, parameters=True))

    def probe(self, fast: str | None = None) -> tuple[ExactRigidBodyIntegrator, openmm.Context]:
        """Return an integrator with the bodies of this state, and its Context."""
        integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=self.bodies, fast=fast, engine="host")
        return integrator, self.context(integrator)

    def langevin(self, temperature: float, seed: int) -> tuple[ExactRigidBodyLangevinIntegrator, openmm.Context]:
        """Return a Langevin integrator at a temperature in K, and its Context in this state."""
        integrator = ExactRigidBodyLangevinIntegrator(temperature, 0.0, 1e-6, bodies=self.bodies, engine="host")
        integrator.setRandomNumberSeed(seed + 1)
        return integrator, self.context(integrator)


def conservative(system: openmm.System) -> tuple[openmm.System, list[str]]:
    """Return a copy of a System without thermostats, barostats and motion removers, and the names of those that act.

    Raises
    ------
    ValueError
        If a force cannot be copied.
    """
    try:
        twin = copy.deepcopy(system)
    except Exception as error:  # serialising a PythonForce may raise any error of pickle
        raise ValueError(
            "integrators are compared in copies of the System, which cannot be copied: define the function of each "
            f"PythonForce at the top level of a module ({error})"
        ) from error
    for i in reversed(range(twin.getNumForces())):
        if type(twin.getForce(i)).__name__ in UPDATES:
            twin.removeForce(i)
    return twin, names_of_updates(system)


def initial_state(
    system: Any,
    start: Any = None,
    velocities: Any = None,
    platform: Any = None,
    properties: Any = None,
    bodies: Any = None,
) -> tuple[InitialState, list[str]]:
    """Return the initial state for the arguments of `tune`, and notes; raise ValueError if they are inconsistent."""
    states, groups = [], -1
    if isinstance(system, app.Simulation):
        context, integrator, system = system.context, system.integrator, system.system
        platform = context.getPlatform() if platform is None else platform
        states.append(context.getState(positions=True, velocities=start is None, parameters=True))
        groups = integrator.getIntegrationForceGroups()
        if bodies is None and isinstance(integrator, ExactRigidBodyIntegrator):
            bodies = integrator.getNamedBodies()
    if not isinstance(system, openmm.System):
        raise ValueError(f"the first argument must be an openmm.System or a Simulation, not {type(system).__name__}")
    if isinstance(start, openmm.State):
        states.append(start)
        start = None
    elif start is None and not states:
        raise ValueError(
            "start= is missing: pass a State or positions as start=, or a Simulation instead of the System"
        )
    twin, left_out = conservative(system)
    gathered = openmm.Context(twin, openmm.VerletIntegrator(0.001), platform_of("Reference"))
    for state in states:
        loadState(gathered, state)
    if start is not None:
        gathered.setPositions(_coordinates(start, system, unit.nanometer, "positions"))
    if velocities is not None:
        gathered.setVelocities(_coordinates(velocities, system, unit.nanometer / unit.picosecond, "velocities"))
    chosen = platform_of(platform)
    precision = mixed(chosen) if properties is None else dict(properties)
    named = None if bodies is None else checks.lists_of_indices(bodies, "bodies")
    state = gathered.getState(positions=True, velocities=True, parameters=True)
    notes = [f"errors and costs are those without the {', '.join(left_out)} of the System"] if left_out else []
    return InitialState(twin, state, chosen, precision, named, groups), notes


def _coordinates(values: Any, system: openmm.System, in_unit: unit.Unit, what: str) -> Array:
    array = checks.array(stripped(values, in_unit), what, f"numbers of shape (n, 3) in {in_unit}")
    if array.shape != (system.getNumParticles(), 3):
        raise ValueError(f"{what} must have the shape ({system.getNumParticles()}, 3), not {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} must be finite: replace values that are infinite or nan")
    return array


def thermalised(state: InitialState, temperature: float, seed: int, minimised: bool, budget: Budget) -> InitialState:
    """Bring a state to a temperature in K, within a third of the budget; raise ValueError if this fails."""
    integrator, context = state.langevin(temperature, seed)
    if minimised:
        mended(context)
        minimise(integrator)
    integrator.setVelocitiesToTemperature(temperature, seed)
    least, kinetic = (1.0 - _SHARE) * budget.left, []
    with contextlib.suppress(IntegrationError):
        kinetic = list(heat(integrator, context, may_continue=lambda: budget.left > least))
    freedom, last = sum(integrator.degreesOfFreedom()), max(1, len(kinetic) // 2)
    mean = float(np.mean(kinetic[-last:])) if kinetic else math.inf
    ratio = 2.0 * mean / (freedom * gas_constant_times(temperature))
    if not abs(ratio - 1.0) < _SLACK + _DEVIATIONS * math.sqrt(2.0 / (freedom * last)):
        raise ValueError(
            f"{temperature:g} K was not reached from the given start: pass the State of an equilibrated run, or use a "
            "larger budget"
        )
    return state.updated(context)


def others(state: InitialState, number: int, seed: int) -> list[InitialState]:
    """Return a state and other states at its temperature, separated by short runs with friction.

    A ValueError is raised if no part of such a run succeeds.
    """
    probe, _context = state.probe()
    temperature = probe.computeSystemTemperature()._value
    integrator, context = state.langevin(temperature, seed)
    states = [state]
    for k in range(1, number):
        integrator.setVelocitiesToTemperature(temperature, seed + k)
        done = []
        for _ in range(_APART):
            with contextlib.suppress(IntegrationError):  # the next part starts from the last valid step
                done.append(next(heat(integrator, context)))
        if not done:
            raise ValueError(
                f"every short run at {temperature:.0f} K from the given start diverges: minimise its energy first"
            )
        states.append(state.updated(context))
    return states
