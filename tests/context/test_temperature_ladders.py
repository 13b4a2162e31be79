"""OpenMM's samplers of several temperatures, on small molecules with all distances constrained.

The centre of each molecule is in a harmonic trap, so that energies at a temperature are gamma distributed: a molecule
has 3/2 kT of potential and f/2 kT of kinetic energy, and the partition functions of the states are known.
"""

import itertools
import random

import numpy as np
import openmm
import pytest
from openmm import app, unit
from test_temperatures import KB, MOLECULES

import openmm_exactrb as rb
from thermostatted import simulation_of

LADDER = np.array([200.0, 260.0])
STATES = [{"temperature": kelvin * unit.kelvin} for kelvin in LADDER]
COUNT, FREQUENCY, STEP = 4, 10.0, 0.2
LONG = pytest.mark.validate
ROUNDS = [60, pytest.param(2500, marks=LONG)]


def trapped(name, redraw):
    """Return a Simulation of molecules in traps; ten steps forget energies, to exp(-4).

    Where momenta are drawn anew the scheme is symmetric in time. At the end of a step of the default they are half a
    kick behind positions and depend on them; with others the energy in the traps falls by 3% at these steps.
    """
    masses, x, _, _ = MOLECULES[name]
    system, n = openmm.System(), len(masses)
    trap = openmm.CustomCentroidBondForce(1, f"{sum(masses) * FREQUENCY**2 / 2}*(x1^2+y1^2+z1^2)")
    for first in range(0, COUNT * n, n):
        for mass in masses:
            system.addParticle(mass)
        for i, j in itertools.combinations(range(n), 2):
            system.addConstraint(first + i, first + j, np.linalg.norm(x[i] - x[j]))
        trap.addBond([trap.addGroup(list(range(first, first + n)))], [])
    system.addForce(trap)
    scheme = "BAOAB" if redraw else None
    integrator = rb.ExactRigidBodyLangevinIntegrator(LADDER[0], 2 * FREQUENCY, STEP / FREQUENCY, scheme)
    integrator.setRandomNumberSeed(5)
    simulation = simulation_of(integrator, system, np.tile(x, (COUNT, 1)))
    integrator.setVelocitiesToTemperature(LADDER[0], 5)
    simulation.step(20)
    return simulation


def kinetic_energy(simulation):
    return simulation.context.getState(energy=True).getKineticEnergy()._value


def freedom_of(name, redraw):
    """Return twice what the kinetic energy at the end of a step is in kT: that in a trap is known for each scheme."""
    return MOLECULES[name][3] - 3 * redraw * STEP**2 / 4


def check(energies, freedom, kelvin):
    """Compare energies with the gamma distribution of freedom/2 kT; critically damped traps correlate them."""
    correlation = (3.0 * np.exp(-2.0)) ** 2
    samples = len(energies) * (1.0 - correlation) / (1.0 + correlation)
    mean = np.mean(energies) / (KB * kelvin)
    assert abs(mean - freedom / 2) < 4.0 * np.sqrt(freedom / 2 / samples)


@pytest.mark.parametrize("redraw", [False, pytest.param(True, marks=LONG)], ids=["rescaled", "redrawn"])
@pytest.mark.parametrize("name", ["CO2", "methane", "benzene"])
@pytest.mark.parametrize("rounds", ROUNDS)
def test_replica_exchange_samples_each_temperature(name, rounds, redraw):
    random.seed(1)
    simulation = trapped(name, redraw)
    sampler = app.ReplicaExchangeSampler(STATES, simulation, 10, reinitializeVelocities=redraw)
    potential, kinetic, visited = ([], []), ([], []), set()

    def report(sampler):
        for replica, state in enumerate(sampler.replicaStateIndex):
            visited.add((replica, state))
            potential[state].append(sampler.replicaStateEnergy[replica][state]._value)
            simulation.context.setState(sampler.replicaConformation[replica])
            kinetic[state].append(kinetic_energy(simulation))

    sampler.simulate(10)
    sampler.reporters.append(report)
    sampler.simulate(rounds)
    assert len(visited) == 4
    for state, kelvin in enumerate(LADDER):
        check(potential[state], 3 * COUNT, kelvin)
        check(kinetic[state], freedom_of(name, redraw) * COUNT, kelvin)


def tempering(simulation, weights, _):
    sampler = app.SimulatedTempering(
        simulation, LADDER * unit.kelvin, weights=weights, tempChangeInterval=10, reportFile=None
    )
    return sampler, lambda: sampler.currentTemperature


def expanded(simulation, weights, redraw):
    sampler = app.ExpandedEnsembleSampler(STATES, simulation, 10, reinitializeVelocities=redraw, weights=weights)
    return sampler, lambda: sampler.currentStateIndex


KINDS = [(tempering, False), (expanded, False), pytest.param(expanded, True, marks=LONG)]


@pytest.mark.parametrize(("kind", "redraw"), KINDS, ids=["tempering", "expanded", "expanded, redrawn"])
@pytest.mark.parametrize("name", ["CO2", *(pytest.param(name, marks=LONG) for name in ["methane", "benzene"])])
@pytest.mark.parametrize("rounds", [150, pytest.param(5000, marks=LONG)])
def test_tempering_and_expanded_ensembles_sample_each_temperature(kind, redraw, name, rounds):
    """With the weights of the partition functions, which go as T^(3N/2), both states are equally likely."""
    random.seed(2)
    simulation = trapped(name, redraw)
    _sampler, state = kind(simulation, list(-1.5 * COUNT * np.log(LADDER / LADDER[0])), redraw)
    potential, kinetic = ([], []), ([], [])
    for _ in range(rounds):
        simulation.step(9)
        before = state()
        assert simulation.integrator.getTemperature()._value == LADDER[before]
        potential[before].append(simulation.context.getState(energy=True).getPotentialEnergy()._value)
        kinetic[before].append(kinetic_energy(simulation))
        simulation.step(1)
    assert abs(len(potential[0]) - rounds / 2) < 6.0 * np.sqrt(rounds) / 2  # successive ones are correlated by a fifth
    for energies, freedom in (potential, 3), (kinetic, freedom_of(name, redraw)):
        for found, kelvin in zip(energies, LADDER, strict=True):
            check(found, freedom * COUNT, kelvin)
