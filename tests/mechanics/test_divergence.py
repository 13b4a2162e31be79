"""Divergence: what counts as energy from nowhere, and what a run that makes sense may do."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.mechanics.divergence import gained


def test_energy_from_nowhere_is_reported_in_numbers():
    message = gained(10, (5.0, -100.0), (400.0, 300.0))
    assert "rose from 5 to 400 kJ/mol and the total energy by 400 kJ/mol" in message


@pytest.mark.parametrize(
    ("then", "now"),
    [
        ((5.0, -100.0), (105.0, -100.0)),  # a start that falls
        ((5.0, -100.0), (105.0, -50.0)),  # with an error of half its motion
        ((37.5, 37.5), (9.4, 46.9)),  # a vibration that a step of 1/omega takes from the middle outwards
        ((400.0, 300.0), (5.0, -100.0)),  # what cools
        ((0.0, -1e6), (1e-9, -1e6 + 50.0)),  # rounding in single precision
        ((0.0, 0.0), (1e-9, 1e-5)),  # less than says anything
    ],
)
def test_what_a_run_that_makes_sense_may_do_is_no_divergence(then, now):
    assert gained(10, then, now) is None


def test_bodies_pushed_into_one_another_are_divergence_before_they_move():
    """The potential energy alone: momenta are still what they were."""
    assert gained(10, (37.5, 37.5), (37.5, 1e6)) is not None


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_energy_that_is_not_finite_is_divergence(bad):
    assert gained(10, (5.0, 0.0), (5.0, bad)) is not None


def test_numbers_that_are_not_finite_are_one_kind_of_divergence():
    assert issubclass(rb.NonFiniteError, rb.IntegrationError)
    assert issubclass(rb.IntegrationError, ArithmeticError)
    assert issubclass(rb.IntegrationError, openmm.OpenMMException)
