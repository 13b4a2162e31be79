"""A body of hundreds of atoms in water, named by hand: its inertia, and that forces within it do nothing."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from benchmarks.cost import large_bodies
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.mathematics import quaternions
from starts import REFERENCE, context_of

ATOMS, WATER = 200, 729  # no atom of the body is within the cutoff of the image of another one


@pytest.fixture(scope="module")
def systems():
    """The same box without and with an exception for each pair within the body."""
    method = openmm.NonbondedForce.CutoffPeriodic
    return [large_bodies.solvated(ATOMS, WATER, method, exclude=exclude)[:2] for exclude in (False, True)]


def test_its_moments_are_those_of_its_atoms(systems):
    system, x = systems[0]
    bodies = find_bodies(system, x, [range(ATOMS)])
    arms = x[:ATOMS] - x[:ATOMS].mean(axis=0)
    tensor = 12.0 * np.einsum("ak,akij->ij", np.ones((ATOMS, 1)), _tensors(arms)[:, None])
    kind = next(kind for kind in bodies.kinds if len(kind.masses) == ATOMS)
    np.testing.assert_allclose(np.sort(kind.inertia[0]), np.linalg.eigvalsh(tensor), rtol=1e-12)


def _tensors(arms):
    return np.array([(r @ r) * np.eye(3) - np.outer(r, r) for r in arms])


def test_forces_within_it_neither_push_nor_turn_it_and_add_a_constant_to_the_energy(systems, rng):
    contexts = [openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE) for system, _ in systems]
    x = systems[0][1]
    centre, added = x[:ATOMS].mean(axis=0), []
    for _ in range(3):
        Q = quaternions.rotation_matrix(quaternions.random(rng, 1))[0]
        moved = x.copy()
        moved[:ATOMS] = centre + (x[:ATOMS] - centre) @ Q.T
        moved[ATOMS:] += np.repeat(0.01 * rng.standard_normal((len(x) // 3 - ATOMS // 3, 3)), 3, axis=0)
        energies, pushes, turns = [], [], []
        for context in contexts:
            context.setPositions(moved)
            state = context.getState(energy=True, forces=True)
            f = state.getForces(asNumpy=True)._value
            energies.append(state.getPotentialEnergy()._value)
            pushes.append(f[:ATOMS].sum(axis=0))
            turns.append(np.cross(moved[:ATOMS] - centre, f[:ATOMS]).sum(axis=0))
            outside = f[ATOMS:]
        np.testing.assert_allclose(pushes[0], pushes[1], rtol=0.0, atol=1e-10 * np.abs(outside).max())
        np.testing.assert_allclose(turns[0], turns[1], rtol=0.0, atol=1e-10 * np.abs(outside).max())
        added.append(energies[0] - energies[1])
    np.testing.assert_allclose(added, added[0], rtol=1e-10)


def test_it_moves_in_water_as_one(systems):
    system, x = systems[0]
    integrator = rb.ExactRigidBodyIntegrator(0.0005, "S2_2", bodies=[range(ATOMS)])
    context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(300, 1)
    before = integrator.totalEnergy()._value
    integrator.step(4)
    assert integrator.degreesOfFreedom() == (3 * (1 + (len(x) - ATOMS) // 3),) * 2
    assert abs(integrator.totalEnergy()._value - before) < 0.05 * integrator.kineticEnergies()[0]._value
    moved = context.getState(positions=True).getPositions(asNumpy=True)._value[:ATOMS]
    one, other = (np.linalg.norm(a[:, None] - a[None], axis=2) for a in (x[:ATOMS], moved))
    np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-13)
    assert np.abs(moved - x[:ATOMS]).max() > 1e-5
