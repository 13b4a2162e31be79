"""The axes of named bodies belong to their particles: not to roundoff, and not to how a body is oriented at first."""

import numpy as np
import openmm
import pytest
from numpy.testing import assert_allclose

import openmm_exactrb as rb
from places import REFERENCE
from products import spread_over
from starts import positions_of, system_of

_TETRAHEDRON = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) / 16.0
_OCTAHEDRON = 0.156 * np.concatenate([np.eye(3), -np.eye(3)])
_CUBE = 0.07 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
_RANDOM = np.random.default_rng(8).uniform(-0.15, 0.15, (12, 3))


def _ring(n, radius, height=0.0):
    angles = 2.0 * np.pi * np.arange(n) / n
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(n, height)])


#: Places (nm) and masses of spherical, symmetric, flat, linear and asymmetric bodies.
SHAPES = {
    "methane": (np.concatenate([np.zeros((1, 3)), _TETRAHEDRON]), [12, 1, 1, 1, 1]),
    "octahedron": (np.concatenate([np.zeros((1, 3)), _OCTAHEDRON]), [32, *6 * [19]]),
    "cube": (_CUBE, 8 * [12]),
    "benzene": (np.concatenate([_ring(6, 0.14), _ring(6, 0.248)]), [*6 * [12], *6 * [1]]),
    "square": (_ring(4, 0.13), 4 * [16]),
    "ammonia": (np.concatenate([[[0, 0, 0.04]], _ring(3, 0.094)]), [14, 1, 1, 1]),
    "pentagonal prism": (np.concatenate([_ring(5, 0.12, 0.1), _ring(5, 0.12, -0.1)]), 10 * [12]),
    "dimer": (np.array([[0, 0, 0], [0.11, 0, 0]]), [14, 16]),
    "rod": (np.outer([-0.12, 0.0, 0.12], [1, 0, 0]), [16, 12, 16]),
    "triangle": (_RANDOM[:3], [16, 2, 5]),
    "four": (_RANDOM[3:7], [3, 20, 7, 11]),
    "twelve": (_RANDOM, list(range(1, 13))),
}


def turned(rng):
    """Return a random rotation (3, 3)."""
    matrix = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    return matrix * np.linalg.det(matrix)


def moving(shape, engine="host", scheme="BAOA", start=None):
    """Return a Context with two bodies of a shape, at a start or turned by chance, and particles of the bodies."""
    places, masses = SHAPES[shape]
    k = len(masses)
    bodies = [range(k), range(k, 2 * k)]
    thermostat = rb.thermostats.Langevin(300.0, 20.0) if scheme != "W2_1" else None
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme, bodies=bodies, engine=engine, thermostat=thermostat)
    integrator.setRandomNumberSeed(4)
    system = system_of(2 * masses)
    spring = openmm.CustomExternalForce("200*((x-1)^2+(y-2)^2+(z+1)^2)")
    for i in range(0, 2 * k, 2):
        spring.addParticle(i)
    system.addForce(spring)
    context = openmm.Context(system, integrator, REFERENCE)
    if start is not None:
        rng = np.random.default_rng(start)
        context.setPositions(np.concatenate([places @ turned(rng).T + rng.uniform(-2, 2, 3) for _ in bodies]))
    return context


@pytest.mark.parametrize("shape", SHAPES)
def test_bodies_have_the_same_sites_however_they_are_turned_and_wherever_they_are(shape):
    found = []
    for start in range(6):
        context = moving(shape, start=start)
        context.getIntegrator().step(0)
        bodies, _ = context.getIntegrator().bodyState()
        found.append(np.concatenate([kind.sites[0] for kind in bodies.kinds]))
    for sites in found:
        assert_allclose(sites, found[0], rtol=0.0, atol=1e-13)
    places, masses = SHAPES[shape]
    tensor = np.einsum("s,si,sj->ij", masses, found[0], found[0])
    assert_allclose(tensor, np.diag(np.diag(tensor)), rtol=0.0, atol=1e-11 * tensor.max())
    distances = [np.linalg.norm(x[:, None] - x, axis=2) for x in (found[0], places)]
    assert_allclose(*distances, rtol=0.0, atol=1e-14)
    handed = [np.linalg.det(x[:, :3] - x[:, 3:4]) for x in (found[0][:4].T, np.array(places)[:4].T) if x.shape[1] > 3]
    assert_allclose(handed[:1], handed[1:], rtol=0.0, atol=1e-16)


@spread_over({"shape": SHAPES, "engine": ["host", "native"], "scheme": ["BAOA", "W2_3m", "W2_1"]}, times=2)
def test_a_checkpoint_continues_the_run_in_a_new_context(shape, engine, scheme):
    """With the same noise and, for a processed scheme, in the same inner coordinates."""
    context = moving(shape, engine, scheme, start=1)
    integrator = context.getIntegrator()
    integrator.setVelocitiesToTemperature(300.0, 1)
    integrator.step(10)
    checkpoint = context.createCheckpoint()
    integrator.step(10)
    others = [moving(shape, engine, scheme, start) for start in (None, 1, 2)]
    others[2].getIntegrator().step(1)
    for other in others:
        other.loadCheckpoint(checkpoint)
        other.getIntegrator().step(10)
        assert_allclose(positions_of(other), positions_of(context), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_engines_have_the_same_noise_from_the_same_start(shape):
    """The second begins with the positions that the first one shows, which differ by roundoff."""
    host = moving(shape, "host", start=3)
    host.getIntegrator().setVelocitiesToTemperature(300.0, 1)
    native = moving(shape, "native", start=None)
    state = host.getState(positions=True, velocities=True)
    native.setPositions(state.getPositions())
    native.setVelocities(state.getVelocities())
    for context in (host, native):
        context.getIntegrator().step(20)
    assert_allclose(positions_of(native), positions_of(host), rtol=0.0, atol=1e-13)
