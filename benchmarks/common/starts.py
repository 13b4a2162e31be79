"""The starts of benchmarks: Contexts, and States drawn from the canonical distribution."""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm
from openmm import app, unit

#: The gas constant in kJ/mol/K.
R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
ONE_THREAD = {"Threads": "1"}
#: Of the CPU platform, for the same numbers at every run.
REPEATED = ONE_THREAD | {"DeterministicForces": "true"}


def context_of(
    system: openmm.System,
    integrator: openmm.Integrator,
    start: Any = None,
    platform: str = "CPU",
    properties: dict[str, str] | None = None,
) -> openmm.Context:
    """Return a Context, at a start if there is one; on the CPU platform it gives the same numbers at every run."""
    if properties is None:
        properties = REPEATED if platform == "CPU" else {}
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform), properties)
    if start is not None:
        put(context, start)
    return context


def put(context: openmm.Context, start: Any) -> None:
    """Put a Context to a State, to a pair of positions and velocities, or to positions."""
    if isinstance(start, openmm.State):
        context.setPeriodicBoxVectors(*start.getPeriodicBoxVectors())
        start = start.getPositions(), start.getVelocities()
    positions, *velocities = start if isinstance(start, tuple) else (start,)
    context.setPositions(positions)
    if velocities:
        context.setVelocities(*velocities)
    else:
        context.computeVirtualSites()


def simulation_of(
    topology: app.Topology,
    system: openmm.System,
    integrator: openmm.Integrator,
    start: openmm.State | None = None,
    threads: int = 1,
    device: str = "",
) -> app.Simulation:
    """Return a Simulation of a copy of the System, on the CPU platform or on a device in mixed precision."""
    platform = openmm.Platform.getPlatform(device or "CPU")
    properties = {"Precision": "mixed"} if device else {"Threads": f"{threads}"}
    made = app.Simulation(topology, openmm.XmlSerializer.clone(system), integrator, platform, properties)
    if start is not None:
        put(made.context, start)
    return made


def thermostat(kelvin: float = 300.0, seed: int = 1, step: float = 0.002) -> openmm.LangevinMiddleIntegrator:
    """Return OpenMM's Langevin integrator with a friction of 5/ps."""
    integrator = openmm.LangevinMiddleIntegrator(kelvin, 5.0, step)
    integrator.setRandomNumberSeed(seed)
    return integrator


def canonical(
    context: openmm.Context, *steps: int, seed: int = 1, tolerance: float = 10.0, iterations: int = 0
) -> list[openmm.State]:
    """Return States after these numbers of steps of a Context with a `thermostat`, from the nearest minimum on."""
    integrator, found = context.getIntegrator(), []
    openmm.LocalEnergyMinimizer.minimize(context, tolerance, iterations)
    context.setVelocitiesToTemperature(integrator.getTemperature(), seed)
    for some in steps:
        integrator.step(some)
        found.append(context.getState(positions=True, velocities=True))
    return found


def masses_of(system: openmm.System) -> np.ndarray:
    """Return the masses of all particles in amu."""
    return np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])


def positions_and_velocities(state: openmm.State) -> tuple[np.ndarray, np.ndarray]:
    """Return those of a State, (n, 3) each, in nm and nm/ps."""
    return state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value
