"""Dielectric constants of gases and liquids of dipoles, beside exact results, another program and the literature."""

import runpy
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import openmm_exactrb as rb
from canonical_dipoles import moments_in, simulation_of
from dielectric_gas import correlation, dielectric_gas


def test_a_run_of_almost_free_dipoles_has_1_plus_3_y():
    simulation, text = simulation_of(27, 0.05, 2.0, 0.1, step=0.04, draw=0.4, sample=0.4)
    simulation.step(4000)
    y = 4.0 * np.pi * 0.05 * 0.1 / (9.0 * 2.0)
    value, error = rb.dielectric_constant(moments_in(text), 27 / 0.05, 2.0)
    assert error < 0.1 * 3.0 * y
    assert abs(value - 1.0 - 3.0 * y * (1.0 + y)) < 4.0 * error


# -- a dilute gas, exactly ------------------------------------------------------------------------------------


def test_the_correlation_of_a_pair_begins_with_the_third_order():
    """<cos gamma exp(-a w)> = 2 a³/75 + ..., from the moments of sines and cosines on the sphere."""
    a = np.array([0.01, 0.02])
    np.testing.assert_allclose(correlation(a, np.zeros(2)), 2.0 * a**3 / 75.0, rtol=1e-3)


def test_the_correlation_of_a_pair_is_the_mean_over_orientations():
    x, weights = np.polynomial.legendre.leggauss(40)
    phi = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    c1, c2, angle = x[:, None, None], x[None, :, None], phi
    ss, cc = np.sqrt((1 - c1**2) * (1 - c2**2)) * np.cos(angle), c1 * c2
    mean = np.mean((ss + cc) * np.exp(-1.7 * (ss - 2.0 * cc) - 0.3), axis=2)
    assert correlation(np.array([1.7]), np.array([0.3]))[0] == pytest.approx(0.25 * weights @ mean @ weights, rel=1e-12)


def test_weak_dipoles_follow_clausius_and_mossotti():
    value, y = dielectric_gas(0.01, 5.0, 0.5, lambda r: 4.0 * r**-12.0)
    assert value == pytest.approx((1.0 + 2.0 * y) / (1.0 - y), rel=1e-8)


@pytest.mark.validate
def test_a_dilute_gas_has_the_dielectric_constant_of_its_pairs():
    """Stockmayer at density 0.02, kT = 2, mu² = 4: the terms left out are of the order of y² = 0.3 % of eps - 1."""
    kT, density, mu2, n = 2.0, 0.02, 4.0, 64
    simulation, text = simulation_of(n, density, kT, mu2, step=0.016, draw=0.4, sample=0.16, attraction=1.0)
    simulation.step(250_000)
    value, error = rb.dielectric_constant(moments_in(text)[200:], n / density, kT)
    exact, y = dielectric_gas(density, kT, mu2, lambda r: 4.0 * (r**-12.0 - r**-6.0))
    print(f"\ngas: {value:.4f} +- {error:.4f}, second order in the density {exact:.4f}, independent {1 + 3 * y:.4f}")
    assert error < 0.003
    assert abs(value - exact) < 3.0 * error + 3.0 * y**3
    assert value - 1.0 - 3.0 * y > 3.0 * error  # the pairs are seen


# -- liquids ----------------------------------------------------------------------------------------------------


@cache
def example():
    return runpy.run_path(str(Path(__file__).parents[2] / "examples" / "dielectric_constant.py"))


def by_ewald_sum(mu2):
    """Return dielectric constant and error by LAMMPS's Ewald sum, forces, rotation and thermostat."""
    ((_, value, error),) = example()["EWALD"][0.822, 1.15, mu2]
    return value, error


def assert_agrees(name, value, error, reference, uncertainty):
    """Compare two dielectric constants, within three of their combined standard errors."""
    print(f"\n{name}: {value:.3f} +- {error:.3f}, reference {reference} +- {uncertainty}")
    assert abs(value - reference) < 3.0 * np.hypot(error, uncertainty)


def liquid(mu2, picoseconds, boundary):
    """Return dielectric constant and error of the Stockmayer fluid at density 0.822 and kT = 1.15."""
    n = 125
    simulation, text = simulation_of(
        n, 0.822, 1.15, mu2, step=0.0125, sample=0.05, attraction=1.0, kernel="compiled", boundary=boundary
    )
    simulation.step(round((40.0 + picoseconds) / 0.0125))
    return rb.dielectric_constant(moments_in(text)[800:], n / 0.822, 1.15, dielectric=boundary.dielectric)


@pytest.mark.validate
def test_a_strongly_polar_liquid_has_the_dielectric_constant_of_another_program():
    """Both by an Ewald sum, with mu² = 3."""
    value, error = liquid(3.0, 4000.0, rb.Ewald())
    assert error < 0.05 * value
    assert_agrees("mu² = 3, Ewald sum", value, error, *by_ewald_sum(3.0))


@pytest.mark.validate
def test_a_ferrofluid_has_the_susceptibility_of_the_literature():
    """Between conductors; theirs are 1000 dipoles, here are 125. See the example for where the value is from."""
    ((state, ((_, reference, uncertainty), _)),), n = example()["FERROFLUID"].items(), 125
    density, kT, mu2 = state
    assert density == pytest.approx(6.0 * 0.0262 / np.pi, rel=1e-3)
    options = {"boundary": rb.Ewald(), "attraction": 1.0, "wca": True}
    simulation, text = simulation_of(n, density, kT, mu2, step=0.03, sample=0.12, **options)
    simulation.step(round(6000.0 / 0.03))
    value, error = rb.dielectric_constant(moments_in(text)[3000:], n / density, kT)
    assert error < 0.02
    assert_agrees("ferrofluid", value, error, reference, uncertainty)


@pytest.mark.validate
def test_the_stockmayer_liquid_has_the_dielectric_constant_of_an_ewald_sum():
    """By a reaction field, which is not enough with mu² = 3 in a box of this size: see docs/tutorials/dielectric.md."""
    value, error = liquid(1.0, 500.0, rb.ReactionField())
    assert error < 0.05 * value
    assert_agrees("mu² = 1, reaction field", value, error, *by_ewald_sum(1.0))


@pytest.mark.validate
def test_other_surroundings_give_the_same_dielectric_constant():
    """The moment fluctuates half as much where the surroundings are as polar as the liquid."""
    value, error = liquid(1.0, 500.0, rb.ReactionField(dielectric=7.0))
    assert_agrees("mu² = 1, surroundings of 7", value, error, *by_ewald_sum(1.0))
