"""Bodies that a periodic box has split are put together, however long they are."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.mechanics.images import joined

REFERENCE = openmm.Platform.getPlatform("Reference")
BOX = np.array([[1.0, 0.0, 0.0], [0.2, 1.0, 0.0], [-0.1, 0.3, 1.0]])


@pytest.mark.parametrize("box", [np.eye(3), BOX])
def test_a_body_longer_than_half_the_box_is_joined_wherever_it_is_split(box):
    rng = np.random.default_rng(4)
    chain = np.cumsum(rng.uniform(0.02, 0.16, (6, 1)) * [1.0, 0.2, 0.1], axis=0)
    assert np.ptp(chain @ np.linalg.inv(box), axis=0).max() < 1.0
    for shift in rng.uniform(0.0, 1.0, (50, 3)):
        x = (chain + shift)[rng.permutation(6)]
        split = x - np.floor(x @ np.linalg.inv(box)) @ box
        y = joined(split, np.arange(6)[None], box)
        np.testing.assert_allclose(y - y[0], x - x[0], rtol=0.0, atol=1e-12)


def inertia_of(x, constrained):
    """Return the moments of a body of six particles in a box of 1 nm."""
    system, pairs = openmm.System(), openmm.NonbondedForce()
    for _ in x:
        system.addParticle(4.0)
        pairs.addParticle(0.0, 0.1, 0.0)
    pairs.setNonbondedMethod(pairs.CutoffPeriodic)
    pairs.setCutoffDistance(0.4)
    system.addForce(pairs)
    system.setDefaultPeriodicBoxVectors(*np.eye(3))
    if constrained:
        for i in range(len(x)):
            for j in range(i):
                system.addConstraint(i, j, float(np.linalg.norm(LONG[i] - LONG[j])))
    integrator = rb.ExactRigidBodyIntegrator(1e-4, bodies=None if constrained else [list(range(len(x)))])
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    integrator.step(1)
    return integrator.bodyState()[0].inertia


HEIGHTS = [[0.5, 0.5], [0.55, 0.5], [0.5, 0.6], [0.5, 0.5], [0.6, 0.5], [0.5, 0.55]]
LONG = np.column_stack([0.45 + 0.12 * np.arange(6), HEIGHTS])


@pytest.mark.parametrize("constrained", [True, False])
def test_its_moments_do_not_depend_on_where_it_is_split(constrained):
    np.testing.assert_allclose(inertia_of(LONG % 1.0, constrained), inertia_of(LONG, constrained), rtol=1e-7)
