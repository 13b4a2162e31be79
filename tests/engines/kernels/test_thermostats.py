"""The kernels of thermostats: gamma variates, the factor of stochastic rescaling, and Nosé-Hoover chains."""

import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kernel_functions import U, words_of_numpy
from scipy import stats

from openmm_exactrb.random.rng import PURPOSES, Instant, Purpose
from openmm_exactrb.thermostats import NoseHooverChain
from openmm_exactrb.thermostats.nose_hoover import WEIGHTS
from openmm_exactrb.thermostats.rescaling import scaling

KEY = st.integers(-(2**53), 2**53)
STEP = st.integers(0, 2**40)
STREAM = st.integers(0, 2**20)
SEED = st.integers(0, 2**32 - 1)
FREEDOM = st.one_of(st.integers(1, 10), st.integers(11, 10**6))
KT = 2.5  # kJ/mol


def addresses(n, key, steps, stream):
    """Return arrays (n,) of keys, steps and streams."""
    return np.full(n, key, np.int64), np.broadcast_to(steps, n).astype(np.int64), np.full(n, stream, np.int32)


def gammas(kernels, shape, key, steps, stream):
    """Return a gamma variate of each step."""
    out = np.empty(len(steps))
    kernels("gamma_variates", len(out), *addresses(len(out), key, steps, stream), np.full(len(out), shape), out)
    return out


def factors(kernels, kinetic, f, elapsed, key, steps, stream):
    """Return the factor of stochastic rescaling of each step; `elapsed` is in relaxation times."""
    out, numbers = np.empty(len(steps)), map(float, (kinetic, f, KT, elapsed))
    kernels("scalings", len(out), *numbers, *addresses(len(out), key, steps, stream), out)
    return out


# -- noise ------------------------------------------------------------------------------------------------------------


@given(key=KEY, step=STEP, stream=STREAM, shape=st.one_of(st.floats(0.01, 2.0), st.floats(2.0, 1e6)))
def test_a_gamma_variate_is_that_of_marsaglia_and_tsang(kernels, key, step, stream, shape):
    """The first attempt at words of NumPy's generator that their test accepts, evaluated with thirty digits."""
    (drawn,) = gammas(kernels, shape, key, [step], stream)
    with mp.workdps(30):
        a = mp.mpf(shape)
        d = (a + 1 if shape < 1.0 else a) - mp.mpf(1) / 3
        for attempt in range(1, 100):
            words = words_of_numpy(key % 2**64, (attempt, 1, stream, step))
            u = [(mp.mpf(int(word) >> 11) + 0.5) / 2**53 for word in words]
            x = mp.sqrt(-2 * mp.log(u[0])) * mp.cos(2 * mp.pi * u[1])
            v = (1 + x / mp.sqrt(9 * d)) ** 3
            if v > 0 and mp.log(u[2]) < x * x / 2 + d - d * v + d * mp.log(v):
                break
        expected = d * v * (u[3] ** (1 / a) if shape < 1.0 else 1)
        # The power of u has the relative error of its logarithm.
        roundings = 100.0 + (4.0 * abs(mp.log(u[3]) / a) if shape < 1.0 else 0.0)
        assert abs(drawn - expected) <= roundings * U * expected


@pytest.mark.parametrize("shape", [0.05, 0.5, 1.0, 2.5, 300.0])
def test_gamma_variates_have_their_distribution(kernels, shape):
    drawn = gammas(kernels, shape, 5, np.arange(20_000), 1)
    assert stats.kstest(drawn, "gamma", args=(shape,)).pvalue > 1e-3


def test_a_gamma_variate_without_a_shape_is_zero(kernels):
    assert gammas(kernels, 0.0, 5, [1], 1) == 0.0


# -- stochastic rescaling ---------------------------------------------------------------------------------------------


@given(
    key=KEY,
    step=STEP,
    substep=st.integers(0, 99),
    purpose=st.sampled_from([Purpose.TRANSLATION, Purpose.ROTATION]),
    f=FREEDOM,
    hotter=st.floats(1e-3, 1e3),
    elapsed=st.floats(1e-6, 20.0),
)
def test_the_factor_is_that_of_bussi_and_parrinello(kernels, key, step, substep, purpose, f, hotter, elapsed):
    """Their equations: alpha² in doi:10.1063/1.2408420, appendix, and its sign in doi:10.1016/j.cpc.2008.01.006."""
    kinetic, at = 0.5 * f * KT * hotter, Instant(key, step, substep)
    (found,) = factors(kernels, kinetic, f, elapsed, key, [step], PURPOSES * substep + purpose)
    along, across = at.normals(purpose, (1, 1))[0, 0], 2.0 * at.gamma(purpose, 0.5 * (f - 1))
    with mp.workdps(40):
        c, ratio = mp.exp(-mp.mpf(elapsed)), mp.mpf(KT) / (2 * mp.mpf(kinetic))  # mean over f times present energy
        spread = ratio * (1 - c)
        square = c + spread * (mp.mpf(along) ** 2 + mp.mpf(across)) + 2 * mp.mpf(along) * mp.sqrt(c * spread)
        expected = mp.sqrt(square) * mp.sign(along + mp.sqrt(c / spread))
        # Normal numbers have errors of 36 U.
        parts = float(mp.sqrt(c) + mp.sqrt(spread) * (1 + abs(along) + mp.sqrt(across)))
        assert abs(found - expected) <= 60 * U * parts
    assert found == pytest.approx(scaling(kinetic, KT, elapsed, along, across), rel=0.0, abs=60 * U * parts)


@pytest.mark.parametrize("elapsed", [1e-3, 0.3, 10.0])
@pytest.mark.parametrize("f", [1, 2, 3, 6, 500])
def test_the_kinetic_energy_has_its_exact_law(kernels, f, elapsed):
    """Components of momenta, of which kT/2 is the mean energy, relax to normal ones; their squares add up."""
    hotter, c = 2.0, math.exp(-elapsed)
    kinetic = 0.5 * f * KT * hotter
    found = factors(kernels, kinetic, f, elapsed, 11, np.arange(20_000), 3)
    law = stats.ncx2(f, f * hotter * c / (1.0 - c), scale=(1.0 - c) / (f * hotter))
    assert stats.kstest(found**2, law.cdf).pvalue > 1e-3
    negative = stats.norm.cdf(-math.sqrt(f * hotter * c / (1.0 - c)))
    assert stats.binomtest(int((found < 0.0).sum()), len(found), negative).pvalue > 1e-3


def test_sampled_components_have_the_distribution_of_the_factor(kernels, rng):
    f, elapsed, n = 5, 0.4, 20_000
    start = rng.standard_normal(f)  # in units of the square root of kT
    found = factors(kernels, 0.5 * KT * (start @ start), f, elapsed, 12, np.arange(n), 0)
    relaxed = math.exp(-0.5 * elapsed) * start + math.sqrt(-math.expm1(-elapsed)) * rng.standard_normal((n, f))
    assert stats.ks_2samp(found**2, (relaxed**2).sum(axis=1) / (start @ start)).pvalue > 1e-3


@pytest.mark.parametrize("nothing", ["kinetic", "f", "elapsed"])
def test_momenta_without_energy_freedom_or_time_are_not_scaled(kernels, nothing):
    numbers = {"kinetic": 7.0, "f": 3, "elapsed": 0.1} | {nothing: 0}
    assert factors(kernels, **numbers, key=1, steps=[1], stream=0) == 1.0


def table(tau, *numbers):
    """Return moves (rows, 4) whose second row is exchange 3 of the next step, and the numbers of moves."""
    return np.array([[9, 9, 9, 9], [2, 3 + (1 << 16), 2, 6]], np.int32), np.array([-1.0, -1.0, tau, *numbers])


@pytest.mark.parametrize("together", [True, False])
def test_an_exchange_has_the_noise_of_its_place_and_adds_the_heat(kernels, together):
    totals, freedom, tau, time, heat = np.array([30.0, 20.0]), (9, 6), 0.02, 0.5, 100.0
    out, own = np.empty(2), np.array([heat])
    kernels("rescaling", totals, out, own, *table(tau, KT, time, *map(float, freedom), float(together)), 1, 41, 17.0)
    noise = {"elapsed": tau / time, "key": 17, "steps": [42]}
    if together:
        expected = 2 * [*factors(kernels, totals.sum(), sum(freedom), **noise, stream=3 * PURPOSES)]
    else:
        expected = [
            factors(kernels, totals[k], freedom[k], **noise, stream=3 * PURPOSES + purpose)[0]
            for k, purpose in enumerate((Purpose.TRANSLATION, Purpose.ROTATION))
        ]
    np.testing.assert_array_equal(out, expected)
    assert own[0] == pytest.approx(heat + np.square(expected) @ totals - totals.sum(), abs=1e-12)


# -- Nosé-Hoover chains -----------------------------------------------------------------------------------------------


def settings(chain):
    """Return the numbers of links, of repetitions and of weights, and the weights as text, as a program has them."""
    macros = dict(chain.factors.defines)
    return *(macros[name] for name in ("CHAIN", "REPETITIONS", "N_WEIGHTS")), macros["WEIGHTS"]


def moved(kernels, chain, values, kinetic, f, tau):
    """Return the factor of the momenta and the links (2, chainLength) after a time."""
    end, scale = np.ascontiguousarray(values, float).copy(), np.empty(1)
    numbers = map(float, (kinetic, f, chain._kT, chain.collisionFrequency, tau))  # noqa: SLF001
    kernels("chain", *settings(chain), end, *numbers, scale)
    return scale[0], end


CHAINS = st.builds(
    NoseHooverChain,
    st.floats(1.0, 1000.0),
    st.floats(0.1, 100.0),
    chainLength=st.integers(1, 6),
    numMTS=st.integers(1, 4),
    numYoshidaSuzuki=st.sampled_from(sorted(WEIGHTS)),
)


def start_of(chain, f, seed):
    """Return links (2, chainLength) and a kinetic energy from the canonical distribution."""
    rng, spread = np.random.default_rng(seed), chain.collisionFrequency * np.ones(chain.chainLength)
    spread[0] /= math.sqrt(f)
    links = np.stack([rng.standard_normal(chain.chainLength), spread * rng.standard_normal(chain.chainLength)])
    return links, chain._kT * rng.gamma(0.5 * f)  # noqa: SLF001


def assert_same_links(chain, found, expected, tolerance):
    """Compare coordinates, and velocities in units of the frequency."""
    units = np.array([[1.0], [chain.collisionFrequency]])
    np.testing.assert_allclose(found / units, expected / units, rtol=0.0, atol=tolerance)


@given(chain=CHAINS, f=FREEDOM, seed=SEED, part=st.floats(-0.3, 0.3))
def test_chains_are_those_of_the_host(kernels, chain, f, seed, part):
    (values, kinetic), tau = start_of(chain, f, seed), part / chain.collisionFrequency
    scale, end = moved(kernels, chain, values, kinetic, f, tau)
    of_host, end_of_host = chain.moved(values, kinetic, f, tau)
    assert scale == pytest.approx(of_host, rel=1e-13)
    assert_same_links(chain, end, end_of_host, 1e-13)


def equations(chain, values, kinetic, f, tau):
    """Return the exact factor and links of Martyna, Klein and Tuckerman's equations (1992), by Taylor series."""
    kT, links = mp.mpf(chain._kT), chain.chainLength  # noqa: SLF001
    unit = kT / mp.mpf(chain.collisionFrequency) ** 2
    Q = [f * unit, *[unit] * (links - 1)]

    def derivative(_, y):
        logarithm, v = y[0], y[links + 1 :]
        energies = [2 * mp.mpf(kinetic) * mp.exp(2 * logarithm), *(Q[k] * v[k] ** 2 for k in range(links - 1))]
        means = [f * kT, *[kT] * (links - 1)]
        drags = [*(v[k] * v[k + 1] for k in range(links - 1)), 0]
        pushed = [(energies[k] - means[k]) / Q[k] - drags[k] for k in range(links)]
        return [-v[0], *v, *pushed]

    with mp.workdps(25):
        y = mp.odefun(derivative, 0, [mp.mpf(0), *map(mp.mpf, values.ravel().tolist())])(mp.mpf(tau))
        return float(mp.exp(y[0])), np.array([float(each) for each in y[1:]]).reshape(2, links)


@pytest.mark.parametrize("f", [1, 6, 2685])
@pytest.mark.parametrize("links", [1, 2, 3, 5])
def test_chains_follow_their_equations(kernels, f, links):
    chain, tau = NoseHooverChain(300.0, 20.0, chainLength=links), 0.0005
    values, kinetic = start_of(chain, f, links)
    scale, end = moved(kernels, chain, values, kinetic, f, tau)
    exact, end_exact = equations(chain, values, kinetic, f, tau)
    assert scale == pytest.approx(exact, rel=1e-15)
    assert_same_links(chain, end, end_exact, 4e-15)


@pytest.mark.parametrize(("substeps", "order"), [(1, 2), (3, 4), (5, 4), (7, 6)])
def test_the_error_of_chains_is_that_of_their_order(kernels, substeps, order):
    chain, errors = NoseHooverChain(300.0, 1.0, numMTS=1, numYoshidaSuzuki=substeps), []
    values, kinetic = start_of(chain, 6, 1)
    for tau in (0.1, 0.05):
        scale, end = moved(kernels, chain, values, kinetic, 6, tau)
        exact, end_exact = equations(chain, values, kinetic, 6, tau)
        errors.append(max(abs(scale - exact), np.abs(end - end_exact).max()))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.5)


@given(chain=CHAINS, f=FREEDOM, seed=SEED, part=st.floats(0.0, 0.3))
def test_chains_are_reversible(kernels, chain, f, seed, part):
    (values, kinetic), tau = start_of(chain, f, seed), part / chain.collisionFrequency
    scale, end = moved(kernels, chain, values, kinetic, f, tau)
    back, again = moved(kernels, chain, end, kinetic * scale * scale, f, -tau)
    assert scale * back == pytest.approx(1.0, rel=1e-12)
    assert_same_links(chain, again, values, 1e-12)


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("freedom", [(9, 6), (9, 0)])
def test_an_exchange_has_a_chain_for_all_or_for_each_kind_of_momenta(kernels, together, freedom):
    chain = NoseHooverChain(300.0, 20.0, together=together)
    totals, tau, links = np.array([30.0, 20.0 if freedom[1] else 0.0]), 0.002, chain.chainLength
    own = np.concatenate([start_of(chain, 9, seed)[0].ravel() for seed in range(2)])
    before, out, numbers = own.copy(), np.empty(2), chain.kernel_exchange(tau, freedom)
    kernels("nose_hoover", *settings(chain), totals, out, own, *table(tau, *numbers), 1)
    energies = [(totals.sum(), sum(freedom))] if together else list(zip(totals, freedom, strict=True))
    expected = before.reshape(2, 2, links)
    for k, (kinetic, f) in enumerate(energies):
        if f:
            out_k, expected[k] = moved(kernels, chain, expected[k], kinetic, f, tau)
            assert out[k] == out_k
        else:
            assert out[k] == 1.0
    if together:
        assert out[1] == out[0]
    np.testing.assert_array_equal(own, expected.ravel())
