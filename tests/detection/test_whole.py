"""Positions in a periodic box: what is given whole stays, what it has split is joined, what is not known is said."""

import numpy as np
import openmm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from openmm import unit

import openmm_exactrb as rb
import starts
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.detection.whole import whole_positions
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.openmm_access.parameters import constraints
from starts import apart, positions_of

SEEDS = st.integers(0, 2**32 - 1)
CUBE = 3.0 * np.eye(3)


def system_of(n, box, constraints=(), bonds=(), mass=12.0):
    """Return a System of particles without forces, with bonds of these lengths that do nothing."""
    system, pairs, springs = (
        starts.system_of(n * [mass], constraints),
        openmm.NonbondedForce(),
        openmm.HarmonicBondForce(),
    )
    for _ in range(n):
        pairs.addParticle(0.0, 0.1, 0.0)
    pairs.setNonbondedMethod(pairs.CutoffPeriodic)
    pairs.setCutoffDistance(0.2)
    for bond in bonds:
        springs.addBond(*bond, 0.0)
    for force in (pairs, springs) if bonds else (pairs,):
        system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*box)
    return system


def context_of(system, x, bodies=None, step=1e-4):
    integrator = rb.ExactRigidBodyIntegrator(step, "V2", bodies=bodies)
    context = starts.context_of(system, integrator, x)
    return context, integrator


def wrapped(x, box):
    return x - np.floor(x @ np.linalg.inv(box)) @ box


def lengths(x, pairs):
    return [(int(i), int(j), float(apart(x)[i, j])) for i, j in pairs]


def tree(rng, n):
    return [(rng.integers(k), k) for k in range(1, n)]


def every(n):
    return [(i, j) for j in range(n) for i in range(j)]


def random_box(rng):
    a, b, c = rng.uniform(1.0, 2.0, 3)
    s = rng.uniform(-0.5, 0.5, 3)
    return np.array([[a, 0.0, 0.0], [s[0] * a, b, 0.0], [s[1] * a, s[2] * b, c]])


def random_body(rng, box):
    """Return 2 to 7 particles within some 90% of the box: gaps may be wider than half of it."""
    inside = rng.uniform(0.0, 0.9, 3) * rng.uniform(0.0, 1.0, (rng.integers(2, 8), 3))
    return (inside + rng.uniform(-1.0, 1.0, 3)) @ box


def moments(bodies):
    return np.concatenate([kind.inertia[0] for kind in bodies.kinds if kind.turns])


@pytest.mark.parametrize("length", [1.6, 2.9])
def test_a_named_body_has_the_shape_of_its_positions(length):
    x = np.array([[0.2, 0.3, 0.4], [0.2 + length, 0.3, 0.4]])
    context, integrator = context_of(system_of(2, CUBE), x, [[0, 1]])
    integrator.step(1)
    np.testing.assert_allclose(positions_of(context), x, rtol=0.0, atol=1e-15)
    assert integrator.bodyState()[0].inertia[0, 2] == pytest.approx(6.0 * length**2, rel=1e-14)
    context.setPositions(wrapped(x + 1.5, CUBE))  # the shape is known by now
    integrator.step(1)
    assert np.linalg.norm(np.diff(positions_of(context), axis=0)) == pytest.approx(length, abs=1e-14)


@pytest.mark.filterwarnings("ignore::openmm_exactrb.ShapeWarning")
@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_a_named_body_is_taken_as_it_is_given(seed):
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    x = random_body(rng, box)
    system = system_of(len(x), box)
    named = [range(len(x))]
    np.testing.assert_array_equal(moments(find_bodies(system, x, named, box)), moments(find_bodies(system, x, named)))


@pytest.mark.parametrize("joint", ["constraints", "bonds"])
@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_a_body_whose_distances_are_known_is_the_same_in_all_images(joint, seed):
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    x = random_body(rng, box)
    n = len(x)
    if joint == "constraints":
        system, named = system_of(n, box, constraints=lengths(x, every(n))), None
    else:
        system, named = system_of(n, box, bonds=lengths(x, tree(rng, n))), [range(n)]
    expected = moments(find_bodies(system, x, named))
    for images in (x, wrapped(x, box), x + rng.integers(-1, 2, x.shape) @ box):
        np.testing.assert_allclose(moments(find_bodies(system, images, named, box)), expected, rtol=1e-9)


@pytest.mark.parametrize("named", [False, True])
@settings(max_examples=10, deadline=None)
@given(SEEDS)
def test_later_positions_are_read_in_all_images(named, seed):
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    x = random_body(rng, box)
    n = len(x)
    system = system_of(n, box, bonds=lengths(x, tree(rng, n))) if named else system_of(n, box, lengths(x, every(n)))
    context, integrator = context_of(system, x, [range(n)] if named else None)
    integrator.setVelocitiesToTemperature(300, 1)
    integrator.step(2)
    moved = positions_of(context)
    for state in (context.getState(positions=True, velocities=True, enforcePeriodicBox=on) for on in (True, False)):
        context.setState(state)
        integrator.step(1)
        np.testing.assert_allclose(apart(positions_of(context)), apart(x), rtol=0.0, atol=1e-11)
    for images in (wrapped(moved, box), moved + rng.integers(-1, 2, x.shape) @ box, moved):
        context.setPositions(images)
        integrator.step(1)
        np.testing.assert_allclose(apart(positions_of(context)), apart(x), rtol=0.0, atol=1e-11)


def ring(n=10, bond=0.29):
    """Return a freely jointed chain whose end is as near to the image of its start as a bond is long."""
    x = np.array([[0.3 * k, 0.1 * (k % 2), 0.05 * (k % 3)] for k in range(n)])
    return x * (3.0 - bond) / x[-1, 0] + 1.0


def test_a_constrained_chain_may_end_near_its_own_image():
    x = ring()
    bonds = lengths(x, [(k, k + 1) for k in range(9)])
    context, integrator = context_of(system_of(10, CUBE, bonds), x)
    integrator.step(1)
    np.testing.assert_allclose(positions_of(context), x, rtol=0.0, atol=1e-14)
    integrator.setVelocitiesToTemperature(300, 1)
    integrator.step(3)
    state = context.getState(positions=True, velocities=True, enforcePeriodicBox=True)
    for images in (state.getPositions(asNumpy=True)._value, wrapped(positions_of(context), CUBE)):
        context.setPositions(images)
        integrator.step(1)
        y = positions_of(context)
        assert max(abs(np.linalg.norm(y[i] - y[j]) - length) for i, j, length in bonds) < 1e-13


def test_a_shape_may_be_held_by_constraints_of_some_pairs_across_the_box():
    """Whether it is rigid was asked of the first body where the box had split it."""
    octahedron = 0.14 * np.concatenate([np.eye(3), -np.eye(3)]) + 2.99
    edges = lengths(octahedron, [(i, j) for i, j in every(6) if j - i != 3])
    bodies = find_bodies(system_of(6, CUBE, edges), wrapped(octahedron, CUBE), box=CUBE)
    assert (len(bodies), bodies.n_turning) == (1, 1)
    np.testing.assert_allclose(bodies.inertia, 4.0 * 12.0 * 0.14**2, rtol=1e-12)


def rings_of_six(centres):
    angle = np.arange(6) * np.pi / 3.0
    flat = 0.14 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    return np.concatenate([flat + centre for centre in centres])


def test_bodies_without_bonds_have_the_shape_that_others_of_their_masses_show():
    x = rings_of_six([[1.0, 1.0, 1.0], [3.0, 1.0, 1.0], [1.0, 3.0, 3.0]])
    system, named = system_of(18, CUBE), [range(6), range(6, 12), range(12, 18)]
    (kind,) = find_bodies(system, wrapped(x, CUBE), named, CUBE).kinds
    assert len(kind.sites) == 1
    np.testing.assert_allclose(kind.inertia[0], 12.0 * 6.0 * 0.14**2 * np.array([0.5, 0.5, 1.0]), rtol=1e-9)


def copies_of(shape, box, rng, turn=True):
    """Return three copies of a shape, turned or not, anywhere in a box, and their particles."""
    placed = []
    for hand in (1.0, 1.0, -1.0 if turn else 1.0):
        Q = hand * quaternions.rotation_matrix(quaternions.random(rng, 1))[0] if turn else np.eye(3)
        placed.append(shape @ Q.T + rng.uniform(0.0, 1.0, 3) @ box)
    k = len(shape)
    return np.concatenate(placed), [range(first, first + k) for first in (0, k, 2 * k)]


def apart_within(bodies, x):
    return [apart(x[list(body)]) for body in bodies]


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_three_bodies_without_bonds_have_the_shape_that_images_of_all_can_have(seed):
    """However wide their gaps are, and if one is a mirror image."""
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    x, named = copies_of(random_body(rng, box), box, rng)
    system = system_of(len(x), box)
    for images in (x, wrapped(x, box), x + rng.integers(-1, 2, x.shape) @ box):
        found = whole_positions(system, images, np.full(len(x), 12.0), named, box, constraints(system))
        np.testing.assert_allclose(apart_within(named, found), apart_within(named, x), rtol=0.0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_bodies_of_equal_masses_may_have_different_shapes(seed):
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    x = np.concatenate([0.25 * rng.uniform(0.0, 1.0, (4, 3)) @ box + rng.uniform(0.0, 1.0, 3) @ box for _ in "abc"])
    system, named = system_of(12, box), [range(4), range(4, 8), range(8, 12)]
    assert whole_positions(system, x, np.full(12, 12.0), named, box, constraints(system)) is x


@pytest.mark.parametrize("length", [1.4, 0.3])
def test_dumbbells_side_by_side_of_two_lengths_across_the_box_are_refused_unless_one_is_short(length):
    x = np.array([[k, place, 1.0] for place in (0.5, 1.5) for k in (1.5, 1.5 + length)])
    given = x.copy()
    given[3, 0] -= 3.0
    system, named = system_of(4, CUBE), [[0, 1], [2, 3]]
    if length == 0.3:
        np.testing.assert_allclose(find_bodies(system, given, named, CUBE).inertia[:, 2], 6.0 * length**2, rtol=1e-12)
        return
    with pytest.raises(ValueError, match=r"differ by widths of the periodic box, .* 1\.4 nm"):
        find_bodies(system, given, named, CUBE)


def test_bodies_of_a_file_that_rounds_are_joined_too():
    x = np.round(rings_of_six([[1.0, 1.0, 1.0], [3.0, 1.2, 1.0], [1.03, 3.01, 2.97]]), 3)
    named = [range(6), range(6, 12), range(12, 18)]
    system = system_of(18, CUBE)
    found = find_bodies(system, np.round(wrapped(x, CUBE), 3), named, CUBE)
    np.testing.assert_allclose(found.inertia, find_bodies(system, x, named).inertia, rtol=1e-9)


def test_a_pair_that_looks_split_is_taken_as_it_is_given_with_a_warning():
    x = np.array([[0.05, 1.0, 1.0], [2.95, 1.0, 1.0]])
    with pytest.warns(rb.ShapeWarning, match=r"gap of 2\.9 nm between its particles as given, or of 0\.1 nm"):
        bodies = find_bodies(system_of(2, CUBE), x, [[0, 1]], CUBE)
    assert bodies.inertia[0, 2] == pytest.approx(6.0 * 2.9**2, rel=1e-12)


@pytest.mark.parametrize("place", [1.0, 2.5])
def test_a_wide_pair_is_refused_where_the_box_has_split_others_unless_it_leaves_the_cell(place):
    x = np.array([[place, 1.0, 1.0], [place + 1.0, 1.0, 1.0], [0.05, 2.0, 2.0], [2.95, 2.0, 2.0]])
    system = system_of(4, CUBE, [(2, 3, 0.1)])
    if place == 2.5:
        assert find_bodies(system, x, [[0, 1]], CUBE).inertia[0, 2] == pytest.approx(6.0, rel=1e-12)
        return
    with pytest.raises(
        ValueError, match=r"gap of 1 nm between its particles may be 2 nm across the box: set positions in which"
    ):
        find_bodies(system, x, [[0, 1]], CUBE)


def test_a_body_that_looks_split_is_taken_as_it_is_given_with_a_warning():
    x = wrapped(rings_of_six([[3.0, 1.0, 1.0]]), CUBE)
    with pytest.warns(rb.ShapeWarning, match=r"body 0 has a gap of 2\.72 nm between its particles as given"):
        bodies = find_bodies(system_of(6, CUBE), x, [range(6)], CUBE)
    np.testing.assert_array_equal(bodies.inertia, find_bodies(system_of(6, CUBE), x, [range(6)]).inertia)


def test_two_parts_of_a_body_may_be_joined_by_a_chain_that_is_not_of_it():
    x = np.array([[2.6 + 0.15 * k, 1.0, 1.0 + 0.03 * (k % 2)] for k in range(6)])
    system = system_of(6, CUBE, bonds=lengths(x, [(k, k + 1) for k in range(5)]))
    named = [[0, 1, 4, 5]]
    expected = moments(find_bodies(system, x, named))
    np.testing.assert_allclose(moments(find_bodies(system, wrapped(x, CUBE), named, CUBE)), expected, rtol=1e-12)


def test_a_barostat_may_make_the_box_smaller_than_a_body():
    """A rod of 1.2 nm, whose two halves are 0.8 nm apart, in a box that shrinks from 1.5 to less than 1.1 nm."""
    x = np.array([[0.1 + length, 0.5, 0.5] for length in (0.0, 0.2, 1.0, 1.2)] + [[0.7, 1.2, 1.2]])
    system = system_of(5, 1.5 * np.eye(3), bonds=lengths(x, [(0, 1), (1, 2), (2, 3)]))
    barostat = openmm.MonteCarloBarostat(5000.0, 300.0, 1)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    context, integrator = context_of(system, x, [range(4)], 0.001)
    integrator.setVelocitiesToTemperature(300, 1)
    edge = 1.5
    for _ in range(100):
        integrator.step(5)
        box = np.array(context.getState().getPeriodicBoxVectors()._value)
        context.setPositions(wrapped(positions_of(context), box))
        edge = box[0, 0]
        if edge < 1.1:
            break
    assert edge < 1.1
    integrator.step(1)
    np.testing.assert_allclose(apart(positions_of(context)[:4]), apart(x[:4]), rtol=0.0, atol=1e-12)


# -- degenerate shapes -------------------------------------------------------------------------------------------------


def free(masses, x, bodies, step=1e-5):
    return context_of(starts.system_of(masses), x, bodies, step)


LINE = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.25, 0.0, 0.0]])


@pytest.mark.parametrize("light", [1e-3, 1e-6, 1e-8, 1e-10])
def test_sites_that_weigh_almost_nothing_beside_a_line_of_heavy_beads_keep_their_places(light):
    x = np.concatenate([LINE, [[0.1, 0.1, 0.0], [0.1, 0.0, 0.08]]]) + 0.3
    masses = np.array([12.0, 14.0, 16.0, light, light])
    context, integrator = free(masses, x, [range(5)])
    bodies, _ = integrator.bodyState()
    arms = x - masses @ x / masses.sum()
    tensor = np.einsum("s,sij->ij", masses, [(r @ r) * np.eye(3) - np.outer(r, r) for r in arms])
    np.testing.assert_allclose(bodies.inertia[0, 1:], np.linalg.eigvalsh(tensor)[1:], rtol=1e-12)
    axis = np.array([1.0, 0.0, 0.0])
    across = arms - np.outer(arms @ axis, axis)
    assert bodies.inertia[0, 0] == pytest.approx(masses @ (across**2).sum(axis=1), rel=1e-5)
    assert integrator.degreesOfFreedom() == (3, 3)
    integrator.setVelocitiesToTemperature(1e-3, 1)
    integrator.step(5)
    np.testing.assert_allclose(apart(positions_of(context)), apart(x), rtol=0.0, atol=1e-14)


def test_beads_and_sites_on_one_line_are_a_line_whatever_they_weigh():
    x = np.concatenate([LINE, [[0.4, 0.0, 0.0]]])
    _, integrator = free([12.0, 14.0, 1e-8, 1e-8], x, [range(4)])
    assert integrator.degreesOfFreedom() == (3, 2)


def test_a_flat_body_of_a_heavy_line_and_a_light_site_has_three_rotations():
    x = np.concatenate([LINE, [[0.1, 0.1, 0.0]]])
    _, integrator = free([12.0, 14.0, 16.0, 1e-9], x, [range(4)])
    (kind,) = integrator.bodyState()[0].kinds
    assert integrator.degreesOfFreedom() == (3, 3)
    assert not kind.sites[0, :, 2].any()


def test_particles_that_coincide_are_a_point():
    x = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [0.5, 0.2, 0.3]])
    context, integrator = free([12.0, 4.0, 1.0], x, [[0, 1]], 0.001)
    assert integrator.degreesOfFreedom() == (6, 0)
    spring = openmm.HarmonicBondForce()
    spring.addBond(1, 2, 0.3, 1000.0)
    context.getSystem().addForce(spring)
    context.reinitialize(preserveState=True)
    start = integrator.totalEnergy()._value
    integrator.step(50)
    assert integrator.totalEnergy()._value == pytest.approx(start, abs=0.02)
    assert sorted(integrator.bodyState()[0].mass) == [1.0, 16.0]
    y = positions_of(context)
    np.testing.assert_array_equal(y[0], y[1])
    assert np.linalg.norm(y[0] - x[0]) > 1e-3
    np.testing.assert_allclose(np.array([12.0, 4.0, 1.0]) @ (y - x), 0.0, atol=1e-13)
    context.setPositions(x + np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.0]]))
    with pytest.raises(ValueError, match="deviate from its shape by"):
        integrator.step(1)


def test_particles_that_coincide_within_a_larger_body_turn_with_it():
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.15, 0.0]])
    context, integrator = free([1.0, 2.0, 3.0, 4.0], x, [range(4)], 0.001)
    integrator.setVelocitiesToTemperature(300 * unit.kelvin, 1)
    integrator.step(10)
    np.testing.assert_allclose(apart(positions_of(context)), apart(x), rtol=0.0, atol=1e-15)
