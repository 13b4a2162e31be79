"""Large bodies, named by hand: their inertia and shapes, and that forces within them do nothing."""

import itertools

import numpy as np
import openmm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import cKDTree

import openmm_exactrb as rb
from benchmarks.cost import large_bodies
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mechanics.fit import fit
from places import REFERENCE
from starts import context_of, system_of

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


# -- any size and shape ---------------------------------------------------------------------------------------------

SEEDS = st.integers(0, 2**32 - 1)
BOXES = {"cube": np.eye(3), "slanted": np.array([[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [-0.4, 0.45, 0.9]])}


def solid(rng, k):
    """Return places (k, 3) of a compact body, as dense as a protein."""
    edge = int(np.ceil(k ** (1.0 / 3.0)))
    sites = np.argwhere(np.ones((edge, edge, edge)))[:k]
    return large_bodies.SPACING * (sites + rng.uniform(-0.2, 0.2, (k, 3)))


def sheet(rng, k):
    return np.column_stack([rng.uniform(0.0, 0.2 * np.sqrt(k), (k, 2)), np.zeros(k)]) @ turned(rng).T


def rod(rng, k):
    return np.outer(0.1 * np.arange(k) + rng.uniform(0.0, 0.05, k), turned(rng)[0])


def turned(rng):
    return quaternions.rotation_matrix(quaternions.random(rng, 1))[0]


@pytest.mark.parametrize(("shape", "moments"), [(solid, 3), (sheet, 3), (rod, 2)])
@settings(max_examples=8, deadline=None)
@given(SEEDS)
def test_bodies_of_any_size_have_the_moments_and_the_places_of_their_atoms(shape, moments, seed):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(2 if shape is rod else 3, 3000, 4)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    x = np.concatenate([shape(rng, k) + rng.uniform(-20.0, 20.0, 3) for k in sizes])
    masses = rng.uniform(1.0, 30.0, len(x))
    bodies = find_bodies(system_of(masses), x, [range(*ends) for ends in itertools.pairwise(starts)])
    assert (len(bodies), bodies.n_turning, bodies.rotational_freedom) == (4, 4, 4 * moments)
    for kind in bodies.kinds:
        ((of,),) = (kind.particles,)
        arms = x[of] - masses[of] @ x[of] / masses[of].sum()
        tensor = np.einsum("s,sij->ij", masses[of], _tensors(arms))
        expected = np.linalg.eigvalsh(tensor)
        np.testing.assert_allclose(kind.inertia[0], expected, rtol=1e-11, atol=1e-11 * expected[2])
        assert kind.linear == (shape is rod)
    state = fit(bodies, x, np.zeros_like(x))
    np.testing.assert_allclose(bodies.positions(state, np.zeros_like(x)), x, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("cell", BOXES)
@settings(max_examples=5, deadline=None)
@given(SEEDS)
def test_large_bodies_that_the_box_has_split_have_the_shape_that_all_show(cell, seed):
    """They are wrapped atom by atom, in different orientations, without bonds."""
    rng = np.random.default_rng(seed)
    shape = solid(rng, int(rng.integers(100, 1500))) * rng.uniform(0.5, 1.0, 3)
    box = 1.8 * np.linalg.norm(np.ptp(shape, axis=0)) * BOXES[cell]
    x = np.concatenate([shape @ turned(rng).T + rng.uniform(0.0, 1.0, 3) @ box for _ in range(3)])
    x = np.concatenate([x, x[: len(shape)] + 0.5 * box.sum(axis=0)])
    k = len(shape)
    wrapped = x - np.floor(x @ np.linalg.inv(box)) @ box
    bodies = find_bodies(system_of(4 * k * [12.0]), wrapped, [range(b, b + k) for b in range(0, 4 * k, k)], box)
    (kind,) = bodies.kinds
    assert len(kind.sites) == 1
    some = rng.integers(0, k, (2, 200))
    wanted, found = (np.linalg.norm(a[some[0]] - a[some[1]], axis=1) for a in (shape, kind.sites[0]))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("cell", BOXES)
def test_a_large_body_that_the_box_has_split_is_joined_along_its_bonds(cell, rng):
    x = solid(rng, 5000)
    box = 0.7 * np.linalg.norm(np.ptp(x, axis=0)) * BOXES[cell]
    bonds, near = openmm.HarmonicBondForce(), cKDTree(x)
    tree = minimum_spanning_tree(near.sparse_distance_matrix(near, 2.0 * large_bodies.SPACING)).tocoo()
    for i, j, length in zip(*tree.coords, tree.data, strict=True):
        bonds.addBond(i, j, length, 0.0)
    system = system_of(5000 * [12.0])
    system.addForce(bonds)
    wrapped = x - np.floor(x @ np.linalg.inv(box)) @ box
    (kind,), (whole,) = (find_bodies(system, y, [range(5000)], box).kinds for y in (wrapped, x))
    np.testing.assert_allclose(kind.inertia, whole.inertia, rtol=1e-12)


@pytest.mark.parametrize("periodic", [False, True])
def test_a_body_of_100_000_particles_moves(periodic, rng):
    """Tables of the pairs of its particles would need 80 GB."""
    n = 100_000
    system, x = system_of(n * [12.0]), solid(rng, n)
    drive = openmm.CustomExternalForce("y*x + periodicdistance(x, y, z, 0, 0, 0)^2" if periodic else "y*x")
    for i in range(0, n, 1000):
        drive.addParticle(i)
    system.addForce(drive)
    system.setDefaultPeriodicBoxVectors(*np.diag(1.5 * np.ptp(x, axis=0)))
    integrator = rb.ExactRigidBodyIntegrator(0.002, "V2", bodies=[range(n)])
    context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(1e5, 1)
    integrator.step(3)
    moved = context.getState(positions=True).getPositions(asNumpy=True)._value
    some = rng.integers(0, n, (2, 1000))
    wanted, found = (np.linalg.norm(a[some[0]] - a[some[1]], axis=1) for a in (x, moved))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12)
    assert np.abs(moved - x).max() > 1e-6
    context.setPositions(1.3 * moved)
    with pytest.raises(ValueError, match="deviate from its shape"):
        integrator.step(1)
