"""The dielectric constant from fluctuations: the formula, its error, and surroundings."""

import numpy as np
import pytest
from openmm import unit
from scipy.signal import lfilter
from scipy.special import erf

import openmm_exactrb as rb
from openmm_exactrb.potentials.dielectric import reaction

KT, VOLUME = 1.2, 30.0
E_NM = unit.elementary_charge * unit.nanometer


def moments_of(variance, n, rng, memory=0.0):
    """Return Gaussian moments (n, 3) with this variance of a component, remembering a part of the one before."""
    noise = (1.0 - memory**2) ** 0.5 * rng.standard_normal((n, 3))
    noise[0] /= (1.0 - memory**2) ** 0.5
    return variance**0.5 * lfilter([1.0], [1.0, -memory], noise, axis=0)


def test_independent_dipoles_between_conductors_have_1_plus_3_y(rng):
    n, mu2 = 50, 0.8
    u = rng.standard_normal((20_000, n, 3))
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    value, error = rb.dielectric_constant(mu2**0.5 * u.sum(axis=1), VOLUME, KT)
    y = 4.0 * np.pi * n * mu2 / (9.0 * VOLUME * KT)
    # <M²> of Gaussian components: a relative error of sqrt(2/(3 n)).
    assert error == pytest.approx(3.0 * y * (2.0 / 60_000) ** 0.5, rel=0.3)
    assert abs(value - 1.0 - 3.0 * y) < 4.0 * error


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_the_error_is_right(rng, memory):
    """Deviations over the error of many short runs are those of a t distribution with 59 degrees of freedom."""
    deviations = []
    for _ in range(120):
        value, error = rb.dielectric_constant(moments_of(2.0, 4000, rng, memory), VOLUME, KT)
        deviations.append((value - 1.0 - 4.0 * np.pi * 2.0 / (VOLUME * KT)) / error)
    assert abs(np.mean(deviations)) < 4.0 / 120**0.5
    assert 0.85 < np.std(deviations) < 1.2
    assert np.mean(np.abs(deviations) < 1.0) == pytest.approx(erf(0.5**0.5), abs=0.12)


@pytest.mark.parametrize("surroundings", [1.0, 2.5, 7.0, np.inf])
def test_surroundings_change_the_fluctuations_and_not_the_result(rng, surroundings):
    """Onsager's and Kirkwood's relation x = (eps - 1)(2 eps' + 1)/(3 (2 eps' + eps)) gives eps back."""
    eps = 4.0
    x = (eps - 1.0) / 3.0
    if np.isfinite(surroundings):
        x *= (2.0 * surroundings + 1.0) / (2.0 * surroundings + eps)
    M = np.zeros((40, 3))
    M[:, 0] = (9.0 * VOLUME * KT * x / (4.0 * np.pi)) ** 0.5
    value, _ = rb.dielectric_constant(M, VOLUME, KT, dielectric=surroundings)
    assert value == pytest.approx(eps, rel=1e-13)


def test_the_error_follows_the_formula_of_the_surroundings(rng):
    M = moments_of(4.0, 4000, rng)
    for surroundings in (1.0, 3.0, np.inf):
        value, error = rb.dielectric_constant(M, VOLUME, KT, dielectric=surroundings)
        more, _ = rb.dielectric_constant((1.0 + 1e-6) * M, VOLUME, KT, dielectric=surroundings)
        plain, plain_error = rb.dielectric_constant(M, VOLUME, KT)
        assert error / (more - value) == pytest.approx(plain_error / (2e-6 * (plain - 1.0)), rel=1e-4)


def test_fluctuations_that_no_dielectric_has_give_infinity():
    assert rb.dielectric_constant(np.full((40, 3), 10.0), VOLUME, KT, dielectric=1.0) == (np.inf, np.inf)


def test_surroundings_answer_with_a_factor_from_0_to_1():
    assert [reaction(eps) for eps in (1.0, 4.0, np.inf)] == [0.0, pytest.approx(2.0 / 3.0, rel=1e-15), 1.0]
