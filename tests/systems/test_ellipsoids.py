"""Ellipsoids: the potential as it was published, forces that belong to it, and bodies with the moments of a solid."""

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.potentials import GayBerne
from orders import exponent
from places import REFERENCE
from starts import context_of

KB = 0.00831446261815324
SHAPES = [(3.0, 5.0), (4.4, 20.0), (0.345, 0.2)]


def published(u, v, r, kappa, kappa_prime, mu=2.0, nu=1.0, sigma=1.0, epsilon=1.0):
    """The potential as Gay and Berne wrote it, shifted by the thickness of discs."""
    distance = np.linalg.norm(r)
    e = r / distance

    def overlap(chi):
        plus, minus = e @ u + e @ v, e @ u - e @ v
        return 1.0 - 0.5 * chi * (plus**2 / (1.0 + chi * (u @ v)) + minus**2 / (1.0 - chi * (u @ v)))

    chi = (kappa**2 - 1.0) / (kappa**2 + 1.0)
    chi_prime = (kappa_prime ** (1.0 / mu) - 1.0) / (kappa_prime ** (1.0 / mu) + 1.0)
    strength = epsilon * (1.0 - chi**2 * (u @ v) ** 2) ** (-0.5 * nu) * overlap(chi_prime) ** mu
    shift = sigma * min(1.0, kappa)
    R = (distance - sigma * overlap(chi) ** -0.5 + shift) / shift
    return 4.0 * strength * (R**-12 - R**-6)


def pair(u, v, r):
    """Positions of centres and points of the axes of two ellipsoids."""
    return np.array([np.zeros(3), 0.25 * np.asarray(u), r, np.asarray(r) + 0.25 * np.asarray(v)], dtype=float)


def random_pairs(rng, number, kappa, within):
    """Axes and vectors between centres outside of any overlap."""
    for _ in range(number):
        u, v, r = rng.standard_normal((3, 3))
        u, v, r = (a / np.linalg.norm(a) for a in (u, v, r))
        yield u, v, r * rng.uniform(max(1.0, kappa), within)


X, Z = np.eye(3)[0], np.eye(3)[2]
BOX = 40.0 * np.eye(3)


@pytest.mark.parametrize("distance", [0.98, 1.12246204831, 1.6])
@pytest.mark.parametrize(
    ("u", "v", "direction", "contact", "depth"),
    [  # the diameters that touch, and the wells by hand: (kappa² + 1)/(2 kappa) where the axes are parallel, 5/3
        (Z, Z, X, 1.0, 5.0 / 3.0),  # side by side
        (Z, Z, Z, 3.0, 5.0 / 3.0 / 5.0),  # end to end
        (Z, np.eye(3)[1], X, 1.0, 1.0),  # crossed
        (X, Z, X, 5.0**0.5, None),  # a T
    ],
)
def test_wells_and_contacts_of_gb_3_5_2_1(u, v, direction, contact, depth, distance):
    potential = GayBerne(3.0, 5.0, 1.0, 1.0, 15.0, 14.0)
    r = (contact - 1.0 + distance) * direction
    energy, _ = potential.energy_and_forces(pair(u, v, r), BOX)
    assert energy == pytest.approx(published(u, v, r, 3.0, 5.0), rel=1e-13)
    if depth:
        assert energy == pytest.approx(4.0 * depth * (distance**-12 - distance**-6), rel=1e-12)


@pytest.mark.parametrize(("kappa", "kappa_prime"), SHAPES)
def test_energies_are_those_that_were_published(rng, kappa, kappa_prime):
    potential = GayBerne(kappa, kappa_prime, 0.7, 1.3, 12.0, 11.0)
    for u, v, r in random_pairs(rng, 100, 0.7 * kappa, 6.0):
        expected = published(u, v, r, kappa, kappa_prime, sigma=0.7, epsilon=1.3)
        energy, _ = potential.energy_and_forces(pair(u, v, r), BOX)
        assert energy == pytest.approx(expected, rel=1e-12, abs=1e-16)


def of_openmm(kappa, kappa_prime):
    """Two ellipsoids of OpenMM's, whose shape factor takes z for the axis and is off by a constant for the x axis."""
    system, force = openmm.System(), openmm.GayBerneForce()
    factor = (kappa + 1.0) * kappa**0.5 / (kappa**2 + 1.0)
    for first in (0, 2):
        for _ in range(2):
            system.addParticle(1.0)
        force.addParticle(1.0, 1.0 / factor, first + 1, -1, kappa, 1.0, 1.0, 1.0 / kappa_prime, 1.0, 1.0)
        force.addParticle(1.0, 0.0, -1, -1, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    system.addForce(force)
    return openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)


@pytest.mark.parametrize("kappa_prime", [1.0, 5.0])
def test_energies_are_those_of_openmm_and_its_forces_where_no_depth_depends_on_the_direction(rng, kappa_prime):
    context, potential = of_openmm(3.0, kappa_prime), GayBerne(3.0, kappa_prime, 1.0, 1.0, 15.0, 14.0)
    for u, v, r in random_pairs(rng, 20, 3.0, 5.0):
        x = pair(u, v, r)
        context.setPositions(x)
        state = context.getState(energy=True, forces=True)
        energy, forces = potential.energy_and_forces(x, BOX)
        assert state.getPotentialEnergy()._value == pytest.approx(energy, rel=1e-12)
        theirs = state.getForces(asNumpy=True)._value
        np.testing.assert_allclose(theirs[:2].sum(axis=0), forces[:2].sum(axis=0), atol=1e-13)
        if kappa_prime == 1.0:  # else OpenMM's torques lack the factor 2 chi of a square's derivative
            np.testing.assert_allclose(theirs, forces, atol=1e-13)


@pytest.mark.skipif(not openmm.__version__.startswith("8.6"), reason="found in OpenMM 8.6")
def test_openmms_torques_do_not_belong_to_its_energies_which_is_why_there_is_another_kernel(rng):
    context, potential, errors = of_openmm(3.0, 5.0), GayBerne(3.0, 5.0, 1.0, 1.0, 15.0, 14.0), []
    for u, v, r in random_pairs(rng, 100, 3.0, 5.0):
        x = pair(u, v, r)
        context.setPositions(x)
        theirs = context.getState(forces=True).getForces(asNumpy=True)._value[1::2]
        ours = potential.energy_and_forces(x, BOX)[1][1::2]
        errors.append(np.abs(theirs - ours).max() / np.abs(ours).max())
    assert 0.2 < np.median(errors) < 0.5


@pytest.mark.parametrize("n", [2, 5])
@pytest.mark.parametrize(("kappa", "kappa_prime"), SHAPES)
def test_forces_are_the_gradient_of_the_energy(rng, kappa, kappa_prime, n):
    """Of particles as they are, bodies or not, with pairs beyond the begin of the switch and across the border."""
    potential = GayBerne(kappa, kappa_prime, 1.0, 1.0, 2.0 * max(1.0, kappa), 1.2 * max(1.0, kappa))
    box = 4.2 * max(1.0, kappa)
    centres = 1.1 * max(1.0, kappa) * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])[:n]
    axes = rng.standard_normal((n, 3))
    x = np.stack([centres, centres + 0.25 * axes / np.linalg.norm(axes, axis=1)[:, None]], axis=1).reshape(-1, 3)
    x[2:4] += [box, 0.0, -box]
    forces, h = potential.energy_and_forces(x, box * np.eye(3))[1], 1e-4
    slopes = np.zeros_like(x)
    for at in np.ndindex(x.shape):
        energies = []
        for k in (-2, -1, 1, 2):
            moved = x.copy()
            moved[at] += k * h
            energies.append(potential.energy_and_forces(moved, box * np.eye(3))[0])
        slopes[at] = -(energies[0] - 8.0 * energies[1] + 8.0 * energies[2] - energies[3]) / (12.0 * h)
    assert np.abs(forces).max() > 1e-4
    np.testing.assert_allclose(forces, slopes, rtol=1e-9, atol=1e-10 * np.abs(forces).max())


def test_the_bodies_have_the_moments_of_a_uniform_ellipsoid():
    topology, system, positions = rb.ellipsoids(36, 3, kappa=3.0, mass=2.0, sigma=0.5, density=0.4)
    bodies = find_bodies(system, positions._value)
    assert len(bodies) == topology.getNumResidues() == 36
    across, along = 2.0 * (0.25**2 + 0.75**2) / 5.0, 2.0 * 2.0 * 0.25**2 / 5.0  # of semi-axes 0.25, 0.25 and 0.75 nm
    np.testing.assert_allclose(bodies.kinds[0].inertia[0], [along, across, across], rtol=1e-12)
    x = positions._value.reshape(36, 6, 3)
    np.testing.assert_allclose(x[:, 5] - x[:, 4], 36 * [[0.0, 0.0, 0.125]], atol=1e-12)
    assert system.getDefaultPeriodicBoxVectors()[0][0]._value ** 3 == pytest.approx(36 / 0.4)


@pytest.mark.parametrize(
    ("n", "kappa", "density"), [(288, 3.0, 0.33), (256, 3.0, 0.3), (500, 4.4, 0.19), (300, 0.345, 2.0)]
)
def test_neighbours_of_the_lattice_do_not_overlap(n, kappa, density):
    _, system, positions = rb.ellipsoids(n, kappa=kappa, density=density)
    edge = system.getDefaultPeriodicBoxVectors()[0][0]._value
    centres = positions._value.reshape(n, -1, 3)[:, -2]
    apart = centres[:, None] - centres[None]
    apart -= edge * np.round(apart / edge)
    apart[..., 2] /= kappa
    assert (np.linalg.norm(apart, axis=2) + 9.0 * np.eye(n)).min() > 0.95


def test_seeds_and_units():
    one, again, other = (rb.ellipsoids(256, seed)[2]._value for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.01
    with_units = rb.ellipsoids(256, 1, sigma=10.0 * unit.angstrom, density=0.3 * unit.nanometer**-3)[2]._value
    np.testing.assert_allclose(with_units, one, rtol=0.0, atol=1e-12)


def small(*, equilibrate=400):
    """A System of 32 short ellipsoids with room for a cutoff, and its positions in the liquid."""
    _, system, positions = rb.ellipsoids(32, 1, kappa=1.5, kappa_prime=3.0, density=0.45, cutoff=2.05)
    integrator = rb.ExactRigidBodyLangevinIntegrator(1.2 / KB, 1.0, 0.005)
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(1.2 / KB, 1)
    integrator.step(equilibrate)
    return system, context.getState(positions=True, velocities=True)


@pytest.fixture(scope="module")
def liquid():
    return small()


def started(liquid, integrator):
    system, state = liquid
    return context_of(system, integrator, state)


@pytest.mark.parametrize(
    ("scheme", "order", "steps"), [("S2_2", 2, (0.008, 0.004, 0.002)), ("SRKN4_6b", 4, (0.008, 0.004, 0.002))]
)
def test_the_energy_is_kept_with_the_order_of_the_scheme(liquid, scheme, order, steps):
    errors = []
    for step in steps:
        integrator = rb.ExactRigidBodyIntegrator(step, scheme)
        _context = started(liquid, integrator)
        first = integrator.totalEnergy()._value
        energies = []
        for _ in range(round(0.4 / step)):
            integrator.step(1)
            energies.append(integrator.totalEnergy()._value - first)
        errors.append(np.abs(energies).max())
    slope = exponent(steps, errors)
    assert abs(slope - order) < 0.35, errors


def test_verlet_with_constraints_comes_to_the_same_trajectory(liquid):
    """Whose difference falls with the square of its step; its velocities are those of half a step before."""
    errors = []
    for step in (0.001, 0.0005):
        exact = started(liquid, rb.ExactRigidBodyIntegrator(0.5 * step, "SRKN4_6b"))
        verlet = started(liquid, openmm.VerletIntegrator(step))
        verlet.getIntegrator().setConstraintTolerance(1e-12)
        exact.getIntegrator().step(1)
        verlet.setPositions(exact.getState(positions=True).getPositions())
        exact.getIntegrator().step(round(0.1 / step))
        verlet.getIntegrator().step(round(0.05 / step))
        ends = (context.getState(positions=True).getPositions(asNumpy=True)._value for context in (exact, verlet))
        errors.append(np.abs(np.subtract(*ends)).max())
    assert errors[1] < 5e-6  # the start depends on the processor: chaos
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_a_barostat_changes_the_volume_and_no_shape():
    _, system, positions = rb.ellipsoids(288, 1)
    system.addForce(openmm.MonteCarloBarostat(50.0, 1.0 / KB, 5))
    integrator = rb.ExactRigidBodyLangevinIntegrator(1.0 / KB, 1.0, 0.01)
    context = context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(1.0 / KB, 1)
    before = context.getState().getPeriodicBoxVolume()._value
    integrator.step(60)
    state = context.getState(positions=True)
    assert abs(state.getPeriodicBoxVolume()._value / before - 1.0) > 1e-3
    x = state.getPositions(asNumpy=True)._value
    for k in range(system.getNumConstraints()):
        i, j, length = system.getConstraintParameters(k)
        assert abs(np.linalg.norm(x[i] - x[j]) - length._value) < 1e-13


def test_a_deep_overlap_ends_a_run(liquid):
    system, state = liquid
    x = state.getPositions(asNumpy=True)._value.copy()
    x[6:12] = x[:6] + 0.1  # beyond the pole of the formula
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    _context = context_of(system, integrator, x)
    with pytest.raises(rb.NonFiniteError):
        integrator.step(1)


def test_a_system_survives_xml(liquid):
    system, state = liquid
    energies = []
    for one in (system, openmm.XmlSerializer.clone(system)):
        context = context_of(one, openmm.VerletIntegrator(0.001), state.getPositions())
        energies.append(context.getState(energy=True).getPotentialEnergy()._value)
    assert energies[0] == energies[1]


def test_the_energy_does_not_depend_on_turns_of_all_together(rng):
    potential = GayBerne(3.0, 5.0, 1.0, 1.0, 15.0, 14.0)
    u, v, r = next(random_pairs(rng, 1, 3.0, 4.0))
    Q = quaternions.rotation_matrix(quaternions.random(rng, 1))[0]
    one, other = (potential.energy_and_forces(pair(*vectors), BOX) for vectors in ((u, v, r), (Q @ u, Q @ v, Q @ r)))
    assert one[0] == pytest.approx(other[0], rel=1e-13)
    np.testing.assert_allclose(one[1] @ Q.T, other[1], atol=1e-12)
