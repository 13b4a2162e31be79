"""How long a step a scheme bears."""

from dataclasses import replace

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import stability_limit
from words import advanced


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
    for _ in range(3000):
        power = step @ power
        assert np.abs(power).max() < 100.0
    growth = np.abs(np.linalg.eigvals(step_of_an_oscillator(scheme, limit + 3e-4))).max()
    assert 40_000 * np.log(growth) > np.log(1e3)
