"""The dielectric constant from fluctuations: formula and error, a dilute gas, a liquid beside an Ewald sum."""

import io
import runpy
from functools import cache
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app, unit
from scipy.signal import lfilter
from scipy.special import erf

import openmm_exactrb as rb
from dielectric_gas import _correlation, dielectric_gas

KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
REFERENCE = openmm.Platform.getPlatform("Reference")
KT, VOLUME = 1.2, 30.0


def moments_of(variance, n, rng, memory=0.0):
    """Return Gaussian moments (n, 3) with this variance of a component, remembering a part of the one before."""
    noise = (1.0 - memory**2) ** 0.5 * rng.standard_normal((n, 3))
    noise[0] /= (1.0 - memory**2) ** 0.5
    return variance**0.5 * lfilter([1.0], [1.0, -memory], noise, axis=0)


# -- formula and error ------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"moments": np.zeros((40, 2))}, "rows of three finite numbers"),
        ({"moments": np.full((40, 3), np.nan)}, "rows of three finite numbers"),
        ({"volume": 0.0}, "volume must be positive"),
        ({"kT": -1.0}, "kT must be positive"),
        ({"dielectric": 0.5}, "dielectric must be at least 1"),
        ({"blocks": 1}, "blocks must be at least 2"),
        ({"blocks": 41}, "blocks must be at least 2"),
    ],
)
def test_wrong_values_get_one_sentence(changes, message):
    with pytest.raises(ValueError, match=message):
        rb.dielectric_constant(**({"moments": np.ones((40, 3)), "volume": 1.0, "kT": 1.0} | changes))


# -- reporters --------------------------------------------------------------------------------------------------


def simulation_of(n, density, kT, mu2, *, step, draw=0.5, sample=0.1, seed=1, **options):
    """Return a Simulation in the canonical ensemble, and the text that its moments go to."""
    topology, system, positions = rb.dipole_fluid(
        n, seed, dipole=(0.0, 0.0, mu2**0.5), inertia=(0.2, 0.2, 0.2), periodic=True, density=density, **options
    )
    ends = {"C": -2.0 * mu2**0.5, "D": 2.0 * mu2**0.5}
    charges = [ends.get(atom.name, 0.0) for atom in topology.atoms()]
    integrator = rb.ExactRigidBodyIntegrator(step, scheme="S2_2")
    simulation = app.Simulation(topology, system, integrator, REFERENCE)
    simulation.context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(simulation.context, 100.0, 50)
    integrator.setVelocitiesToTemperature(kT / KB, seed)
    text = io.StringIO()
    simulation.reporters.append(rb.MomentReporter(text, round(sample / step), charges))
    simulation.reporters.append(rb.CanonicalMomenta(kT / KB, round(draw / step), seed))
    return simulation, text


def moments_in(text):
    return np.loadtxt(io.StringIO(text.getvalue()), delimiter=",", skiprows=1, ndmin=2)[:, 2:]


def test_the_moment_is_the_sum_of_the_dipoles():
    simulation, text = simulation_of(8, 0.1, 1.0, 2.0, step=0.01)
    simulation.step(30)
    x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value.reshape(8, -1, 3)
    total = 2.0 * 2.0**0.5 * (x[:, -1] - x[:, -2]).sum(axis=0)
    np.testing.assert_allclose(moments_in(text)[-1], total, rtol=0.0, atol=1e-13)
    assert len(moments_in(text)) == 3


def test_a_run_of_almost_free_dipoles_has_1_plus_3_y():
    simulation, text = simulation_of(27, 0.05, 2.0, 0.1, step=0.04, draw=0.4, sample=0.4)
    simulation.step(4000)
    y = 4.0 * np.pi * 0.05 * 0.1 / (9.0 * 2.0)
    value, error = rb.dielectric_constant(moments_in(text), 27 / 0.05, 2.0)
    assert error < 0.1 * 3.0 * y
    assert abs(value - 1.0 - 3.0 * y * (1.0 + y)) < 4.0 * error


# -- a dilute gas, exactly --------------------------------------------------------------------------------------


def test_the_correlation_of_a_pair_begins_with_the_third_order():
    """<cos gamma exp(-a w)> = 2 a³/75 + ..., from the moments of sines and cosines on the sphere."""
    a = np.array([0.01, 0.02])
    np.testing.assert_allclose(_correlation(a, np.zeros(2)), 2.0 * a**3 / 75.0, rtol=1e-3)


def test_the_correlation_of_a_pair_is_the_mean_over_orientations():
    x, weights = np.polynomial.legendre.leggauss(40)
    phi = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    c1, c2, angle = x[:, None, None], x[None, :, None], phi
    ss, cc = np.sqrt((1 - c1**2) * (1 - c2**2)) * np.cos(angle), c1 * c2
    mean = np.mean((ss + cc) * np.exp(-1.7 * (ss - 2.0 * cc) - 0.3), axis=2)
    assert _correlation(np.array([1.7]), np.array([0.3]))[0] == pytest.approx(
        0.25 * weights @ mean @ weights, rel=1e-12
    )


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
    return runpy.run_path(str(Path(__file__).parent.parent / "examples" / "dielectric_constant.py"))


def by_ewald_sum(mu2):
    """Return dielectric constant and error by LAMMPS's Ewald sum, forces, rotation and thermostat."""
    return example()["EWALD"][0.822, 1.15, mu2]


def assert_agrees(name, value, error, reference, uncertainty):
    """Compare two dielectric constants, within three of their combined standard errors."""
    print(f"\n{name}: {value:.3f} +- {error:.3f}, reference {reference} +- {uncertainty}")
    assert abs(value - reference) < 3.0 * np.hypot(error, uncertainty)


def liquid(mu2, picoseconds, **options):
    """Return dielectric constant and error of the Stockmayer fluid at density 0.822 and kT = 1.15."""
    n = 125
    simulation, text = simulation_of(
        n, 0.822, 1.15, mu2, step=0.0125, sample=0.05, attraction=1.0, kernel="compiled", **options
    )
    simulation.step(round((40.0 + picoseconds) / 0.0125))
    surroundings = {name: value for name, value in options.items() if name == "dielectric"}
    return rb.dielectric_constant(moments_in(text)[800:], n / 0.822, 1.15, **surroundings)


@pytest.mark.validate
def test_a_strongly_polar_liquid_has_the_dielectric_constant_of_another_program():
    """Both by an Ewald sum, with mu² = 3."""
    value, error = liquid(3.0, 4000.0, long_range="ewald")
    assert error < 0.05 * value
    assert_agrees("mu² = 3, Ewald sum", value, error, *by_ewald_sum(3.0))


@pytest.mark.validate
def test_a_ferrofluid_has_the_susceptibility_of_the_literature():
    """Between conductors; theirs are 1000 dipoles, here are 125. See the example for where the value is from."""
    (state, (reference, uncertainty)), n = *example()["FERROFLUID"].items(), 125
    density, kT, mu2 = state
    assert density == pytest.approx(6.0 * 0.0262 / np.pi, rel=1e-3)
    options = {"long_range": "ewald", "attraction": 1.0, "wca": True}
    simulation, text = simulation_of(n, density, kT, mu2, step=0.03, sample=0.12, **options)
    simulation.step(round(6000.0 / 0.03))
    value, error = rb.dielectric_constant(moments_in(text)[3000:], n / density, kT)
    assert error < 0.02
    assert_agrees("ferrofluid", value, error, reference, uncertainty)


@pytest.mark.validate
def test_the_stockmayer_liquid_has_the_dielectric_constant_of_an_ewald_sum():
    """By a reaction field, which is not enough with mu² = 3 in a box of this size: see docs/guide.md."""
    value, error = liquid(1.0, 500.0)
    assert error < 0.05 * value
    assert_agrees("mu² = 1, reaction field", value, error, *by_ewald_sum(1.0))


@pytest.mark.validate
def test_other_surroundings_give_the_same_dielectric_constant():
    """The moment fluctuates half as much where the surroundings are as polar as the liquid."""
    value, error = liquid(1.0, 500.0, dielectric=7.0)
    assert_agrees("mu² = 1, surroundings of 7", value, error, *by_ewald_sum(1.0))


def test_a_new_file_gets_the_names_of_its_columns_also_when_appended_to(tmp_path):
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    assert (tmp_path / "moments.csv").read_text() == "step,time (ps),Mx,My,Mz\n"
