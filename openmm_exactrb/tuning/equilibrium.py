"""Characteristic times of a system, and initial states at a temperature."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import openmm

from openmm_exactrb.context.units import gas_constant_times
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.divergence import IntegrationError, NonFiniteError
from openmm_exactrb.tuning.initial_state import InitialState

#: A run is unstable once its total energy is off by this fraction of the kinetic energy.
LOST = 0.1

# Extent in nm that stands for the shape of a particle, which has none.
_EXTENT = 0.1

# Draws of momenta, steps after each, and the most draws before the temperature counts as out of reach.
_DRAWS, _STEPS, _MOST_DRAWS = 20, 150, 60
# Runs that may diverge; each of them halves the step.
_FAILURES = 40
# The temperature and the frequencies are means over this many of the last draws.
_LAST = 10
_MINIMISER_ITERATIONS = 1000  # enough to remove overlaps; it need not converge
# Accepted deviation of the kinetic energy: this fraction, which allows for a large system that still takes up heat, and
# this many standard deviations.
_SLACK, _DEVIATIONS = 0.1, 5.0


@contextmanager
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

    #: Rigid bodies, and particles beside them.
    n_bodies: int
    #: Kinetic energy in kJ/mol per body.
    kinetic: float
    #: 1/omega in ps, where omega² is the mean square of force over mass, and of torque over moment of inertia, divided
    #: by kT: in equilibrium the mean square frequency. It is averaged over the initial state and earlier instants, and
    #: at most `free`, since bodies that are far apart may meet later.
    time: float
    #: Time in ps in which free bodies turn by a radian, and particles without a shape fly over 0.1 nm.
    free: float


def characteristics(
    integrator: ExactRigidBodyIntegrator, context: openmm.Context, earlier_frequencies: Sequence[float] = ()
) -> Characteristics:
    """Return size and characteristic times of the system in a Context; ValueError if nothing moves or no force acts."""
    frequencies = [_frequency(integrator, context), *earlier_frequencies]
    bodies, state = integrator.bodyState()
    kinetic = sum(bodies.kinetic_energies(state))
    free = _free_time(bodies, kinetic)
    time = 1.0 / math.sqrt(np.square(frequencies).mean())
    return Characteristics(len(bodies), kinetic / len(bodies), min(time, free), free)


def _frequency(integrator: ExactRigidBodyIntegrator, context: openmm.Context) -> float:
    """Return the root mean square frequency in 1/ps at an instant; see `Characteristics.time`."""
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
    return math.sqrt(square / (2.0 * kinetic))


def _free_time(bodies: RigidBodies, kinetic: float) -> float:
    """Return the time of a turn by a radian or a flight over an extent: 1/rms of the inverse times."""
    kT = 2.0 * kinetic / (bodies.translational_freedom + bodies.rotational_freedom)
    moments = np.broadcast_to(bodies.inertia, (bodies.n_turning, 3))
    moments = moments[moments > 0.0]
    inverse = np.concatenate([1.0 / moments, 1.0 / (bodies.mass[bodies.n_turning :] * _EXTENT**2)])
    return float(1.0 / math.sqrt(kT * inverse.mean()))


# -- a state at a temperature --------------------------------------------------------------------------------------


def thermalised(state: InitialState, temperature: float, seed: int, minimise: bool) -> InitialState:
    """Draw momenta at a temperature in K repeatedly; after each draw they exchange energy with the positions.

    The initial state that is returned knows the frequencies after the last draws. Bodies stay rigid when the energy is
    minimised first. ValueError if the state is too far from equilibrium to reach the temperature.
    """
    integrator, context = state.probe()
    if minimise:
        integrator.minimizeEnergy(10.0, _MINIMISER_ITERATIONS)
    integrator.setVelocitiesToTemperature(temperature, seed)
    good = state.updated(context)
    h, failures = 0.05 * characteristics(*good.probe()).time, 0
    kinetic: list[float] = []
    frequencies: list[float] = []
    while len(kinetic) < _DRAWS or not _is_at(temperature, kinetic[-_LAST:], integrator):
        if len(kinetic) == _MOST_DRAWS or failures > _FAILURES:
            raise ValueError(f"the start cannot be brought to {temperature:g} K: minimise its energy first")
        integrator.setVelocitiesToTemperature(temperature, seed + len(kinetic))
        integrator.setStepSize(h)
        if not _conserves(integrator):
            failures, h = failures + 1, 0.5 * h
            context.setPositions(good.positions)
            continue
        good, h = state.updated(context), 1.1 * h
        kinetic.append(_kinetic(integrator))
        frequencies.append(_frequency(integrator, context))
    return replace(good, earlier_frequencies=tuple(frequencies[-_LAST:-1]))


def _is_at(temperature: float, kinetic: Sequence[float], integrator: ExactRigidBodyIntegrator) -> bool:
    """Return whether independent kinetic energies in kJ/mol are compatible with a temperature in K."""
    freedom = sum(integrator.degreesOfFreedom())
    ratio = 2.0 * np.mean(kinetic) / (freedom * gas_constant_times(temperature))
    width = math.sqrt(2.0 / (freedom * len(kinetic)))
    return bool(abs(ratio - 1.0) < _SLACK + _DEVIATIONS * width)


def _conserves(integrator: ExactRigidBodyIntegrator) -> bool:
    """Make some steps and return whether the total energy was conserved."""
    before = integrator.totalEnergy()._value
    try:
        with diverging():
            integrator.step(_STEPS)
    except IntegrationError:
        return False
    return bool(abs(integrator.totalEnergy()._value - before) < LOST * _kinetic(integrator))


def _kinetic(integrator: ExactRigidBodyIntegrator) -> float:
    return float(sum(part._value for part in integrator.kineticEnergies()))
