"""Stochastic velocity rescaling: the exact law of the kinetic energy, at once and in the long run."""

import numpy as np
import pytest
from scipy import stats

from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.random.rng import Instant
from openmm_exactrb.thermostats.rescaling import kinetic_energy, rescaling

AT = Instant(seed=5, step=7, substep=2)
MASS = np.array([18.0, 1.0, 0.0, 40.0])
MOMENTS = np.array([[1.0, 0.0], [10.0, 3.0], [1000.0, 3.0]])  # the second body is linear
FREEDOM = (9, 5)
LONG = pytest.mark.validate  # the law of a step is tested of all


def momenta(rng):
    return exactly(rng.standard_normal((3, 4)) * (MASS > 0.0)), exactly(rng.standard_normal((3, 2)) * (MOMENTS > 0.0))


def prepared(kT=2.5, time=0.7, freedom=FREEDOM, together=True):
    return rescaling(MASS, MOMENTS, kT, time, freedom, together)


def kinetic_energies(P, m):
    rates = [np.divide(1.0, x, out=np.zeros(x.shape), where=x > 0.0) for x in (MASS, MOMENTS)]
    return kinetic_energy(P, rates[0]), kinetic_energy(m, rates[1])


def single(f, kT, time):
    """Return rescale of a chain with f degrees of freedom: f axes of unit mass, as angular momenta."""
    moments = np.zeros((3, (f + 2) // 3))
    moments.ravel()[:f] = 1.0
    return moments, rescaling(np.zeros(0), moments, kT, time, (0, f), together=True)


@pytest.mark.parametrize("f", [1, 2, 60])
@pytest.mark.parametrize("elapsed", [0.01, 1.0])
def test_the_kinetic_energy_later_has_the_exact_law(f, elapsed):
    """From K the law of 2 K'/(kT (1 - c)) is chi-squared, shifted by 2 K c/(kT (1 - c)), with c = exp(-elapsed)."""
    kT, time = 1.7, 0.4
    moments, rescale = single(f, kT, time)
    m = exactly(moments * 1.3)
    none = exactly(np.zeros((3, 0)))
    before, c = 0.5 * f * 1.3**2, np.exp(-elapsed)
    momenta = (rescale(none, m, elapsed * time, Instant(3, step, 0))[1] for step in range(1500))
    after = [0.5 * (m[0] ** 2).sum() for m in momenta]
    unit = 0.5 * kT * (1.0 - c)
    assert stats.kstest(np.array(after) / unit, "ncx2", args=(f, before * c / unit)).pvalue > 1e-3


@LONG
@pytest.mark.parametrize("f", [1, 3, 60])
def test_a_long_run_is_canonical_and_forgets_in_the_relaxation_time(f):
    kT, time, tau, n = 1.7, 0.4, 0.2, 10_000
    moments, rescale = single(f, kT, time)
    m, none, K = exactly(moments), exactly(np.zeros((3, 0))), np.empty(n)
    for step in range(n):
        _, m = rescale(none, m, tau, Instant(4, step, 0))
        K[step] = 0.5 * (m[0] ** 2).sum()
    assert stats.kstest(K[20::12], "gamma", args=(0.5 * f, 0.0, kT)).pvalue > 1e-3  # apart by six relaxation times
    d = K - 0.5 * f * kT
    for lag in (1, 2, 4):
        exact = np.exp(-lag * tau / time)
        # The error of a correlation, from blocks.
        blocks = (d[:-lag] * d[lag:])[: n - n % 50 - 50].reshape(50, -1).mean(axis=1) / (0.5 * f * kT**2)
        assert abs(blocks.mean() - exact) < 4.0 * blocks.std(ddof=1) / np.sqrt(50)


def test_one_degree_of_freedom_changes_its_sign():
    """Its momentum relaxes as in the Ornstein-Uhlenbeck flow of half the rate, and so passes through zero."""
    elapsed, kT = 0.5, 1.0
    moments, rescale = single(1, kT, 1.0)
    m, none = exactly(moments * 0.6), exactly(np.zeros((3, 0)))
    after = np.array([rescale(none, m, elapsed, Instant(5, step, 0))[1][0, 0, 0] for step in range(1500)])
    law = (0.6 * np.exp(-0.5 * elapsed), np.sqrt(kT * -np.expm1(-elapsed)))
    assert stats.kstest(after, "norm", args=law).pvalue > 1e-3


@pytest.mark.parametrize("together", [True, False])
def test_directions_stay(rng, together):
    P, m = momenta(rng)
    P1, m1 = prepared(together=together)(P, m, 0.3, AT)
    ratios = []
    for x, x1 in ((P, P1), (m, m1)):
        moving = x[0] != 0.0
        assert (x1[0][~moving] == 0.0).all()
        ratio = x1[0][moving] / x[0][moving]
        assert np.ptp(ratio) < 1e-15
        ratios.append(ratio.mean())
    assert bool(abs(ratios[0] - ratios[1]) < 1e-15) == together


def test_translation_and_rotation_find_their_own_temperatures():
    """Started at 5 kT and at nothing much, each finds its own kT, where one factor for both keeps the ratio."""
    P, m = exactly(np.sqrt(5.0 * 2.5 * MASS) * np.ones((3, 4))), exactly(0.01 * np.sqrt(MOMENTS))
    rescale, means = prepared(together=False), np.zeros(2)
    for step in range(1500):
        P, m = rescale(P, m, 1.4, Instant(6, step, 0))
        if step >= 20:
            means += kinetic_energies(P, m)
    means /= 1480.0 * 0.5 * 2.5 * np.array(FREEDOM)
    # Successive energies are correlated by exp(-2), relative variances are 2/f.
    widths = np.sqrt(2.0 / np.array(FREEDOM) / 1480.0 * (1.0 + np.exp(-2.0)) / (1.0 - np.exp(-2.0)))
    assert (np.abs(means - 1.0) < 4.0 * widths).all()


def test_no_time_and_no_motion_leave_the_momenta(rng):
    P, m = momenta(rng)
    P1, m1 = prepared()(P, m, 0.0, AT)
    assert P1 is P
    assert m1 is m
    still = exactly(np.zeros((3, 4))), exactly(np.zeros((3, 2)))
    P1, _ = prepared()(*still, 1.0, AT)
    assert P1 is still[0]
