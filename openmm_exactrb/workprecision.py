"""Measure energy error and wall time of schemes on a user's own system, all from the same start."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.bodies import RigidBodies, find_bodies
from openmm_exactrb.integrator import COUPLINGS, ExactRigidBodyIntegrator, NonFiniteError
from openmm_exactrb.schemes import Scheme

Array = NDArray[np.float64]

#: The baseline: OpenMM's own leapfrog with constraints.
VERLET = "VerletIntegrator"
# A run is unstable once its energy is off by this part of the kinetic energy.
_LOST = 0.1
_SAMPLES, _FEWEST_SAMPLES = 300, 48
_WINDOWS = (8, 4, 2, 1)


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
    bodies : sequence of sequences of int, optional
        As in `ExactRigidBodyIntegrator`.
    """

    system: openmm.System
    positions: Array
    velocities: Array
    box: Any = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    platform: str = "CPU"
    properties: Mapping[str, str] = field(default_factory=dict)
    bodies: Sequence[Sequence[int]] | None = None

    def context(self, integrator: openmm.Integrator) -> openmm.Context:
        """Return a Context in this state."""
        platform = openmm.Platform.getPlatform(self.platform)
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


class _Mover(Protocol):
    """What runs one method: a scheme of ours, or OpenMM's Verlet."""

    stages: int

    def begin(self, h: float) -> None: ...
    def move(self, steps: int) -> None: ...
    def energy(self) -> float: ...
    def seconds_per_evaluation(self, steps: int) -> float: ...


class _Ours:
    """A scheme of the catalogue with the exact rotor."""

    def __init__(self, start: Start, scheme: Scheme) -> None:
        self._start, self.stages = start, scheme.stages
        self._integrator = ExactRigidBodyIntegrator(1e-6, scheme=scheme, bodies=start.bodies)
        self._context = start.context(self._integrator)

    def begin(self, h: float) -> None:
        self._integrator.setStepSize(h)
        self._context.setPositions(self._start.positions)
        self._context.setVelocities(self._start.velocities)

    def move(self, steps: int) -> None:
        self._integrator.step(steps)

    def energy(self) -> float:
        """Return the total energy in kJ/mol."""
        return float(self._integrator.totalEnergy()._value)

    def seconds_per_evaluation(self, steps: int) -> float:
        self._integrator.timings.reset()
        self._integrator.step(steps)
        return self._integrator.timings.total / self._integrator.timings.evaluations


class _Verlet:
    """OpenMM's leapfrog, whose velocities are half a step late."""

    stages = 1

    def __init__(self, start: Start) -> None:
        self._start = start
        self._integrator = openmm.VerletIntegrator(1e-6)
        self._integrator.setConstraintTolerance(1e-10)
        self._context = start.context(self._integrator)
        masses = [start.system.getParticleMass(i)._value for i in range(start.system.getNumParticles())]
        self._inverse_masses = np.array([[1.0 / m if m > 0.0 else 0.0] for m in masses])
        self._bodies = find_bodies(start.system, start.positions)
        self._h = 0.0

    def begin(self, h: float) -> None:
        """Set the positions at the start, and the velocities half a step before it."""
        self._h = h
        self._integrator.setStepSize(h)
        self._context.setPositions(self._start.positions)
        self._context.applyConstraints(1e-10)
        forces = self._context.getState(forces=True).getForces(asNumpy=True)._value
        self._context.setVelocities(self._start.velocities - 0.5 * h * forces * self._inverse_masses)
        self._context.applyVelocityConstraints(1e-10)

    def move(self, steps: int) -> None:
        self._integrator.step(steps)

    def energy(self) -> float:
        """Return the total energy at a full step in kJ/mol.

        Forces move the velocities on by half a step. Constraint forces within a rigid body change neither its momentum
        nor its angular momentum, so that these give the kinetic energy exactly.
        """
        state = self._context.getState(positions=True, velocities=True, forces=True, energy=True)
        forces = state.getForces(asNumpy=True)._value
        v = state.getVelocities(asNumpy=True)._value + 0.5 * self._h * forces * self._inverse_masses
        fitted = self._bodies.fit(state.getPositions(asNumpy=True)._value, v)
        return float(state.getPotentialEnergy()._value + sum(self._bodies.kinetic_energies(fitted)))

    def seconds_per_evaluation(self, steps: int) -> float:
        begun = time.perf_counter()
        self._integrator.step(steps)
        self._context.getState(positions=True)  # waits for platforms that work in the background
        return (time.perf_counter() - begun) / steps


@dataclass(frozen=True)
class Series:
    """Energies of one run.

    Attributes
    ----------
    energies : (n,) array
        Total energy in kJ/mol a body.
    interval : float
        Time between two of them in ps.
    stable : bool
        Whether the run came to its end with its energy.
    """

    energies: Array
    interval: float
    stable: bool

    def error(self, horizon: float) -> float:
        """Return the standard deviation to expect within a run of a length in ps; see `expected_error`."""
        return expected_error(self.energies, self.interval, horizon) if self.stable else math.inf


def expected_error(energies: Array, interval: float, horizon: float) -> float:
    """Extrapolate the standard deviation of an energy to a longer run.

    The variance within windows of 1/8, 1/4, 1/2 and all of the run, as a power of their length, is carried on to the
    horizon; the power is kept between 0 (the energy swings about a mean) and 1 (it wanders as a random walk does).
    A walk is known badly from one run, so that its part is raised by up to a half: of random walks known over half the
    horizon 1 in 40 then exceeds twice the answer, and 1 in 18 of those that consist of rare jumps.

    Parameters
    ----------
    energies : (n,) array
        n of 16 or more, at equal times.
    interval : float
        Time between two of them.
    horizon : float
        Length of the longer run, in the unit of `interval`.

    Returns
    -------
    float
        In the unit of `energies`.
    """
    n = len(energies)
    lengths = [n // k for k in _WINDOWS]
    logs = np.log(np.maximum([_window_variance(energies, m) for m in lengths], np.finfo(float).tiny))
    x = np.log(np.array(lengths) / n)
    weights = np.sqrt(np.array([4.0, 3.0, 2.0, 1.0]))
    slope, at_full_length = np.polyfit(x, logs, 1, w=weights)
    power = min(max(float(slope), 0.0), 1.0)
    known = math.exp(0.5 * (float(at_full_length) + power * math.log(max(horizon / (n * interval), 1.0))))
    return (1.0 + 0.5 * power) * known


def _window_variance(energies: Array, m: int) -> float:
    """Return the mean variance within windows of m samples."""
    k = len(energies) // m
    return float(energies[: k * m].reshape(k, m).var(axis=1).mean())


class Bench:
    """Runs methods from one start.

    Parameters
    ----------
    start : Start
        Of a System that conserves its energy, with velocities.

    Attributes
    ----------
    n_bodies : int
        Rigid bodies and particles beside them.
    time_scale : float
        1/omega in ps, where omega² is the mean square of force over mass, and of torque over moment of inertia, over
        kT: the root mean square frequency in equilibrium.
    kinetic : float
        Kinetic energy at the start in kJ/mol a body.

    Raises
    ------
    ValueError
        If the System has no rigid bodies, positions do not fit, or nothing moves.
    """

    def __init__(self, start: Start) -> None:
        self.start = start
        integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=start.bodies)
        context = start.context(integrator)
        bodies, state = integrator.bodyState()
        context.computeVirtualSites()
        forces = context.getState(forces=True).getForces(asNumpy=True)._value
        if not np.isfinite(forces).all():
            raise ValueError("the forces at the start are not finite: minimise the energy first")
        kinetic = sum(bodies.kinetic_energies(state))
        self.n_bodies = len(bodies)
        self.kinetic = kinetic / self.n_bodies
        self.time_scale = _time_scale(bodies, *bodies.forces(state, forces), kinetic)
        self._movers: dict[str, _Mover] = {}

    @property
    def has_baseline(self) -> bool:
        """Whether OpenMM's Verlet integrator moves the same bodies: constraints hold all of them."""
        return self.start.bodies is None and self.start.system.getNumConstraints() > 0

    def mover(self, method: str | Scheme) -> _Mover:
        """Return what runs a scheme, or the baseline `VERLET`."""
        name = method.name if isinstance(method, Scheme) else VERLET
        if name not in self._movers:
            self._movers[name] = _Ours(self.start, method) if isinstance(method, Scheme) else _Verlet(self.start)
        return self._movers[name]

    def run(self, method: str | Scheme, step: float, duration: float) -> Series:
        """Run from the start.

        Parameters
        ----------
        method : Scheme or `VERLET`
        step : float
            Of the whole scheme, in ps.
        duration : float
            In ps; at least 48 steps are made.

        Returns
        -------
        Series
            Not stable, and shorter, if the energy leaves its value at the start by a tenth of the kinetic energy.
        """
        mover = self.mover(method)
        every = max(1, round(duration / _SAMPLES / step))
        energies: list[float] = []
        with np.errstate(all="ignore"):
            try:
                mover.begin(step)
                first = mover.energy() / self.n_bodies
                while len(energies) < max(_FEWEST_SAMPLES, math.ceil(duration / (every * step))):
                    mover.move(every)
                    energies.append(mover.energy() / self.n_bodies)
                    if not abs(energies[-1] - first) < _LOST * self.kinetic:
                        return Series(np.array(energies), every * step, False)
            except (NonFiniteError, ValueError, openmm.OpenMMException):  # blown up, or constraints no longer met
                return Series(np.array(energies), every * step, False)
        return Series(np.array(energies), every * step, True)

    def seconds_per_evaluation(
        self, methods: Sequence[str | Scheme], interval: float, repeats: int = 7, evaluations: int = 28
    ) -> list[float]:
        """Time a force evaluation within `step`, with all that the integrator does beside it.

        Parameters
        ----------
        methods : sequence of Scheme or `VERLET`
        interval : float
            Time a force evaluation in ps, at which all of them are stable.
        repeats, evaluations : int
            Rounds through all methods, and force evaluations in each; the fastest round counts, as
            whatever else the machine does only adds to it.

        Returns
        -------
        list of float
            In seconds.
        """
        rounds = []
        for _ in range(repeats):
            times = []
            for mover in map(self.mover, methods):
                mover.begin(mover.stages * interval)
                mover.move(1)
                times.append(mover.seconds_per_evaluation(max(2, round(evaluations / mover.stages))))
            rounds.append(times)
        return [float(t) for t in np.min(rounds, axis=0)]


def _time_scale(bodies: RigidBodies, force: Array, torque: Array, kinetic: float) -> float:
    moments = np.broadcast_to(bodies.inertia.T, torque.shape)
    turning = torque[moments > 0.0] ** 2 / moments[moments > 0.0]
    square = float((force**2 / bodies.mass).sum() + turning.sum())
    if not kinetic > 0.0 or not square > 0.0:
        raise ValueError("nothing moves or no force acts: there is no energy error to measure")
    return math.sqrt(2.0 * kinetic / square)


def thermalised(start: Start, temperature: float, seed: int, minimise: bool) -> Start:
    """Draw momenta at a temperature and let them exchange energy with the positions, some times.

    Parameters
    ----------
    start : Start
    temperature : float
        In K.
    seed : int
    minimise : bool
        Whether to minimise the energy before.

    Raises
    ------
    ValueError
        If the start is too far from any equilibrium to be run.
    """
    integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=start.bodies)
    context = start.context(integrator)
    if minimise and start.bodies is None:
        openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    integrator.setVelocitiesToTemperature(temperature, seed)
    good = _state_of(start, context)
    h, number, failures = 0.05 * Bench(good).time_scale, 0, 0
    while number < 20:
        integrator.setVelocitiesToTemperature(temperature, seed + number)
        integrator.setStepSize(h)
        if _conserves(integrator):
            good, number, h = _state_of(start, context), number + 1, 1.1 * h
            continue
        failures, h = failures + 1, 0.5 * h
        if failures > 40:
            raise ValueError(f"the start cannot be brought to {temperature:g} K: minimise its energy first")
        context.setPositions(good.positions)
    return good


def _conserves(integrator: ExactRigidBodyIntegrator) -> bool:
    """Make 150 steps, and tell whether the energy changes by less than a tenth of the kinetic energy."""
    energies = []
    for steps in (0, 150):
        try:
            integrator.step(steps)
            energies.append(integrator.totalEnergy()._value)
        except (NonFiniteError, ValueError):  # beyond any number, or so far away that shapes are lost to roundoff
            return False
    kinetic = sum(part._value for part in integrator.kineticEnergies())
    return bool(abs(energies[1] - energies[0]) < _LOST * kinetic)


def _state_of(start: Start, context: openmm.Context) -> Start:
    state = context.getState(positions=True, velocities=True)
    return Start(
        start.system,
        state.getPositions(asNumpy=True).value_in_unit(unit.nanometer),
        state.getVelocities(asNumpy=True).value_in_unit(unit.nanometer / unit.picosecond),
        start.box,
        start.parameters,
        start.platform,
        start.properties,
        start.bodies,
    )
