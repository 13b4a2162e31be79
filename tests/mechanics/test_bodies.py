"""Bodies found in a System: their state is their particles' positions and velocities, and back."""

import numpy as np
import openmm
import pytest
from openmm import unit

from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.errors import ShapeWarning
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mechanics.fit import REFUSED, RIGIDITY, fit
from openmm_exactrb.mechanics.state import BodyState


def add_rigid(system, shape, masses):
    """Add a body of this shape, all its distances constrained; return its particles."""
    first = system.getNumParticles()
    for i, (place, mass) in enumerate(zip(shape, masses, strict=True)):
        system.addParticle(mass)
        for j in range(i):
            system.addConstraint(first + j, first + i, float(np.linalg.norm(place - shape[j])))
    return list(range(first, first + len(masses)))


WATER = np.array([[0.0, 0.0, 0.0], [0.09572, 0.0, 0.0], [-0.0239987, 0.0926627, 0.0]])
CHIRAL = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.02, 0.12, 0.0], [0.03, 0.01, 0.09]])
LINEAR = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.11]])


@pytest.fixture
def mixture(rng):
    """Waters, a chiral body and its mirror image, a linear molecule, free particles, all mixed up."""
    system, x = openmm.System(), []
    shapes = [WATER, CHIRAL, LINEAR, WATER, CHIRAL * (1, 1, -1), CHIRAL, WATER]
    masses = {3: (15.999, 1.008, 1.008), 4: (12.0, 1.0, 14.0, 35.0), 2: (14.0, 14.0)}
    for shape in shapes:
        if rng.random() < 0.6:
            system.addParticle(39.948)
            x.append(rng.uniform(0, 3, (1, 3)))
        add_rigid(system, shape, masses[len(shape)])
        Q = quaternions.rotation_matrix(quaternions.random(rng, 1))[0]
        x.append(rng.uniform(0, 3, 3) + shape @ Q.T)
        if len(shape) == 3:
            site = system.addParticle(0.0)
            system.setVirtualSite(site, openmm.ThreeParticleAverageSite(site - 3, site - 2, site - 1, 0.8, 0.1, 0.1))
            x.append(np.zeros((1, 3)))
    x = np.concatenate(x)
    return system, x, find_bodies(system, x)


def masses_of(system):
    return np.array([system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(system.getNumParticles())])


def random_state(bodies, x, rng):
    """A state at these positions with random momenta."""
    state = fit(bodies, x, np.zeros_like(x))
    m = rng.standard_normal(state.m.shape)
    for kind in bodies.kinds:
        if kind.linear:
            m[0, kind.bodies] = 0.0
    return BodyState(state.R, rng.standard_normal(state.R.shape), state.q, m)


def test_all_kinds_are_found(mixture):
    system, _, bodies = mixture
    free = int((masses_of(system) == 39.948).sum())
    assert len(bodies) == 7 + free
    assert bodies.n_turning == 7
    assert sorted(kind.sites.shape[1] for kind in bodies.kinds) == [1, 2, 3, 4, 4]


def test_state_to_particles_and_back_is_the_identity(mixture, rng):
    system, x, bodies = mixture
    state = random_state(bodies, x, rng)
    massive = masses_of(system) > 0
    y, v = bodies.positions(state, np.zeros_like(x)), bodies.velocities(state, np.zeros_like(x))
    np.testing.assert_allclose(y[massive], x[massive], rtol=0.0, atol=2e-14)
    again = fit(bodies, y, v)
    for a, b in zip(again, state, strict=True):
        np.testing.assert_allclose(a if a is not again.q else a * np.sign((a * b).sum(0)), b, rtol=0.0, atol=2e-12)


def test_energies_and_momenta_are_those_of_the_particles(mixture, rng):
    system, x, bodies = mixture
    state, mass = random_state(bodies, x, rng), masses_of(system)
    y, v = bodies.positions(state, np.zeros_like(x)), bodies.velocities(state, np.zeros_like(x))
    assert sum(bodies.kinetic_energies(state)) == pytest.approx(0.5 * (mass @ (v * v).sum(1)), rel=1e-13)
    np.testing.assert_allclose(state.P.sum(1), mass @ v, rtol=0.0, atol=1e-13)
    spin = np.einsum("ijn,jn->i", quaternions.matrix(state.q), state.m)
    np.testing.assert_allclose(
        spin + np.cross(state.R.T, state.P.T).sum(0), (mass[:, None] * np.cross(y, v)).sum(0), rtol=0.0, atol=1e-12
    )


def test_forces_and_torques_are_direct_sums(mixture, rng):
    _, x, bodies = mixture
    state, F = random_state(bodies, x, rng), rng.standard_normal(x.shape)
    y = bodies.positions(state, np.zeros_like(x))
    Q = quaternions.matrix(state.q)
    total, torque = bodies.forces(state, F)
    for kind in bodies.kinds:
        for body, particles in zip(range(kind.bodies.start, kind.bodies.stop), kind.particles, strict=True):
            np.testing.assert_allclose(total[:, body], F[particles].sum(0), rtol=0.0, atol=1e-14)
            if kind.turns:
                expected = Q[:, :, body].T @ np.cross(y[particles] - state.R[:, body], F[particles]).sum(0)
                np.testing.assert_allclose(torque[:, body], expected, rtol=0.0, atol=1e-14)


def test_a_linear_molecule_has_two_rotations(mixture):
    _, _, bodies = mixture
    linear = next(kind for kind in bodies.kinds if kind.linear)
    np.testing.assert_allclose(linear.inertia[0], [0.0, 7.0 * 0.11**2, 7.0 * 0.11**2], rtol=1e-13)


def test_velocities_that_are_not_rigid_are_projected(mixture, rng):
    system, x, bodies = mixture
    v, mass = rng.standard_normal(x.shape), masses_of(system)
    state = fit(bodies, x, v)
    rigid = bodies.velocities(state, np.zeros_like(x))
    np.testing.assert_allclose(mass @ rigid, mass @ v, rtol=0.0, atol=1e-12)
    assert 0.5 * mass @ (rigid**2).sum(1) < 0.5 * mass @ (v**2).sum(1)


def test_positions_that_are_not_rigid_are_put_on_the_shape_or_refused_by_name(mixture):
    _, x, bodies = mixture
    water = next(kind for kind in bodies.kinds if kind.sites.shape[1] == 3)
    particles = ", ".join(map(str, water.particles[1]))

    def moved(distance):
        y = x.copy()
        y[water.particles[1, 0]] += [distance, 0.0, 0.0]
        return fit(bodies, y, np.zeros_like(x))

    with pytest.raises(ValueError, match=f"particles {particles}\\) deviate from its shape by .* nm"):
        moved(10.0 * REFUSED)
    with pytest.warns(
        ShapeWarning, match=f"affected: 1\\), by up to .* nm for .*particles {particles}\\): set positions"
    ):
        moved(2e-3)
    moved(2e-5)


@pytest.mark.parametrize("molecule", [WATER, CHIRAL, CHIRAL * 1.7, np.eye(4, 3) * 0.11, [[0.0] * 3, [0.1, 0.0, 0.0]]])
def test_positions_rounded_as_in_pdb_files_are_corrected_in_silence(molecule, rng):
    """In any orientation, also as flexible molecules whose lengths are constrained; .gro files round ten times more."""
    sites = np.asarray(molecule, dtype=float)
    for missing in (0, 1):
        system, n = openmm.System(), 300
        attitudes = quaternions.matrix(quaternions.random(rng, n).T).transpose(2, 0, 1)
        x = (quaternions.turned(attitudes, sites[None]) + rng.uniform(0.0, 5.0, (n, 1, 3))).reshape(-1, 3)
        for _ in range(n):
            add_rigid(system, sites, np.linspace(1.0, 16.0, len(sites)))
            if missing and len(sites) > 2:
                system.removeConstraint(system.getNumConstraints() - 1)
        bodies = find_bodies(system, x)
        fit(bodies, np.round(x, 4), np.zeros_like(x))  # a warning would be an error
        with pytest.warns(ShapeWarning, match=r"match the shapes, unless these come from a file with three decimals"):
            fit(bodies, np.round(x, 3), np.zeros_like(x))


def test_the_best_fit_of_distorted_positions_keeps_the_centre_and_is_the_nearest_attitude(mixture, rng):
    system, x, bodies = mixture
    y = x + 5.0 * RIGIDITY * rng.standard_normal(x.shape)
    with pytest.warns(ShapeWarning):
        state = fit(bodies, y, np.zeros_like(x))
    mass = masses_of(system)

    def misfit(q):
        z = bodies.positions(state._replace(q=q), np.zeros_like(x))
        return mass @ ((z - y) ** 2).sum(axis=1)

    massive = mass > 0.0
    z = bodies.positions(state, y.copy())
    np.testing.assert_allclose(mass @ z, mass @ y, rtol=1e-14)
    best = misfit(state.q)
    for axis in range(3):
        for angle in (-1e-3, 1e-3):
            turn = np.zeros((4, 1))
            turn[0], turn[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
            assert misfit(quaternions.multiply(state.q, turn)) >= best
    assert best < mass[massive] @ ((x - y)[massive] ** 2).sum(axis=1)
