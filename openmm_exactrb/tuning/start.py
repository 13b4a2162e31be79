"""Where all runs begin, out of what a user has at hand."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_exactrb.checks import lists_of_indices
from openmm_exactrb.context.couplings import COUPLINGS
from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.context.platforms import mixed, platform_of
from openmm_exactrb.context.units import stripped
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.images import rejoined

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """Where all runs begin.

    Attributes
    ----------
    system : openmm.System
    positions, velocities : (n, 3) array
        In nm and nm/ps.
    box : sequence of three Vec3, optional
        Periodic box vectors in nm; those of the System unless given.
    parameters : mapping
        Global parameters of the Context.
    platform : str
    properties : mapping
        Of the platform.
    bodies : list of lists of int, optional
        As in `ExactRigidBodyIntegrator`.
    groups : int
        Bits of the force groups that act.
    before : tuple of float
        Root mean square frequencies in 1/ps of instants before this one, where they are known.
    """

    system: openmm.System
    positions: Array
    velocities: Array
    box: Any = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    platform: str = "CPU"
    properties: Mapping[str, str] = field(default_factory=dict)
    bodies: list[list[int]] | None = None
    groups: int = -1
    before: tuple[float, ...] = ()

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


def conservative(system: openmm.System) -> tuple[openmm.System, list[str]]:
    """Return a copy of a System without thermostats, barostats and motion removers, and the names of those."""
    twin, left_out = copy.deepcopy(system), []
    for i in reversed(range(twin.getNumForces())):
        name = type(twin.getForce(i)).__name__
        if name in COUPLINGS:
            left_out.append(name)
            twin.removeForce(i)
    return twin, left_out[::-1]


def start_of(
    system: Any, start: Any, velocities: Any, platform: Any, properties: Any, bodies: Any
) -> tuple[Start, list[str]]:
    """Return where the runs begin, of what a user gave, and what is worth a note.

    Parameters
    ----------
    system, start, velocities, platform, properties, bodies
        As `tune` takes them.

    Raises
    ------
    ValueError
        If something is missing or does not fit.
    """
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
        start, velocities, box, own = _from_state(start, velocities)
        parameters |= own
    if start is None:
        raise ValueError("there is no start: give a State or positions, or a Simulation")
    twin, left_out = conservative(system)
    x = _coordinates(start, system, unit.nanometer, "positions")
    v = np.zeros_like(x)
    if velocities is not None:
        v = _coordinates(velocities, system, unit.nanometer / unit.picosecond, "velocities")
    notes = [f"{', '.join(left_out)} of the System left out of the measurements"] if left_out else []
    if parameters:  # not those of the forces left out
        known = openmm.Context(twin, openmm.VerletIntegrator(0.001), platform_of("Reference")).getParameters()
        parameters = {name: value for name, value in parameters.items() if name in known}
    chosen = platform_of(platform)
    wanted = mixed(chosen) if properties is None else dict(properties)
    named = None if bodies is None else lists_of_indices(bodies, "bodies")
    begin = Start(twin, x, v, box, parameters, chosen.getName(), wanted, named, groups)
    return (_joined(begin) if twin.usesPeriodicBoundaryConditions() else begin), notes


def _joined(start: Start) -> Start:
    """Return a start with the particles of each body, and of each cluster of constraints, in one image of the box."""
    vectors = start.system.getDefaultPeriodicBoxVectors() if start.box is None else start.box
    box = np.array([[*stripped(vector, unit.nanometer)] for vector in vectors], dtype=np.float64)
    bodies = find_bodies(start.system, start.positions, start.bodies, box)
    return replace(start, positions=rejoined(start.positions, bodies, box))


def _from_state(state: openmm.State, velocities: Any) -> tuple[Any, Any, Any, dict[str, float]]:
    kinds = state.getDataTypes()
    if not kinds & openmm.State.Positions:
        raise ValueError("the State has no positions: make it with getState(positions=True, velocities=True)")
    if velocities is None and kinds & openmm.State.Velocities:
        velocities = state.getVelocities(asNumpy=True)
    parameters = dict(state.getParameters()) if kinds & openmm.State.Parameters else {}
    return state.getPositions(asNumpy=True), velocities, state.getPeriodicBoxVectors(), parameters


def _coordinates(values: Any, system: openmm.System, in_unit: unit.Unit, what: str) -> Array:
    if unit.is_quantity(values):
        if not values.unit.is_compatible(in_unit):
            raise ValueError(f"{what} have the unit {values.unit}: give them in {in_unit}")
        values = values.value_in_unit(in_unit)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be numbers of shape (n, 3), not {type(values).__name__}") from None
    if array.shape != (system.getNumParticles(), 3):
        raise ValueError(
            f"{what} have the shape {array.shape}, but the System has {system.getNumParticles()} particles"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{what} are not finite")
    return array
