"""Numbers that a user hands over are taken as they are, or refused in one sentence."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb.support import checks
from starts import system_of

ROWS = [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize(
    "given",
    [
        iter(ROWS),
        (iter(row) for row in ROWS),
        map(tuple, ROWS),
        zip(*zip(*ROWS, strict=True), strict=True),
        np.array(ROWS),
    ],
    ids=["iterator", "iterators", "map", "zip", "array"],
)
def test_lists_of_particles_may_be_iterators(given):
    assert checks.lists_of_indices(given, "bodies") == ROWS


def test_an_iterator_names_the_bodies():
    """Two molecules without constraints: a step keeps their shapes."""
    system = system_of(6 * [1.0])
    integrator = rb.ExactRigidBodyIntegrator(0.01, bodies=iter(ROWS))
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    context.setPositions(np.concatenate([corners, corners + 1.0]))
    context.setVelocities(np.random.default_rng(1).standard_normal((6, 3)))
    integrator.step(10)
    x = context.getState(positions=True).getPositions(asNumpy=True)._value
    for body in ROWS:
        assert np.linalg.norm(x[body[1]] - x[body[2]]) == pytest.approx(0.02**0.5, abs=1e-12)


def test_whole_numbers_keep_their_last_digit():
    assert checks.whole(2**53 + 1, "seed") == 2**53 + 1
    assert checks.whole(np.int64(2**62 + 1), "seed") == 2**62 + 1
    assert checks.whole(3.0, "seed") == 3


@pytest.mark.parametrize(
    "given",
    [
        [1.0 + 0.0j],
        np.array([1.0 + 1.0j]),
        "1",
        ["1", "2"],
        [None, 1.0],
        [[1.0, 2.0], [1.0]],
        [10**400, 1.0],
        {1: 2.0},
        2.0 * unit.kelvin,
        np.ones(2) * unit.angstrom,
        [2.0 * unit.kelvin] * 2,
    ],
)
def test_arrays_of_something_else_than_numbers_are_refused(given):
    with pytest.raises(ValueError, match="x must be real numbers") as caught:
        checks.array(given, "x")
    assert "\n" not in str(caught.value)


def test_arrays_of_numbers_of_any_kind_are_taken():
    got = checks.array([Fraction(1, 4), Decimal("0.5"), True, np.float32(2.0), 3], "x")
    np.testing.assert_array_equal(got, [0.25, 0.5, 1.0, 2.0, 3.0])
    assert got.dtype == np.float64
    assert np.isnan(checks.array([np.nan, np.inf], "x")[0])
