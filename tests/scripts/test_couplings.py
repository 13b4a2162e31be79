"""What acts between steps: all four barostats, and the remover of the motion of the centre."""

import numpy as np
import openmm
import pytest
from boxes import FEMTOSECONDS, coordinates, misfit, quietly, simulation_of, solvent, swing, water, water_system
from openmm import unit

import openmm_exactrb as rb
import starts
from four_barostats import barostats

BAROSTATS = barostats(300)


def in_a_barostat(name, interval, integrator=None):
    topology, positions = solvent()
    system = water_system(topology)
    barostat = BAROSTATS[name](interval)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    return simulation_of(topology, system, positions, integrator)


def sides(simulation):
    return np.array(simulation.context.getState().getPeriodicBoxVectors(asNumpy=True)._value)


@pytest.mark.parametrize("name", BAROSTATS)
def test_a_barostat_changes_the_box_and_no_molecule(name):
    """Its moves are a random walk of the box, which OpenMM's seed does not repeat: the widest point counts."""
    simulation = in_a_barostat(name, 2)
    before, changes = sides(simulation), []
    for _ in range(10):
        quietly(simulation.step, 2)
        assert misfit(simulation) < 1e-6
        changes.append(np.abs(sides(simulation) - before).max())
    assert max(changes) > 1e-4
    assert np.isfinite(simulation.integrator.totalEnergy()._value)


@pytest.mark.parametrize("name", ["isotropic", "flexible"])
def test_a_barostat_that_does_not_act_changes_nothing(name):
    """Steps between its moves are those without it, at their cost: no force more, the same bits."""
    with_it, without = in_a_barostat(name, 1000), water()
    for one in (with_it, without):
        quietly(one.step, 1)
        one.integrator.timings.evaluations = 0
        quietly(one.step, 10)
    np.testing.assert_array_equal(coordinates(with_it), coordinates(without))
    assert with_it.integrator.timings.evaluations <= without.integrator.timings.evaluations


def test_without_motion_of_the_centre():
    topology, positions = solvent()
    simulation = simulation_of(topology, water_system(topology, removeCMMotion=True), positions)
    masses = np.array([simulation.system.getParticleMass(i)._value for i in range(simulation.system.getNumParticles())])
    v = simulation.context.getState(velocities=True).getVelocities(asNumpy=True)._value
    simulation.context.setVelocities(v + np.array([1.0, -2.0, 3.0]))
    quietly(simulation.step, 3)
    v = simulation.context.getState(velocities=True).getVelocities(asNumpy=True)._value
    assert np.abs(masses @ v).max() < 1e-2 * masses.sum()
    assert simulation.integrator.degreesOfFreedom()[0] == 3 * topology.getNumResidues() - 3
    assert swing(simulation) < 1e-3


def test_bodies_named_after_a_flexible_minimisation_are_of_one_kind():
    """A kind a molecule makes a step many times as long; `minimizeEnergy` of ours keeps bodies rigid."""
    topology, positions = solvent()
    bodies = [[a.index for a in residue.atoms()] for residue in topology.residues()]
    system = water_system(topology, rigidWater=False)
    simulation = simulation_of(
        topology, system, positions, rb.ExactRigidBodyIntegrator(1 * FEMTOSECONDS, "V2", bodies=bodies)
    )
    quietly(simulation.step, 2)
    found, _ = simulation.integrator.bodyState()
    assert len(found.kinds) == 1


@pytest.mark.parametrize("fast", [None, "bonded"])
def test_a_barostat_moves_particles_without_mass_as_openmm_does(fast):
    """A molecule of a frozen and a moving atom keeps its bond, and the Context the energy that was decided on."""
    system = openmm.System()
    system.setDefaultPeriodicBoxVectors(*(3.0 * np.eye(3)))
    for mass in (0.0, 12.0, 40.0, 40.0):
        system.addParticle(mass)
    bond = openmm.HarmonicBondForce()
    bond.addBond(0, 1, 0.15, 2e5)
    system.addForce(bond)
    pairs = openmm.NonbondedForce()
    pairs.setNonbondedMethod(pairs.CutoffPeriodic)
    pairs.setCutoffDistance(0.5)
    for _ in range(4):
        pairs.addParticle(0.0, 0.3, 0.1)
    pairs.addException(0, 1, 0.0, 1.0, 0.0)
    system.addForce(pairs)
    barostat = openmm.MonteCarloBarostat(5 * unit.bar, 300 * unit.kelvin, 1)
    barostat.setRandomNumberSeed(2)
    system.addForce(barostat)
    integrator = rb.ExactRigidBodyIntegrator(1e-7, scheme="V2", fast=fast)
    context = starts.context_of(
        system, integrator, [[2.5, 2.5, 2.5], [2.65, 2.5, 2.5], [1.0, 1.0, 1.0], [1.0, 2.0, 1.5]]
    )
    frozen = set()
    for _ in range(40):
        integrator.step(1)
        state = context.getState(positions=True, energy=True)
        x = state.getPositions(asNumpy=True)._value
        assert abs(x[1, 0] - x[0, 0] - 0.15) < 1e-9
        frozen.add(float(x[0, 0]))
    assert len(frozen) > 3
