"""The samplers of openmm.app, which drive an integrator themselves."""

import numpy as np
import openmm
import pytest
from boxes import FEMTOSECONDS, misfit, quietly, simulation_of, solvent, water, water_system
from openmm import app, unit

import openmm_exactrb as rb
import starts


def distance_of_two_oxygens():
    force = openmm.CustomBondForce("r")
    force.addBond(0, 3, [])
    force.setUsesPeriodicBoundaryConditions(True)
    return force


def test_metadynamics(tmp_path):
    topology, positions = solvent()
    system = water_system(topology)
    variable = app.BiasVariable(distance_of_two_oxygens(), 0.1, 1.0, 0.05, False)
    bias = app.Metadynamics(system, [variable], 300 * unit.kelvin, 5.0, 2.0 * unit.kilojoules_per_mole, 2)
    simulation = simulation_of(topology, system, positions)
    quietly(bias.step, simulation, 10)
    assert simulation.currentStep == 10
    assert bias.getFreeEnergy()._value.min() < -1.0
    (value,) = bias.getCollectiveVariables(simulation)
    assert 0.1 < value < 1.0
    assert misfit(simulation) < 1e-6


def test_metadynamics_of_a_bond_at_rest_is_no_blow_up():
    """What rounding does to the potential energy is many times the kinetic energy there."""
    system, bond, topology = openmm.System(), openmm.HarmonicBondForce(), app.Topology()
    residue = topology.addResidue("bond", topology.addChain())
    for _ in range(2):
        topology.addAtom("H", app.element.hydrogen, residue)
        system.addParticle(1.0)
    bond.addBond(0, 1, 1.0, 100000.0)
    system.addForce(bond)
    length = openmm.CustomBondForce("r")
    length.addBond(0, 1, [])
    variable = app.BiasVariable(length, 0.94, 1.06, 0.02, False)
    bias = app.Metadynamics(system, [variable], 300 * unit.kelvin, 3.0, 5.0 * unit.kilojoules_per_mole, 10)
    simulation = starts.simulation_of(
        topology, system, rb.ExactRigidBodyIntegrator(0.001, scheme="V2"), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    )
    bias.step(simulation, 300)
    assert simulation.currentStep == 300


@pytest.mark.skipif(not hasattr(app, "ReplicaExchangeSampler"), reason="this OpenMM has no ReplicaExchangeSampler")
def test_replicas_have_noise_of_their_own():
    """They begin at the same step with the same State, as many trajectories of one process may."""
    simulation = water(rb.ExactRigidBodyLangevinIntegrator(300 * unit.kelvin, 5 / unit.picosecond, 4 * FEMTOSECONDS))
    quietly(simulation.step, 5)
    sampler = app.ReplicaExchangeSampler([{"temperature": t * unit.kelvin} for t in (300, 300, 300)], simulation, 10)
    sampler.simulate(1)
    x = [state.getPositions(asNumpy=True)._value for state in sampler.replicaConformation]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(x[i] - x[j]).max() > 1e-3
