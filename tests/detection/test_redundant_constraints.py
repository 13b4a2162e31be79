"""More constraints than a molecule needs: rigid ones of few atoms, flat and straight ones, and parts of others."""

import itertools

import numpy as np
import pytest
from openmm import unit

import openmm_exactrb as rb
import starts
from benchmarks.constraints.small_molecules import MOLECULES, ring
from openmm_exactrb.detection.find import find_bodies
from starts import apart, context_of, positions_of, velocities_of

KB = 0.00831446261815324


def every_pair(n):
    return list(itertools.combinations(range(n), 2))


def system_of(masses, x, pairs, copies=1, longer=None):
    """Return a System of copies with these distances constrained; `longer` adds to some of them."""
    n = len(masses)
    lengths = [apart(x)[pair] + (longer or {}).get(pair, 0.0) for pair in pairs]
    held = [(n * k + i, n * k + j, d) for k in range(copies) for (i, j), d in zip(pairs, lengths, strict=True)]
    return starts.system_of(copies * [*masses], held)


def moving(system, x, integrator):
    return context_of(system, integrator, x)


def moments_of(masses, x):
    """Return principal moments by the textbook's inertia tensor."""
    masses = np.array(masses)
    apart = x - masses @ x / masses.sum()
    tensor = np.einsum("a,aij->ij", masses, [(r @ r) * np.eye(3) - np.outer(r, r) for r in apart])
    return np.linalg.eigvalsh(tensor)


@pytest.fixture(params=list(MOLECULES))
def molecule(request):
    return MOLECULES[request.param]


def test_all_distances_of_a_small_molecule_make_it_rigid_with_its_moments(molecule):
    masses, x, moments = molecule
    bodies = find_bodies(system_of(masses, x, every_pair(len(x))), x)
    expected = moments_of(masses, x) if moments is None else moments
    np.testing.assert_allclose(bodies.kinds[0].inertia[0], expected, rtol=1e-12, atol=1e-14)
    assert (len(bodies), bodies.n_turning) == (1, 1)


def test_its_temperature_is_that_of_its_degrees_of_freedom(molecule):
    masses, x, _ = molecule
    copies, draws = 4, 200
    integrator = rb.ExactRigidBodyIntegrator(0.002)
    positions = np.concatenate([x + np.array([2.0 * k, 0.0, 0.0]) for k in range(copies)])
    context = moving(system_of(masses, x, every_pair(len(x)), copies), positions, integrator)
    freedom = copies * (5 if np.linalg.matrix_rank(x - x[0], tol=1e-9) == 1 else 6)
    measured = []
    for seed in range(1, draws + 1):
        integrator.setVelocitiesToTemperature(300 * unit.kelvin, seed)
        v = velocities_of(context)
        measured.append((np.tile(masses, copies)[:, None] * v**2).sum() / freedom / KB)
    assert sum(integrator.degreesOfFreedom()) == freedom
    assert abs(np.mean(measured) - 300.0) < 4.0 * 300.0 * np.sqrt(2.0 / (freedom * draws))
    translation, rotation = (mine._value for mine in integrator.temperatures())
    assert (3 * copies * translation + (freedom - 3 * copies) * rotation) / freedom == pytest.approx(measured[-1])


def test_it_moves_as_the_same_body_named_by_hand(molecule):
    masses, x, _ = molecule
    ends = []
    for pairs, bodies in ((every_pair(len(x)), None), ([], [range(len(x))])):
        integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_2", bodies=bodies)
        context = moving(system_of(masses, x, pairs), x, integrator)
        if bodies is None:
            integrator.setVelocitiesToTemperature(300, 1)
            v = context.getState(velocities=True).getVelocities()
        context.setVelocities(v)
        integrator.step(100)
        ends.append(positions_of(context))
    assert np.abs(ends[0] - x).max() > 0.02
    np.testing.assert_allclose(*ends, rtol=0.0, atol=2e-13)


@pytest.mark.parametrize(
    ("name", "without", "freedom"),
    [
        ("methane", [], 6),
        ("methane", [(1, 2)], 6),
        ("formate", [], 6),
        ("formate", [(1, 2)], 7),  # a hinge about the line of C and H
        ("CO2", [], 5),
    ],
)
def test_the_molecules_of_openmms_issue_move_as_the_how_to_says(name, without, freedom):
    masses, x, _ = MOLECULES[name]
    pairs = [pair for pair in every_pair(len(x)) if pair not in without]
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme="S2_2")
    context = moving(system_of(masses, x, pairs), x, integrator)
    integrator.setVelocitiesToTemperature(300, 1)
    integrator.step(200)
    assert sum(integrator.degreesOfFreedom()) == freedom
    moved = positions_of(context)
    missed = [abs(np.linalg.norm(moved[i] - moved[j]) - np.linalg.norm(x[i] - x[j])) for i, j in every_pair(len(x))]
    for pair, error in zip(every_pair(len(x)), missed, strict=True):
        assert bool(error < 1e-13) is (freedom < 7 or pair not in without)


# -- flat and straight ones, of which some distances are not constrained -----------------------------------------------

SQUARE = 0.3 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
SIDES = [(0, 1), (1, 2), (2, 3), (0, 3)]
STRAIGHT = np.array([[0, 0, 0.06], [0, 0, -0.06], [0, 0, 0.166], [0, 0, -0.166]])


@pytest.mark.parametrize(
    ("x", "pairs", "rigid"),
    [
        (MOLECULES["benzene"][1], every_pair(12)[1:], True),
        (ring(0.14), [(k, (k + apart) % 6) for k in range(6) for apart in (1, 2)], True),  # six angles of 120 degrees
        (ring(0.14, 5), [(k, (k + 1) % 5) for k in range(5)], False),
        (SQUARE, every_pair(4), True),
        (SQUARE, [*SIDES, (0, 2)], False),  # a hinge
        (SQUARE, SIDES, False),
        (STRAIGHT, [(0, 1), (0, 2), (1, 3), (2, 3)], True),  # both ends as far apart as the rest allows
        (STRAIGHT, [(0, 1), (0, 2), (1, 3)], False),
    ],
)
def test_a_flat_or_straight_molecule_is_rigid_if_its_constraints_keep_it_so(x, pairs, rigid):
    system = system_of(len(x) * [12.0], x, pairs)
    bodies = find_bodies(system, x)
    assert (len(bodies) == 1) is rigid
    if rigid:
        np.testing.assert_allclose(bodies.kinds[0].inertia[0], moments_of(len(x) * [12.0], x), rtol=1e-12, atol=1e-14)


# -- clusters that bend ------------------------------------------------------------------------------------------------

#: Five points in space with all ten distances, one too many, and a chain of two hanging on them.
PAIRS = [*every_pair(5), (2, 5), (5, 6)]
MASSES = [12.0, 14.0, 16.0, 12.0, 1.0, 12.0, 14.0]
HUNG = MOLECULES["five points"][1][2] + np.array([[0.1, 0.1, 0.05], [0.2, 0.1, 0.15]])
BENDING = np.vstack([MOLECULES["five points"][1], HUNG])


def test_a_constraint_too_many_changes_nothing():
    ends = []
    for pairs in (PAIRS, [pair for pair in PAIRS if pair != (3, 4)]):
        integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_2")
        context = moving(system_of(MASSES, BENDING, pairs), BENDING, integrator)
        integrator.setVelocitiesToTemperature(300, 1)
        assert integrator.bodyState()[0].clusters.degrees_of_freedom == 6 + 4
        before = integrator.totalEnergy()._value
        integrator.step(200)
        assert abs(integrator.totalEnergy()._value / before - 1.0) < 1e-14
        x = positions_of(context)
        for i, j in PAIRS:
            assert abs(np.linalg.norm(x[i] - x[j]) - np.linalg.norm(BENDING[i] - BENDING[j])) < 1e-15
        ends.append(x)
    assert np.abs(ends[0] - BENDING).max() > 0.05
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-12)


def test_rounded_redundant_constraints_are_met_as_well_as_can_be():
    """Off by 1e-7 nm: no place has all ten distances, the best misses each by less."""
    system = system_of(MASSES, BENDING, PAIRS, longer={(0, 1): 1e-7})
    (kind,) = find_bodies(system, BENDING).clusters.kinds
    assert (len(kind.pairs), len(kind.implied)) == (11, 1)
    lengths = {tuple(p): d for p, d in zip(kind.pairs.tolist(), kind.lengths, strict=True)}
    missed = lengths[0, 1] - np.linalg.norm(BENDING[0] - BENDING[1]) - 1e-7
    assert 1e-9 < abs(missed) < 0.9e-7
