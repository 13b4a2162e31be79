"""A minimum is one, and what is none is said."""

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
import small_molecules
from openmm_exactrb.errors import MinimisationWarning
from openmm_exactrb.mathematics.quaternions import exponential, matrix, multiply, random
from openmm_exactrb.mechanics.minimise import _along_turns
from starts import context_of, positions_of, simulation_of


def spheres(distance, periodic=False):
    """Return a Context of Lennard-Jones spheres, of which the first two are this far apart (nm)."""
    system, force = openmm.System(), openmm.NonbondedForce()
    for _ in range(8):
        system.addParticle(20.0)
        force.addParticle(0.0, 0.3, 1.0)
    x = 0.4 * np.array(list(np.ndindex(2, 2, 2)), dtype=float) + 0.05
    x[1] = x[0] + [0.0, 0.0, distance]
    if periodic:
        system.setDefaultPeriodicBoxVectors(*np.diag([2.0] * 3))
        force.setNonbondedMethod(force.CutoffPeriodic)
        force.setCutoffDistance(0.9)
        x[1, 2] += 2.0
    system.addForce(force)
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = context_of(system, integrator, x)
    return context, integrator


def test_the_gradient_along_a_turn_is_the_derivative_of_the_energy(rng):
    """Of u . Q v, by finite differences, where the orientation is that of the start times the exponential of a turn."""
    sizes = np.array([0.0, 1e-9, 1e-5, 1e-3, 0.1, 1.0, 3.0, 6.0])
    q, turn, u, v = random(rng, len(sizes)).T, *rng.standard_normal((3, 3, len(sizes)))
    turn *= sizes / np.linalg.norm(turn, axis=0)

    def attitude(theta):
        return matrix(multiply(q, exponential(theta)))

    torque = -np.cross(v, np.einsum("ijn,in->jn", attitude(turn), u), axis=0)
    for axis, h in enumerate(1e-5 * np.eye(3)[:, :, None]):
        change = attitude(turn + h) - attitude(turn - h)
        slope = np.einsum("in,ijn,jn->n", u, change, v) / 2e-5
        np.testing.assert_allclose(-_along_turns(turn, torque)[axis], slope, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("distance", [0.001, 0.0025, 0.0033, 0.01, 0.3])
def test_spheres_that_overlap_are_taken_apart(distance):
    context, integrator = spheres(distance)
    integrator.minimizeEnergy()
    state = context.getState(energy=True, forces=True)
    assert np.abs(state.getForces(asNumpy=True)._value).max() <= 10.0
    assert state.getPotentialEnergy()._value < 0.0


def test_a_start_that_is_not_finite_is_said_with_the_bodies():
    context, integrator = spheres(0.0)
    before = positions_of(context)
    with pytest.raises(rb.NonFiniteError, match="the closest are the bodies 0 and 1, 0 nm apart"):
        integrator.minimizeEnergy()
    np.testing.assert_array_equal(positions_of(context), before)


def test_a_force_that_cannot_get_smaller_is_said():
    system, cusp = openmm.System(), openmm.CustomExternalForce("1000*abs(x)")
    system.addParticle(1.0)
    cusp.addParticle(0)
    system.addForce(cusp)
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = context_of(system, integrator, [[0.3, 0.0, 0.0]])
    with pytest.warns(MinimisationWarning, match="a force of 1e.03 kJ/mol/nm, above the tolerance of 10"):
        integrator.minimizeEnergy()
    assert abs(positions_of(context)[0, 0]) < 1e-3


def test_a_blow_up_names_the_closest_bodies_across_the_box():
    context, integrator = spheres(0.002, periodic=True)
    integrator.setStepSize(0.002)
    with pytest.raises(rb.NonFiniteError, match=r"The closest before the step were the bodies 0 and 1, 0\.00"):
        integrator.step(5)
    assert np.isfinite(positions_of(context)).all()


def test_straight_molecules_are_minimised_by_the_integrator_alone():
    """OpenMM's minimiser ends in a segmentation fault here, or in NaN."""
    molecule = small_molecules.MOLECULES["CO2"]
    x, edge = small_molecules.placed(molecule, 27)
    system, topology = small_molecules.system_of(molecule, 27, edge, 0.7), small_molecules.topology_of(molecule, 27)
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    simulation = simulation_of(topology, system, integrator, x)
    before = integrator.totalEnergy()._value
    with pytest.raises(openmm.OpenMMException, match=r"follow from others: call integrator\.minimizeEnergy\(\)"):
        simulation.minimizeEnergy(maxIterations=20)
    np.testing.assert_array_equal(positions_of(simulation.context), x)
    integrator.minimizeEnergy(maxIterations=20)
    places = positions_of(simulation.context).reshape(-1, 3, 3)
    for i, j, length in molecule.distances:
        np.testing.assert_allclose(np.linalg.norm(places[:, i] - places[:, j], axis=1), length, atol=1e-12)
    assert integrator.totalEnergy()._value < before


def test_openmms_method_does_not_drag_split_molecules_through_the_box():
    topology, system, positions = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)
    edge, whole = system.getDefaultPeriodicBoxVectors()[0][0]._value, positions._value - positions._value[1]
    simulations = [
        simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.001), x) for x in (np.mod(whole, edge), whole)
    ]
    for simulation in simulations:
        simulation.minimizeEnergy(maxIterations=3)
    split, never = map(positions_of, (simulation.context for simulation in simulations))
    assert np.abs(np.mod(whole, edge) - whole).max() > 0.5 * edge
    np.testing.assert_allclose(split - edge * np.round((split - never) / edge), never, atol=1e-9)


@pytest.mark.parametrize("wrong", [0.005, 0.03, 0.07, 1.9])
@pytest.mark.parametrize("frozen", [(0,), (0, 3, 7)])
def test_constraints_between_frozen_particles_are_ignored(frozen, wrong):
    """As by OpenMM: frozen molecules stay where they are, however long the distances within them are."""
    topology, system, positions = rb.rigid_water(8, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.3, seed=4)
    x = np.array(positions._value)
    for molecule in frozen:
        for i in range(3 * molecule, 3 * molecule + 3):
            system.setParticleMass(i, 0.0)
        x[3 * molecule + 1] += [wrong, 0.0, 0.0]
    simulation = simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.001), x)
    before = simulation.context.getState(energy=True).getPotentialEnergy()._value
    simulation.minimizeEnergy(maxIterations=20)
    assert simulation.context.getState(energy=True).getPotentialEnergy()._value < before
    assert simulation.integrator.degreesOfFreedom() == (3 * (8 - len(frozen)),) * 2
    simulation.step(2)
    held = [i for molecule in frozen for i in range(3 * molecule, 3 * molecule + 3)]
    np.testing.assert_array_equal(positions_of(simulation.context)[held], x[held])
