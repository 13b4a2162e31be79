"""The initial state of all runs, made from a Simulation, a State or arrays of the user."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_exactrb import checks
from openmm_exactrb.context.platforms import mixed, platform_of
from openmm_exactrb.context.units import stripped
from openmm_exactrb.context.updates import UPDATES
from openmm_exactrb.integrator import ExactRigidBodyIntegrator

Array = NDArray[np.float64]


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
    #: Bits of the force groups that act.
    groups: int = -1
    #: Root mean square frequencies in 1/ps at earlier instants, if they are known.
    earlier_frequencies: tuple[float, ...] = ()

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
        """Return this with the positions and velocities of a Context."""
        now = context.getState(positions=True, velocities=True)
        positions, velocities = now.getPositions(asNumpy=True)._value, now.getVelocities(asNumpy=True)._value
        return replace(self, positions=positions, velocities=velocities)

    def probe(self, fast: str | None = None) -> tuple[ExactRigidBodyIntegrator, openmm.Context]:
        """Return an integrator that knows the bodies, and its Context in this state."""
        integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=self.bodies, fast=fast, engine="host")
        return integrator, self.context(integrator)


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
    """Return the initial state that arguments of `tune` describe, and notes; ValueError if something does not fit."""
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
        start, velocities, box, parameters_of_state = _read(start, velocities)
        parameters |= parameters_of_state
    if start is None:
        raise ValueError("there is no start: give a State or positions, or a Simulation")
    twin, left_out = conservative(system)
    x = _coordinates(start, system, unit.nanometer, "positions")
    v = np.zeros_like(x)
    if velocities is not None:
        v = _coordinates(velocities, system, unit.nanometer / unit.picosecond, "velocities")
    if parameters:  # without those of the forces left out
        known = openmm.Context(twin, openmm.VerletIntegrator(0.001), platform_of("Reference")).getParameters()
        parameters = {name: value for name, value in parameters.items() if name in known}
    fastest = platform_of(platform)
    precision = mixed(fastest) if properties is None else dict(properties)
    named = None if bodies is None else checks.lists_of_indices(bodies, "bodies")
    notes = [f"{', '.join(left_out)} of the System left out of the measurements"] if left_out else []
    return InitialState(twin, x, v, box, parameters, fastest.getName(), precision, named, groups), notes


def _read(state: openmm.State, velocities: Any) -> tuple[Any, Any, Any, dict[str, float]]:
    """Return positions, velocities (unless they are given), box vectors and parameters of a State."""
    kinds = state.getDataTypes()
    if not kinds & openmm.State.Positions:
        raise ValueError("the State has no positions: make it with getState(positions=True, velocities=True)")
    if velocities is None and kinds & openmm.State.Velocities:
        velocities = state.getVelocities(asNumpy=True)
    parameters = dict(state.getParameters()) if kinds & openmm.State.Parameters else {}
    return state.getPositions(asNumpy=True), velocities, state.getPeriodicBoxVectors(), parameters


def _coordinates(values: Any, system: openmm.System, in_unit: unit.Unit, what: str) -> Array:
    array = checks.array(stripped(values, in_unit), what, f"numbers of shape (n, 3) in {in_unit}")
    if array.shape != (system.getNumParticles(), 3):
        raise ValueError(
            f"{what} have the shape {array.shape}, but the System has {system.getNumParticles()} particles"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{what} are not finite")
    return array
