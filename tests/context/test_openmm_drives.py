"""OpenMM's samplers and minimisers drive the native engine as they drive the host: the same numbers, to roundoff."""

import random

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from both_engines import apart, maker, pair
from places import device_platform
from starts import held

pytestmark = [pytest.mark.library, pytest.mark.opencl]
LADDER = 300.0 * 1.05 ** np.arange(3) * unit.kelvin


def droplet(engine):
    """Return a Simulation of a droplet in a trap with a thermostat."""
    topology, system, positions = rb.rigid_water(6)
    trap = openmm.CustomExternalForce("50*(x^2+y^2+z^2)")
    for i in range(0, system.getNumParticles(), 3):
        trap.addParticle(i)
    system.addForce(trap)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, engine=engine)
    integrator.setRandomNumberSeed(3)
    simulation = app.Simulation(topology, system, integrator, device_platform(), {"Precision": "double"})
    simulation.context.setPositions(positions)
    integrator.setVelocitiesToTemperature(300.0, 1)
    return simulation


def test_simulated_tempering_visits_the_temperatures_of_the_host():
    visited, contexts = [], []
    for engine in ("host", "native"):
        random.seed(1)
        simulation = droplet(engine)
        tempering = app.SimulatedTempering(simulation, LADDER, tempChangeInterval=5, reportFile=None)
        visited.append([tempering.currentTemperature for _ in range(8) if not tempering.step(5)])
        contexts.append(simulation.context)
    assert visited[0] == visited[1]
    assert len(set(visited[0])) > 1
    assert apart(*contexts) < 1e-9


def test_replica_exchange_swaps_as_on_the_host():
    found = []
    for engine in ("host", "native"):
        random.seed(1)
        states = [{"temperature": kelvin} for kelvin in LADDER]
        sampler = app.ReplicaExchangeSampler(states, droplet(engine), 5)
        indices = []
        for _ in range(4):
            sampler.simulate(1)
            indices.append(list(sampler.replicaStateIndex))
        found.append((indices, [state.getPositions(asNumpy=True)._value for state in sampler.replicaConformation]))
    assert found[0][0] == found[1][0]
    assert len({tuple(index) for index in found[0][0]}) > 1
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=0.0, atol=1e-9)


def test_a_minimum_is_that_of_the_host():
    energies = []
    for engine in ("host", "native"):
        simulation = droplet(engine)
        simulation.step(3)
        before = simulation.context.getState(energy=True).getPotentialEnergy()._value
        simulation.integrator.minimizeEnergy(tolerance=1.0)
        energies.append(simulation.context.getState(energy=True).getPotentialEnergy()._value)
        assert energies[-1] < before - 10.0
        simulation.step(3)
        x = held(simulation.context)[0].reshape(-1, 3, 3)
        np.testing.assert_allclose(np.linalg.norm(x[:, 0] - x[:, 1], axis=1), 0.09572, rtol=0.0, atol=1e-12)
    assert energies[1] == pytest.approx(energies[0], abs=1e-3)


def test_virtual_sites_across_bodies_move_as_on_the_host():
    _, system, positions = rb.rigid_water(4)
    positions = np.array(positions._value)
    (force,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    site = system.addParticle(0.0)
    system.setVirtualSite(site, openmm.ThreeParticleAverageSite(0, 3, 6, 0.2, 0.3, 0.5))
    force.addParticle(0.5, 0.1, 0.0)
    for i in range(9):
        force.addException(i, site, 0.0, 0.1, 0.0)
    positions = np.vstack([positions, positions[[0, 3, 6]].mean(axis=0)])
    contexts = pair(system, positions, maker("W2_1", 0.001))
    for context in contexts:
        context.getIntegrator().step(20)
    assert apart(*contexts) < 1e-11
    x = held(contexts[1])[0]
    np.testing.assert_allclose(x[site], 0.2 * x[0] + 0.3 * x[3] + 0.5 * x[6], rtol=0.0, atol=1e-14)
