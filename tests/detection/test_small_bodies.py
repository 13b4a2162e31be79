"""Bodies that are far smaller than molecules turn as others do, or are refused; none is silently a point."""

import numpy as np
import pytest

import openmm_exactrb as rb
from starts import context_of, positions_of, system_of

MASSES = [16.0, 1.0, 1.0]
SHAPE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-0.25, 0.97, 0.0]])
PAIRS = [(0, 1), (0, 2), (1, 2)]


def body(extent, named, place, engine="host"):
    """Return a Context with one body, whose shape is that of constraints or, if `named`, of its positions."""
    x = extent * SHAPE
    held = [] if named else [(i, j, float(np.linalg.norm(x[i] - x[j]))) for i, j in PAIRS]
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", bodies=[[0, 1, 2]] if named else None, engine=engine)
    return context_of(system_of(MASSES, held), integrator, x + place), integrator


@pytest.mark.parametrize("engine", ["host", "native"])
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("extent", [1e-2, 3e-4, 5e-5, 1.1e-6])
def test_small_bodies_turn(extent, named, engine):
    context, integrator = body(extent, named, 1.7, engine)
    integrator.setVelocitiesToTemperature(300.0, 1)
    assert integrator.degreesOfFreedom() == (3, 3)
    before, (_, start) = positions_of(context), integrator.bodyState()
    energy, rotational = integrator.totalEnergy()._value, sum(start.m[:, 0] ** 2)
    integrator.step(20)
    after, (_, end) = positions_of(context), integrator.bodyState()
    assert integrator.totalEnergy()._value == pytest.approx(energy, rel=1e-13)
    assert rotational > 0.0
    assert sum(end.m[:, 0] ** 2) == pytest.approx(rotational, rel=1e-12)
    lengths = [[np.linalg.norm(x[i] - x[j]) for i, j in PAIRS] for x in (before, after)]
    np.testing.assert_allclose(lengths[1], lengths[0], rtol=1e-15 * 1.7 / extent + 1e-14)


@pytest.mark.parametrize("named", [True, False])
def test_particles_that_coincide_up_to_roundoff_are_a_point(named):
    held = [] if named else [(0, 1, 0.0)]
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=[[0, 1]] if named else None)
    context = context_of(system_of([3.0, 1.0], held), integrator, [[0.1 + 0.2, 7.0, 1.0], [0.3, 7.0, 1.0]])
    context.setVelocities([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    integrator.step(5)
    assert integrator.degreesOfFreedom() == (3, 0)
    np.testing.assert_allclose(positions_of(context), [[0.305, 7.0, 1.0]] * 2, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("extent", [1.0, 1e-2, 1e-4, 1e-5])
def test_bodies_with_the_same_masses_keep_shapes_of_their_own(extent):
    shapes = [extent * SHAPE, extent * SHAPE * [0.8, 1.1, 1.0]]
    x = np.concatenate([shapes[0], shapes[1] + [1.0, 0.0, 0.0]])
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=[[0, 1, 2], [3, 4, 5]])
    context = context_of(system_of(2 * MASSES), integrator, x)
    integrator.step(0)
    np.testing.assert_allclose(positions_of(context), x, rtol=0.0, atol=1e-15)
    expected = [
        sum(m * float((y - com) @ (y - com)) for m, y in zip(MASSES, shape, strict=True))
        for shape in shapes
        for com in [np.array(MASSES) @ shape / 18.0]
    ]
    found = integrator.bodyState()[0].principal_moments.sum(axis=0) / 2.0
    np.testing.assert_allclose(sorted(found), sorted(expected), rtol=1e-9)
