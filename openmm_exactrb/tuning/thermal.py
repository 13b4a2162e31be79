"""A start at a temperature."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.context.units import gas_constant_times
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.guard import NonFiniteError
from openmm_exactrb.tuning.error import LOST
from openmm_exactrb.tuning.movers import blow_ups
from openmm_exactrb.tuning.scales import frequency_of, scales_of
from openmm_exactrb.tuning.start import Start

# Draws of momenta, steps after each, and the most draws where the temperature is not yet that which was asked for.
_DRAWS, _STEPS, _MOST = 20, 150, 60
# Runs after a draw that may lose their energy; the next one has half their step.
_FAILURES = 40
# So many of the last draws tell the temperature, and how fast the system is.
_LAST = 10
# Iterations of the minimiser, which need not come to an end.
_ITERATIONS = 1000
# The kinetic energy may be off by this part, and by so many standard deviations: a large system that still takes up
# some heat is near enough.
_SLACK, _DEVIATIONS = 0.1, 5.0


def thermalised(start: Start, temperature: float, seed: int, minimise: bool) -> Start:
    """Draw momenta at a temperature and let them exchange energy with the positions, some times.

    Parameters
    ----------
    start : Start
    temperature : float
        In K.
    seed : int
    minimise : bool
        Whether to minimise the energy before; all bodies stay rigid.

    Returns
    -------
    Start
        Which knows the frequencies after the last draws.

    Raises
    ------
    ValueError
        If the start is too far from any equilibrium to be run, or does not take the temperature.
    """
    integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=start.bodies, engine="host")
    context = start.context(integrator)
    if minimise:
        integrator.minimizeEnergy(10.0, _ITERATIONS)
    integrator.setVelocitiesToTemperature(temperature, seed)
    good = _state_of(start, context)
    h, failures = 0.05 * scales_of(good).time, 0
    heats: list[float] = []
    frequencies: list[float] = []
    while len(heats) < _DRAWS or not _is_at(temperature, heats[-_LAST:], integrator):
        if len(heats) == _MOST or failures > _FAILURES:
            raise ValueError(f"the start cannot be brought to {temperature:g} K: minimise its energy first")
        integrator.setVelocitiesToTemperature(temperature, seed + len(heats))
        integrator.setStepSize(h)
        if not _conserves(integrator):
            failures, h = failures + 1, 0.5 * h
            context.setPositions(good.positions)
            continue
        good, h = _state_of(start, context), 1.1 * h
        heats.append(_kinetic(integrator))
        frequencies.append(frequency_of(integrator, context))
    return replace(good, before=tuple(frequencies[-_LAST:-1]))


def _is_at(temperature: float, kinetic: list[float], integrator: ExactRigidBodyIntegrator) -> bool:
    """Tell whether kinetic energies in kJ/mol, after draws of their own, are about those of a temperature in K."""
    freedom = sum(integrator.degreesOfFreedom())
    ratio = 2.0 * np.mean(kinetic) / (freedom * gas_constant_times(temperature))
    width = math.sqrt(2.0 / (freedom * len(kinetic)))
    return bool(abs(ratio - 1.0) < _SLACK + _DEVIATIONS * width)


def _conserves(integrator: ExactRigidBodyIntegrator) -> bool:
    """Make some steps, and tell whether the energy changes by less than a tenth of the kinetic energy."""
    before = integrator.totalEnergy()._value
    try:
        with blow_ups():
            integrator.step(_STEPS)
    except NonFiniteError:
        return False
    return bool(abs(integrator.totalEnergy()._value - before) < LOST * _kinetic(integrator))


def _kinetic(integrator: ExactRigidBodyIntegrator) -> float:
    return float(sum(part._value for part in integrator.kineticEnergies()))


def _state_of(start: Start, context: openmm.Context) -> Start:
    state = context.getState(positions=True, velocities=True)
    return replace(
        start,
        positions=state.getPositions(asNumpy=True).value_in_unit(unit.nanometer),
        velocities=state.getVelocities(asNumpy=True).value_in_unit(unit.nanometer / unit.picosecond),
    )
