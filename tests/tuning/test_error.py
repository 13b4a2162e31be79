"""What an error is: a swing does not grow with the run, a walk and a drift do."""

import math

import numpy as np
import pytest

from openmm_exactrb.tuning.error import expected_error


def test_the_error_of_a_swing_does_not_grow_with_the_run(rng):
    energies = rng.standard_normal(4000)
    assert expected_error(energies, 0.1, 4000.0) == pytest.approx(1.0, rel=0.1)


def test_the_error_of_a_random_walk_grows_with_the_root_of_the_run(rng):
    walks = np.cumsum(rng.standard_normal((200, 4000)), axis=1)
    actual = np.sqrt(walks.var(axis=1).mean())
    guesses = [expected_error(walk[:400], 1.0, 4000.0) for walk in walks]
    assert 0.7 < np.median(guesses) / actual < 1.6
    longer = np.array([expected_error(walk[:2000], 1.0, 4000.0) for walk in walks])
    assert (walks.std(axis=1) > 2.0 * longer).mean() < 0.04


def test_a_drift_counts():
    assert expected_error(np.linspace(0.0, 1.0, 800), 1.0, 800.0) == pytest.approx(1.0 / math.sqrt(12.0), rel=0.6)


@pytest.mark.parametrize("swing", [0.0, 0.1, 0.5])
def test_a_drift_is_extrapolated_as_a_line(rng, swing):
    """Also from beneath a swing: the standard deviation of a line is its rise over sqrt(12)."""
    run = np.linspace(0.0, 10.0, 3000) + swing * rng.standard_normal(3000)
    assert expected_error(run[:300], 1.0, 3000.0) == pytest.approx(run.std(), rel=0.15)


@pytest.mark.parametrize(("known", "least", "most"), [(1500, 0.01, 0.04), (300, 0.09, 0.18)])
def test_walks_exceed_twice_the_answer_as_often_as_documented(rng, known, least, most):
    walks = np.cumsum(rng.standard_normal((600, 3000)), axis=1)
    answers = np.array([expected_error(walk[:known], 1.0, 3000.0) for walk in walks])
    assert least < (walks.std(axis=1) > 2.0 * answers).mean() < most
