"""OpenMM's samplers of several temperatures, on small rigid molecules with all distances constrained."""

import itertools
import random

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from test_temperatures import KB, MOLECULES, simulation_of

LADDER = [200.0, 260.0]
COUNT, STIFF = 4, 500.0


def trapped(name, seed=0):
    """Return a Simulation of molecules whose centres are in harmonic traps: <U> is 3/2 kT each."""
    masses, x, _, _ = MOLECULES[name]
    system, places, n = openmm.System(), [], len(masses)
    trap = openmm.CustomCentroidBondForce(1, f"{STIFF / 2}*(x1^2+y1^2+z1^2)")
    for copy in range(COUNT):
        first = system.getNumParticles()
        for mass in masses:
            system.addParticle(mass)
        for i, j in itertools.combinations(range(n), 2):
            system.addConstraint(first + i, first + j, np.linalg.norm(x[i] - x[j]))
        trap.addBond([trap.addGroup(list(range(first, first + n)))], [])
        places.append(x)
    system.addForce(trap)
    integrator = rb.ExactRigidBodyLangevinIntegrator(LADDER[0], 10.0, 0.004)
    integrator.setRandomNumberSeed(5)
    return simulation_of(system, np.concatenate(places), integrator)


def check(energies, kelvin):
    """Energies of traps are gamma distributed: the mean is 3/2 kT, the variance 3/2 (kT)², for each molecule."""
    kT = KB * kelvin
    samples = max(len(energies) / 4.0, 1.0)  # successive ones are correlated
    assert abs(np.mean(energies) - 1.5 * COUNT * kT) < 4.5 * kT * np.sqrt(1.5 * COUNT / samples)


@pytest.mark.parametrize("redraw", [False, True], ids=["rescaled", "redrawn"])
@pytest.mark.parametrize("name", ["CO2", "methane", "benzene"])
def test_replica_exchange_samples_each_temperature(name, redraw):
    random.seed(1)
    states = [{"temperature": kelvin * unit.kelvin} for kelvin in LADDER]
    simulation = trapped(name)
    sampler = app.ReplicaExchangeSampler(states, simulation, 50, reinitializeVelocities=redraw)
    found, moved = {0: [], 1: []}, []
    for round_ in range(120):
        sampler.simulate(1)
        moved.append(tuple(sampler.replicaStateIndex))
        if round_ >= 20:
            before = sampler._previousReplicaStateIndex  # noqa: SLF001
            for replica, state in enumerate(before):
                found[state].append(sampler.replicaStateEnergy[replica][state]._value)
    assert len(set(moved)) == 2
    for state, kelvin in enumerate(LADDER):
        check(found[state], kelvin)


@pytest.mark.parametrize("kind", ["tempering", "expanded"])
@pytest.mark.parametrize("redraw", [False, True], ids=["rescaled", "redrawn"])
def test_tempering_and_expanded_ensembles_move_between_temperatures(kind, redraw):
    random.seed(2)
    simulation = trapped("CO2")
    if kind == "tempering":
        if redraw:
            pytest.skip("SimulatedTempering has no such option")
        temperatures = [kelvin * unit.kelvin for kelvin in LADDER]
        sampler = app.SimulatedTempering(simulation, temperatures=temperatures, tempChangeInterval=20, reportFile=None)
        inner = sampler._sampler  # noqa: SLF001
    else:
        states = [{"temperature": kelvin * unit.kelvin} for kelvin in LADDER]
        inner = sampler = app.ExpandedEnsembleSampler(states, simulation, 20, reinitializeVelocities=redraw)
    visited = set()
    for _ in range(200):
        sampler.step(20)
        visited.add(inner.currentStateIndex)
        kelvin = LADDER[inner.currentStateIndex]
        assert simulation.integrator.getTemperature()._value == kelvin
        assert np.isfinite(simulation.integrator.computeSystemTemperature()._value)
    assert visited == {0, 1}
