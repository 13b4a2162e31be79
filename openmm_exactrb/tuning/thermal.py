"""A start at a temperature."""

from __future__ import annotations

from dataclasses import replace

import openmm
from openmm import unit

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.guard import NonFiniteError
from openmm_exactrb.tuning.error import LOST
from openmm_exactrb.tuning.scales import scales_of
from openmm_exactrb.tuning.start import Start

# Draws of momenta, and steps after each.
_DRAWS, _STEPS = 20, 150


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
    integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=start.bodies, engine="host")
    context = start.context(integrator)
    if minimise and start.bodies is None:
        openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    integrator.setVelocitiesToTemperature(temperature, seed)
    good = _state_of(start, context)
    h, number, failures = 0.05 * scales_of(good).time, 0, 0
    while number < _DRAWS:
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
    """Make some steps, and tell whether the energy changes by less than a tenth of the kinetic energy."""
    energies = []
    for steps in (0, _STEPS):
        try:
            integrator.step(steps)
            energies.append(integrator.totalEnergy()._value)
        except (NonFiniteError, ValueError):  # beyond any number, or so far away that shapes are lost to roundoff
            return False
    kinetic = sum(part._value for part in integrator.kineticEnergies())
    return bool(abs(energies[1] - energies[0]) < LOST * kinetic)


def _state_of(start: Start, context: openmm.Context) -> Start:
    state = context.getState(positions=True, velocities=True)
    return replace(
        start,
        positions=state.getPositions(asNumpy=True).value_in_unit(unit.nanometer),
        velocities=state.getVelocities(asNumpy=True).value_in_unit(unit.nanometer / unit.picosecond),
    )
