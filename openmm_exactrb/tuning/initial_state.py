"""The initial state of all runs, as given or brought to a temperature, and its characteristic times."""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_exactrb.context.updates import BAROSTATS, UPDATES
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.divergence import IntegrationError, NonFiniteError
from openmm_exactrb.openmm_access.platforms import mixed, platform_of
from openmm_exactrb.openmm_access.units import gas_constant_times, stripped
from openmm_exactrb.support import checks
from openmm_exactrb.thermostats import ExactRigidBodyLangevinIntegrator

Array = NDArray[np.float64]

#: A run is unstable once its total energy is off by this fraction of the kinetic energy.
LOST = 0.1

# Extent in nm that a particle is given, which has no shape.
_EXTENT = 0.1

# Of the Langevin dynamics that brings a start to a temperature: step and friction over the characteristic time, steps
# in a part of it, parts, and the last parts over which the temperature is a mean.
_STEP, _FRICTION, _STEPS, _PARTS, _LAST = 0.05, 0.2, 150, 20, 10
_MINIMISER_ITERATIONS = 1000  # enough to remove overlaps; it need not converge
# Accepted deviation of the kinetic energy: a fraction, since a large system absorbs heat, and standard deviations.
_SLACK, _DEVIATIONS = 0.1, 5.0


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
    #: The System with what acts between steps, which `system` lacks; None if nothing does.
    whole: openmm.System | None = None

    @property
    def periods(self) -> list[int]:
        """Steps between two moves of each barostat of the whole System."""
        forces = [] if self.whole is None else self.whole.getForces()
        barostats = [force for force in forces if type(force).__name__ in BAROSTATS]
        return [period for force in barostats if (period := force.getFrequency())]

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
        kinds, box = start.getDataTypes(), start.getPeriodicBoxVectors()
        if not kinds & openmm.State.Positions:
            raise ValueError("the State has no positions: make it with getState(positions=True, velocities=True)")
        if velocities is None and kinds & openmm.State.Velocities:
            velocities = start.getVelocities(asNumpy=True)
        if kinds & openmm.State.Parameters:
            parameters |= dict(start.getParameters())
        start = start.getPositions(asNumpy=True)
    if start is None:
        raise ValueError("there is no start: pass a State or positions, or a Simulation")
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
    notes = [f"errors are those without the {', '.join(left_out)} of the System; costs include it"] if left_out else []
    whole = system if left_out else None
    return InitialState(twin, x, v, box, parameters, fastest.getName(), precision, named, groups, whole), notes


def _coordinates(values: Any, system: openmm.System, in_unit: unit.Unit, what: str) -> Array:
    array = checks.array(stripped(values, in_unit), what, f"numbers of shape (n, 3) in {in_unit}")
    if array.shape != (system.getNumParticles(), 3):
        raise ValueError(
            f"{what} have the shape {array.shape}, but the System has {system.getNumParticles()} particles"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{what} are not finite")
    return array


@contextlib.contextmanager
def diverging() -> Iterator[None]:
    """Turn OpenMM's exception for coordinates that are NaN into NonFiniteError; other exceptions pass."""
    try:
        yield
    except openmm.OpenMMException as error:
        if "NaN" not in str(error):
            raise
        raise NonFiniteError(str(error)) from error


class Characteristics(NamedTuple):
    """Size and characteristic times of a system."""

    #: Rigid bodies, and other particles.
    n_bodies: int
    #: Kinetic energy in kJ/mol per body.
    kinetic: float
    #: 1/omega in ps, at most `free`. omega², the mean square frequency in equilibrium, is the mean of force²/mass and
    #: torque²/inertia divided by kT.
    time: float
    #: Time in ps in which free bodies turn by a radian, and particles without a shape fly over 0.1 nm.
    free: float


def characteristics(integrator: ExactRigidBodyIntegrator, context: openmm.Context) -> Characteristics:
    """Return size and characteristic times of the system in a Context; ValueError if nothing moves or no force acts."""
    bodies, state = integrator.bodyState()
    context.computeVirtualSites()
    groups = integrator.getIntegrationForceGroups()
    forces = context.getState(forces=True, groups=groups).getForces(asNumpy=True)._value
    if not np.isfinite(forces).all():
        raise ValueError("the forces at the start are not finite: minimise the energy first")
    (force, torque), kinetic = bodies.forces(state, forces), sum(bodies.kinetic_energies(state))
    moments = np.broadcast_to(bodies.inertia.T, torque.shape)
    turning = torque[moments > 0.0] ** 2 / moments[moments > 0.0]
    square = float((force**2 / bodies.mass).sum() + turning.sum())
    if not kinetic > 0.0 or not square > 0.0:
        raise ValueError("nothing moves or no force acts: there is no energy error to measure")
    free = _free_time(bodies, kinetic)
    return Characteristics(len(bodies), kinetic / len(bodies), min(math.sqrt(2.0 * kinetic / square), free), free)


def _free_time(bodies: RigidBodies, kinetic: float) -> float:
    """Return the time of a turn by a radian or a flight over an extent: 1/rms of the inverse times."""
    kT = 2.0 * kinetic / (bodies.translational_freedom + bodies.rotational_freedom)
    moments = np.broadcast_to(bodies.inertia, (bodies.n_turning, 3))
    moments = moments[moments > 0.0]
    inverse = np.concatenate([1.0 / moments, 1.0 / (bodies.mass[bodies.n_turning :] * _EXTENT**2)])
    return float(1.0 / math.sqrt(kT * inverse.mean()))


def thermalised(state: InitialState, temperature: float, seed: int, minimise: bool) -> InitialState:
    """Bring a state to a temperature in K by Langevin dynamics; ValueError if it does not reach it."""
    integrator = ExactRigidBodyLangevinIntegrator(temperature, 0.0, 1e-6, bodies=state.bodies, engine="host")
    integrator.setRandomNumberSeed(seed + 1)
    context = state.context(integrator)
    if minimise:
        integrator.minimizeEnergy(10.0, _MINIMISER_ITERATIONS)
    integrator.setVelocitiesToTemperature(temperature, seed)
    kinetic: list[float] = []
    with contextlib.suppress(IntegrationError), diverging():
        for _ in range(_PARTS):
            time = characteristics(integrator, context).time
            integrator.setStepSize(_STEP * time)
            integrator.setFriction(_FRICTION / time)
            integrator.step(_STEPS)
            kinetic.append(sum(part._value for part in integrator.kineticEnergies()))
    freedom = sum(integrator.degreesOfFreedom())
    mean = float(np.mean(kinetic[-_LAST:])) if len(kinetic) == _PARTS else math.inf
    ratio = 2.0 * mean / (freedom * gas_constant_times(temperature))
    if not abs(ratio - 1.0) < _SLACK + _DEVIATIONS * math.sqrt(2.0 / (freedom * _LAST)):
        raise ValueError(f"the start cannot be brought to {temperature:g} K: minimise its energy first")
    return state.updated(context)
