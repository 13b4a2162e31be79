"""Starts in equilibrium, and long runs from them."""

import numpy as np
import openmm

from starts import context_of


def equilibrated(system, positions, platform="Reference", temperature=300.0, picoseconds=2.0, seed=1):
    """Return a State at a temperature."""
    langevin = openmm.LangevinMiddleIntegrator(temperature, 5.0, 0.002)
    langevin.setRandomNumberSeed(seed)
    context = context_of(system, langevin, positions, platform=openmm.Platform.getPlatform(platform))
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    context.setVelocitiesToTemperature(temperature, seed)
    langevin.step(round(picoseconds / 0.002))
    return context.getState(positions=True, velocities=True)


def arrays(state):
    return state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value


def long_run(choice, result, system, state, platform):
    """Return the standard deviation of the energy a body over the horizon, from the start of the survey."""
    integrator = choice.integrator()
    context = context_of(system, integrator, state, platform=openmm.Platform.getPlatform(platform))
    every = max(1, round(result.horizon / 400.0 / choice.step))
    energies = []
    for _ in range(int(result.horizon / (every * choice.step))):
        integrator.step(every)
        kinetic = sum(part._value for part in integrator.kineticEnergies())
        energies.append(context.getState(energy=True).getPotentialEnergy()._value + kinetic)
    return np.std(energies) / result.n_bodies
