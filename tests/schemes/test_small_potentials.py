"""Schemes for a potential that is small: their generalised orders, processors, and force gradients."""

from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp

import openmm_exactrb as rb
from benchmarks.paper.problems import HeavyTop, energy, integrate
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.steps.substeps import DRIFT, KICK, GradientKick
from orders import exponent, slope


@pytest.fixture(params=[name for name, scheme in rb.SCHEMES.items() if scheme.generalised])
def nearly_integrable(request):
    return look_up(request.param)


def energy_errors(epsilon, scheme, steps, T=40.0):
    """Median over tops of the largest error of the energy, by its parts even and odd in epsilon."""
    tops = [HeavyTop.random(np.random.default_rng(8), sign * epsilon, 1.0, 24) for sign in (1.0, -1.0)]
    starts = [energy(problem, state) for problem, state in tops]
    errors = []
    for h in steps:
        moved, largest = [state for _, state in tops], np.zeros((2, 24))
        for _ in range(10):
            moved = [
                integrate(top, state, h, round(T / 10 / h), scheme) for (top, _), state in zip(tops, moved, strict=True)
            ]
            up, down = (energy(top, state) - start for (top, _), state, start in zip(tops, moved, starts, strict=True))
            largest = np.maximum(largest, np.abs([up + down, up - down]) / 2.0)
        errors.append(np.median(largest, axis=1))
    return np.array(errors).T


# Steps at which the part of the error that is linear in V falls with its power of h, above roundoff.
STEPS = {4: (0.3, 0.4, 0.5, 0.6), 6: (0.5, 0.6, 0.7, 0.8), 8: (0.9, 1.0, 1.1, 1.2, 1.3)}


def test_the_first_generalised_order_is_that_of_a_vanishing_potential(nearly_integrable):
    scheme, first = nearly_integrable, nearly_integrable.generalised[0]
    if first not in STEPS:
        pytest.skip("so high an order drowns in roundoff: its series is tested below")
    _, linear = energy_errors(1e-4, scheme, STEPS[first], T=60.0)
    assert abs(exponent(STEPS[first], linear) - first) < 0.5


def kicks_with_times(sequence):
    time, kicks = mp.mpf(0), []
    for substep, part in sequence:
        if substep == DRIFT:
            time += mp.mpf(part)
        else:
            kicks.append((mp.mpf(part), time))
    return kicks


def test_the_error_linear_in_the_potential_has_the_first_generalised_order(nearly_integrable):
    """With x for h times the Poisson bracket with T, kicks b at the times c amount to sum b exp(c x) V."""
    scheme, x_values, left = nearly_integrable, np.linspace(0.8, 1.2, 5), []
    with mp.workdps(40):
        for x in map(mp.mpf, x_values if scheme.processor else 2 * x_values):
            effect = sum(b * mp.exp((c - 0.5) * x) for b, c in kicks_with_times(scheme.sequence)) / (2 * mp.sinh(x / 2))
            correction = sum(b * mp.exp(c * x) for b, c in kicks_with_times(scheme.processor))
            left.append(float(abs(x * effect - 1 - x * correction)))
    assert min(left) > 1e-15
    assert abs(exponent(x_values, left) - scheme.generalised[0]) < 0.35


def test_the_last_generalised_order_is_that_of_short_steps(nearly_integrable):
    scheme = nearly_integrable
    last = scheme.generalised[-1]
    steps = np.array([1.0, 0.8, 0.6, 0.5]) * {2: 0.1, 4: 0.25}[last]
    errors = energy_errors(0.1, scheme, steps, T=10.0).max(axis=0)
    assert errors.min() > 1e-13
    assert abs(exponent(steps, errors) - last) < 0.35


@pytest.mark.parametrize("name", ["V2_C17", "V2_gradient_C17"])
def test_a_processor_and_its_inverse_leave_nothing(name):
    scheme = look_up(name)
    problem, (q, m) = HeavyTop.random(np.random.default_rng(8), 1.0, 1.0, 12)
    there = replace(scheme, sequence=((DRIFT, 0.0),))
    q1, m1 = integrate(problem, (q, m), 0.3, 1, there)
    np.testing.assert_allclose(m1, m, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(np.abs((q1 * q).sum(axis=0)), 1.0, rtol=0.0, atol=1e-13)


# -- force gradients --------------------------------------------------------------------------------------------------


def chin_4a(strength):
    """Return scheme 4A of S. A. Chin, Phys. Lett. A 226, 344 (1997), doi:10.1016/S0375-9601(97)00003-0, kick first."""
    half = (KICK, 1.0 / 6.0), (DRIFT, 0.5)
    return Scheme("Chin4A", 4, (*half, (GradientKick(strength), 2.0 / 3.0), *half[::-1]))


#: The kick in the middle, over tau = 2/3 h, is the flow of V - h²/48 f . M^-1 f.
STRENGTH = (1.0 / 24.0) / (2.0 / 3.0) ** 2


@pytest.fixture(scope="module")
def heavy():
    return HeavyTop.random(np.random.default_rng(8), 2.0, 1.0, 12)


@pytest.mark.parametrize(("strength", "order"), [(STRENGTH, 4.0), (0.0, 2.0), (0.5 * STRENGTH, 2.0)])
def test_a_kick_first_scheme_has_order_four_by_the_force_gradient_of_its_table_alone(heavy, strength, order):
    problem, state = heavy

    def end(n):
        return integrate(problem, state, 2.0 / n, n, chin_4a(strength))[1]

    assert abs(slope(end, (20, 27, 36, 48)) - order) < 0.35
