"""How long a step a scheme bears, and which energy of an oscillator it keeps."""

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import shadow, stability_limit, symmetric
from openmm_exactrb.schemes.stability import oscillated
from sequences import advanced


@pytest.mark.parametrize(
    ("name", "limit"),
    # Published: 2; McLachlan (1995); Blanes, Casas and Sanz-Serna (2014), table 2.
    [("V2", 2.0), ("V2_drift", 2.0), ("S2_2", 2.55), ("S2_3", 4.66), ("S2_4", 5.35)],
)
def test_stability_limits_are_the_published_ones(name, limit):
    assert stability_limit(rb.SCHEMES[name]) == pytest.approx(limit, abs=0.005)


def step_of_an_oscillator(scheme, h):
    """Return the matrix of a step of x'' = -x."""
    return advanced(
        scheme,
        lambda s, tau: np.array([s[0] + tau * s[1], s[1]]),
        lambda s, tau: np.array([s[0], s[1] - tau * s[0]]),
        np.eye(2),
        h,
        # V - (strength/2) tau² f² of f = -x
        gradient_kick=lambda c: lambda s, tau: np.array([s[0], s[1] - tau * (1.0 - c * tau * tau) * s[0]]),
    )


def test_a_harmonic_oscillator_is_bounded_up_to_the_limit_and_not_beyond(scheme):
    limit = stability_limit(scheme)
    scheme = replace(scheme, processor=())  # a change of coordinates, which can be a large one
    power, step = np.eye(2), step_of_an_oscillator(scheme, 0.98 * limit)
    for _ in range(1000):
        power = step @ power
        assert np.abs(power).max() < 100.0
    growth = np.abs(np.linalg.eigvals(step_of_an_oscillator(scheme, limit + 3e-4))).max()
    assert 40_000 * np.log(growth) > np.log(1e3)


def test_the_shadow_energy_is_kept_by_steps(scheme):
    scheme = replace(scheme, processor=())
    step = 0.2
    kinetic, potential = shadow(scheme, step)
    form, matrix = np.diag([potential, kinetic]), step_of_an_oscillator(scheme, step)
    np.testing.assert_allclose(matrix.T @ form @ matrix, form, rtol=1e-14, atol=1e-15)
    # It is an energy: its motion over the step is the step.
    omega = np.sqrt(kinetic * potential)
    assert np.trace(matrix) == pytest.approx(2.0 * np.cos(omega * step), abs=1e-13)
    assert omega == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("first", ["kick", "drift"])
@pytest.mark.parametrize("outer", [0.16, 1.0 / 6.0, 0.1931833275037836, 0.222])
def test_the_shadow_begins_with_the_commutators_of_two_stages(first, outer):
    """Of B(l) A(1/2) B(1 - 2l) A(1/2) B(l): (6l - 1)/12 and (6l² - 6l + 1)/6, times step². Or A and B change over."""
    table = {"b" if first == "kick" else "a": (outer,)}
    scheme, step = symmetric("two", order=2, stages=2, first=first, **table), 0.01
    of_momenta, of_places = (part - 1.0 for part in shadow(scheme, step)[:: 1 if first == "kick" else -1])
    assert of_momenta / step**2 == pytest.approx((6.0 * outer - 1.0) / 12.0, abs=2e-5)
    assert of_places / step**2 == pytest.approx((6.0 * outer**2 - 6.0 * outer + 1.0) / 6.0, abs=2e-5)


def test_the_shadow_continues_beyond_half_a_turn():
    """Steps of S2_3 touch the bound of stability where they turn an oscillator by half a period."""
    scheme = rb.SCHEMES["S2_3"]
    before, after = shadow(scheme, 2.9), shadow(scheme, 3.6)
    for step, (kinetic, potential) in ((2.9, before), (3.6, after)):
        assert np.trace(step_of_an_oscillator(scheme, step)) == pytest.approx(
            2.0 * np.cos(np.sqrt(kinetic * potential) * step), abs=1e-13
        )
    assert 0.8 < np.sqrt(after.kinetic * after.potential) < 1.2


def test_w2_3_passes_half_a_turn_and_keeps_fast_momenta_as_hot_as_slow_ones():
    scheme = rb.SCHEMES["W2_3"]
    assert stability_limit(scheme) == pytest.approx(4.545, abs=0.005)
    for force in (0.3, 0.6, 0.9, 1.1):  # omega times the time a force: up to 183/ps at 6 fs
        assert shadow(scheme, 3.0 * force).kinetic == pytest.approx(1.0, abs=0.02)
    assert shadow(rb.SCHEMES["S2_3"], 2.7).kinetic > 1.04
    assert shadow(rb.SCHEMES["S2_2"], 2.2).kinetic < 0.9


def test_w2_4g_keeps_both_halves_of_the_energy_of_fast_modes():
    """Up to 170/ps at 4 fs per force, where W2_3 leaves places four hundredths too narrow."""
    scheme = rb.SCHEMES["W2_4g"]
    assert stability_limit(scheme) == pytest.approx(5.668, abs=0.005)
    for frequency in (40.0, 80.0, 110.0, 140.0, 170.0):
        kinetic, potential = shadow(scheme, 4 * 0.004 * frequency)
        assert kinetic == pytest.approx(1.0, abs=0.003)
        assert potential == pytest.approx(1.0, abs=0.0015)
    assert shadow(rb.SCHEMES["W2_3"], 3 * 0.004 * 170.0).potential > 1.035


def test_the_shadow_has_all_its_digits_at_every_step(scheme):
    """The energy that a step keeps is that of the logarithm of its matrix: with forty digits more."""
    # Roundoff of the substeps, and of the way to the bound of stability.
    allowed = 1e-15 * len(scheme.sequence) * (1.0 + max(abs(part) for _, part in scheme.sequence))
    for step in (1e-8, 1e-6, 1e-4, 1e-2, 0.3, 1.0):
        got = shadow(scheme, step)
        with mp.workdps(60):
            (qq, qp), (pq, pp) = oscillated(scheme.sequence, mp.mpf(step))
            angle = mp.acos((qq + pp) / 2)
            angle = 2 * mp.pi - angle if qp < 0 else angle
            width = mp.sin(angle) * angle / step
            assert abs(got.kinetic + width / pq) < allowed, step
            assert abs(got.potential - width / qp) < allowed, step
