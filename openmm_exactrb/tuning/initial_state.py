"""The initial state of all runs, as given or brought to a temperature, and its characteristic times."""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_exactrb.context.updates import BAROSTATS, UPDATES
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.divergence import IntegrationError
from openmm_exactrb.openmm_access.platforms import mixed, platform_of
from openmm_exactrb.openmm_access.units import gas_constant_times, stripped
from openmm_exactrb.support import checks
from openmm_exactrb.thermostats import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.tuning.budget import Budget
from openmm_exactrb.tuning.preparation import heat, minimise

Array = NDArray[np.float64]

# Part of the budget that bringing a start to a temperature may take.
_SHARE = 0.33
# Accepted deviation of the kinetic energy: a fraction, since a large system absorbs heat, and standard deviations.
_SLACK, _DEVIATIONS = 0.1, 5.0
# Parts of Langevin dynamics between two starts.
_APART = 4


@dataclass(frozen=True)
class InitialState:
    """A System, a state of it, and the platform that computes its forces."""

    system: openmm.System
    #: In nm, of shape (n, 3).
    positions: Array
    #: In nm/ps, of shape (n, 3).
    velocities: Array
    #: Periodic box vectors in nm; by default those of the System.
    box: Any = None
    #: Global parameters of the Context.
    parameters: Mapping[str, float] = field(default_factory=dict)
    platform: str = "CPU"
    properties: Mapping[str, str] = field(default_factory=dict)
    #: Particles of bodies named by hand.
    bodies: list[list[int]] | None = None
    #: Bits of the active force groups.
    groups: int = -1
    #: Steps between two moves of each barostat of the user's System, which `system` lacks.
    periods: tuple[int, ...] = ()

    def context(self, integrator: openmm.Integrator) -> openmm.Context:
        """Return a Context in this state."""
        platform = openmm.Platform.getPlatform(self.platform)
        integrator.setIntegrationForceGroups(self.groups)
        context = openmm.Context(self.system, integrator, platform, dict(self.properties))
        if self.box is not None:
            context.setPeriodicBoxVectors(*self.box)
        for name, value in self.parameters.items():
            context.setParameter(name, value)
        context.setPositions(self.positions)
        context.setVelocities(self.velocities)
        return context

    def updated(self, context: openmm.Context) -> InitialState:
        """Return a copy with the positions and velocities of a Context."""
        now = context.getState(positions=True, velocities=True)
        positions, velocities = now.getPositions(asNumpy=True)._value, now.getVelocities(asNumpy=True)._value
        return replace(self, positions=positions, velocities=velocities)

    def probe(self, fast: str | None = None) -> tuple[ExactRigidBodyIntegrator, openmm.Context]:
        """Return an integrator that knows the bodies, and its Context in this state."""
        integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=self.bodies, fast=fast, engine="host")
        return integrator, self.context(integrator)

    def langevin(self, temperature: float, seed: int) -> tuple[ExactRigidBodyLangevinIntegrator, openmm.Context]:
        """Return an integrator at a temperature in K, and its Context in this state."""
        integrator = ExactRigidBodyLangevinIntegrator(temperature, 0.0, 1e-6, bodies=self.bodies, engine="host")
        integrator.setRandomNumberSeed(seed + 1)
        return integrator, self.context(integrator)


def _periods(system: openmm.System) -> tuple[int, ...]:
    barostats = [force for force in system.getForces() if type(force).__name__ in BAROSTATS]
    return tuple(period for force in barostats if (period := force.getFrequency()))


def conservative(system: openmm.System) -> tuple[openmm.System, list[str]]:
    """Return a copy of a System without thermostats, barostats and motion removers, and the names of these."""
    twin, left_out = copy.deepcopy(system), []
    for i in reversed(range(twin.getNumForces())):
        name = type(twin.getForce(i)).__name__
        if name in UPDATES:
            left_out.append(name)
            twin.removeForce(i)
    return twin, left_out[::-1]


def initial_state(
    system: Any, start: Any, velocities: Any, platform: Any, properties: Any, bodies: Any
) -> tuple[InitialState, list[str]]:
    """Return the initial state for the arguments of `tune`, and notes; raise ValueError if they are inconsistent."""
    box: Any = None
    parameters: dict[str, float] = {}
    groups = -1
    if isinstance(system, app.Simulation):
        context = system.context
        platform = context.getPlatform() if platform is None else platform
        start = context.getState(positions=True, velocities=True) if start is None else start
        box, parameters = context.getState().getPeriodicBoxVectors(), dict(context.getParameters())
        groups = system.integrator.getIntegrationForceGroups()
        if bodies is None and isinstance(system.integrator, ExactRigidBodyIntegrator):
            bodies = system.integrator.getNamedBodies()
        system = system.system
    if not isinstance(system, openmm.System):
        raise ValueError(f"the first argument must be an openmm.System or a Simulation, not {type(system).__name__}")
    if isinstance(start, openmm.State):
        kinds, box = start.getDataTypes(), start.getPeriodicBoxVectors()
        if not kinds & openmm.State.Positions:
            raise ValueError("the State has no positions: make it with getState(positions=True, velocities=True)")
        if velocities is None and kinds & openmm.State.Velocities:
            velocities = start.getVelocities(asNumpy=True)
        if kinds & openmm.State.Parameters:
            parameters |= dict(start.getParameters())
        start = start.getPositions(asNumpy=True)
    if start is None:
        raise ValueError("no start was given: pass a State or positions, or a Simulation")
    twin, left_out = conservative(system)
    x = _coordinates(start, system, unit.nanometer, "positions")
    v = np.zeros_like(x) if velocities is None else velocities
    v = _coordinates(v, system, unit.nanometer / unit.picosecond, "velocities")
    if parameters:  # without those of the forces left out
        known = openmm.Context(twin, openmm.VerletIntegrator(0.001), platform_of("Reference")).getParameters()
        parameters = {name: value for name, value in parameters.items() if name in known}
    fastest = platform_of(platform)
    precision = mixed(fastest) if properties is None else dict(properties)
    named = None if bodies is None else checks.lists_of_indices(bodies, "bodies")
    notes = (
        [f"errors were measured without the {', '.join(left_out)} of the System; costs include it"] if left_out else []
    )
    where = box, parameters, fastest.getName(), precision
    return InitialState(twin, x, v, *where, named, groups, _periods(system)), notes


def _coordinates(values: Any, system: openmm.System, in_unit: unit.Unit, what: str) -> Array:
    array = checks.array(stripped(values, in_unit), what, f"numbers of shape (n, 3) in {in_unit}")
    if array.shape != (system.getNumParticles(), 3):
        raise ValueError(
            f"{what} have the shape {array.shape}, but the System has {system.getNumParticles()} particles"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{what} are not finite: give finite ones")
    return array


def thermalised(state: InitialState, temperature: float, seed: int, minimised: bool, budget: Budget) -> InitialState:
    """Bring a state to a temperature in K, within a third of the budget; raise ValueError if it is not reached."""
    integrator, context = state.langevin(temperature, seed)
    if minimised:
        minimise(integrator)
    integrator.setVelocitiesToTemperature(temperature, seed)
    least, kinetic = (1.0 - _SHARE) * budget.left, []
    with contextlib.suppress(IntegrationError):
        kinetic = list(heat(integrator, context, may_continue=lambda: budget.left > least))
    freedom, last = sum(integrator.degreesOfFreedom()), max(1, len(kinetic) // 2)
    mean = float(np.mean(kinetic[-last:])) if kinetic else math.inf
    ratio = 2.0 * mean / (freedom * gas_constant_times(temperature))
    if not abs(ratio - 1.0) < _SLACK + _DEVIATIONS * math.sqrt(2.0 / (freedom * last)):
        raise ValueError(f"the start cannot be brought to {temperature:g} K: minimise its energy first")
    return state.updated(context)


def others(state: InitialState, number: int, seed: int) -> list[InitialState]:
    """Return a state and others at its temperature, separated by short runs with friction.

    A ValueError is raised if no part of such a run succeeds.
    """
    probe, _context = state.probe()
    bodies, now = probe.bodyState()
    freedom = bodies.translational_freedom + bodies.rotational_freedom
    kT = 2.0 * sum(bodies.kinetic_energies(now)) / freedom
    temperature = kT / gas_constant_times(1.0)
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
                f"every short run at {temperature:.0f} K from the start diverges: minimise the energy of the start "
                "first"
            )
        states.append(state.updated(context))
    return states
