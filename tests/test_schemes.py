"""Tables are closed and symmetric, and every scheme has the order that it declares."""

from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp
from openmm_exactrb.propagate import compose

import charts
import openmm_exactrb as rb
from openmm_exactrb import quaternions
from openmm_exactrb.problems import HeavyTop, energy, integrate
from openmm_exactrb.schemes import FORCE_GRADIENT, saba, sbab, stability_limit, symmetric
from openmm_exactrb.schemes import scheme as look_up


def test_coefficients_sum_to_one_and_are_palindromes(scheme):
    for table in (scheme.a, scheme.b):
        assert table == table[::-1]
        assert abs(sum(table) - 1.0) < 1e-15
    kicks = sum(flow == "kick" for flow, _ in scheme.sequence)
    assert scheme.stages == kicks - (scheme.first == "kick")


@pytest.mark.parametrize(
    ("name", "stages"), [("V2", 1), ("V2_drift", 1), ("S6_10", 10), ("SRKN4_6b", 6), ("SRKN6_14a", 14)]
)
def test_stages_are_those_of_the_paper(name, stages):
    assert rb.SCHEMES[name].stages == stages


def test_no_force_is_evaluated_twice(scheme):
    kicks = []
    advance = compose(scheme, lambda state, tau: state, lambda state, tau: kicks.append(tau) or state)
    advance(None, 0.1, 7)
    assert len(kicks) == 7 * scheme.stages + (scheme.first == "kick") + scheme.processing
    assert abs(sum(kicks) - 0.7) < 1e-14


def test_no_step_does_nothing(scheme):
    assert compose(scheme, None, None)("state", 0.1, 0) == "state"


def test_a_table_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="leave 1 free, 2 are given"):
        symmetric("bad", order=4, stages=3, first="kick", a=(0.1, 0.2), b=(0.1,))
    with pytest.raises(ValueError, match="not finite"):
        symmetric("bad", order=4, stages=3, first="kick", a=(float("nan"),), b=(0.1,))


@pytest.fixture(scope="module")
def tops():
    """Strongly torqued tops: the potential is as large as the kinetic energy."""
    rng = np.random.default_rng(4)
    n = 12
    u = rng.standard_normal((3, n))
    problem = HeavyTop(rng.uniform(1.0, 3.0, (3, n)), 1.0, u / np.linalg.norm(u, axis=0))
    return problem, (np.ascontiguousarray(quaternions.random(rng, n).T), rng.standard_normal((3, n)))


def measured_order(problem, state, scheme, method, steps, T=4.0):
    """Slope of the error of the final momentum, by halving, over all the step sizes."""
    errors = []
    for n in steps:
        coarse, fine = (integrate(problem, state, T / k, k, scheme, method)[1] for k in (n, 2 * n))
        errors.append(np.median(np.abs(coarse - fine).max(axis=0)))
    assert min(errors) > 1e-13, "the errors reached roundoff"
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0]


# Force evaluations by order, enough for the leading term of the error and few enough to stay above roundoff.
EVALUATIONS = {2: 240, 4: 300, 6: 150, 8: 160}


def step_numbers(scheme):
    return [round(EVALUATIONS[scheme.order] / scheme.stages * factor) for factor in (1.0, 1.35, 1.8, 2.4)]


def test_measured_order_with_the_exact_rotor_is_the_declared_one(tops, scheme):
    order = measured_order(*tops, scheme, "exact", step_numbers(scheme))
    assert abs(order - scheme.order) < 0.35


def test_measured_order_with_mclachlan_reich_is_two_but_for_compositions(tops, scheme):
    steps = step_numbers(scheme) if scheme.composes_verlet else (50, 70, 100, 140)
    order = measured_order(*tops, scheme, "mclachlan_reich", steps)
    assert abs(order - (scheme.order if scheme.composes_verlet else 2.0)) < 0.35


def test_steps_are_reversible(tops, pairing):
    scheme, method = pairing
    if not scheme.symmetric:
        pytest.skip("does not claim it")
    problem, (q, m) = tops
    q1, m1 = integrate(problem, (q, m), 0.1, 50, scheme, method)
    q2, m2 = integrate(problem, (q1, -m1), 0.1, 50, scheme, method)
    np.testing.assert_allclose(-m2, m, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(np.abs((q2 * q).sum(axis=0)), 1.0, rtol=0.0, atol=1e-12)


def test_steps_are_symplectic(tops, pairing):
    """The Jacobian of a step keeps the symplectic form, in exponential coordinates about q."""
    scheme, method = pairing
    problem, (q, m) = tops
    problem = HeavyTop(problem.inertia[:, :1], 1.0, problem.direction[:, :1])
    q0, m0 = q[:, :1], m[:, :1]

    q_end, _ = integrate(problem, (q0, m0), 0.2, 1, scheme, method)

    def step(x):
        return charts.coordinates_of(q_end, *integrate(problem, charts.state_at(q0, x), 0.2, 1, scheme, method))

    jacobian = charts.jacobian(step, np.concatenate([np.zeros(3), m0[:, 0]]))
    assert charts.symplectic_defect(jacobian) < 1e-9


def test_energy_error_has_no_trend(tops):
    problem, state = tops
    scheme = rb.SCHEMES["SRKN4_6b"]
    start = energy(problem, state)
    halves = []
    for _ in range(2):
        largest = 0.0
        for _ in range(200):
            state = integrate(problem, state, 0.25, 2, scheme)
            largest = np.maximum(largest, np.abs(energy(problem, state) - start))
        halves.append(np.median(largest))
    assert halves[1] < 2.0 * halves[0]


@pytest.mark.parametrize(
    ("name", "limit"),
    # Published: 2; McLachlan (1995); Blanes, Casas and Sanz-Serna (2014), table 2.
    [("V2", 2.0), ("V2_drift", 2.0), ("S2_2", 2.55), ("S2_3", 4.66), ("S2_4", 5.35)],
)
def test_stability_limits_are_the_published_ones(name, limit):
    assert stability_limit(rb.SCHEMES[name]) == pytest.approx(limit, abs=0.005)


def test_a_harmonic_oscillator_is_bounded_up_to_the_limit_and_not_beyond(scheme):
    limit = stability_limit(scheme)

    def largest(h, n=3000):
        advance = compose(scheme, lambda s, tau: (s[0] + tau * s[1], s[1]), lambda s, tau: (s[0], s[1] - tau * s[0]))
        state, largest = (1.0, 0.3), 0.0
        for _ in range(n):
            state = advance(state, h)
            largest = max(largest, abs(state[0]))
        return largest

    assert largest(0.98 * limit) < 100.0
    assert largest(limit + 3e-4, 40_000) > 1e3


# -- schemes for a small V ------------------------------------------------------------------------------------------


@pytest.fixture(params=[name for name, scheme in [*rb.SCHEMES.items(), *FORCE_GRADIENT.items()] if scheme.generalised])
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
    assert abs(np.polyfit(np.log(STEPS[first]), np.log(linear), 1)[0] - first) < 0.5


def kicks_with_times(flows):
    time, kicks = mp.mpf(0), []
    for flow, coefficient in flows:
        if flow == "drift":
            time += mp.mpf(coefficient)
        elif flow == "kick":
            kicks.append((mp.mpf(coefficient), time))
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
    assert abs(np.polyfit(np.log(x_values), np.log(left), 1)[0] - scheme.generalised[0]) < 0.35


def test_the_last_generalised_order_is_that_of_short_steps(nearly_integrable):
    scheme = nearly_integrable
    last = scheme.generalised[-1]
    steps = np.array([1.0, 0.8, 0.6, 0.5]) * {2: 0.1, 4: 0.25}[last]
    errors = energy_errors(0.1, scheme, steps).max(axis=0)
    assert errors.min() > 1e-13
    assert abs(np.polyfit(np.log(steps), np.log(errors), 1)[0] - last) < 0.35


def test_nodes_are_generated_for_any_number():
    for n in range(1, 30):
        for name in (f"SABA_{n}", f"SBAB_{n}"):
            scheme = look_up(name)
            times = np.cumsum([c if flow == "drift" else 0.0 for flow, c in scheme.sequence])
            kicks = np.array([c if flow == "kick" else 0.0 for flow, c in scheme.sequence])
            assert scheme.stages == n
            for power in range(2 * n):
                np.testing.assert_allclose(kicks @ times**power, 1.0 / (power + 1), rtol=1e-12)
    with pytest.raises(ValueError, match="1 or more"):
        saba(0)
    with pytest.raises(ValueError, match="1 or more"):
        sbab(0)


def test_a_processor_and_its_inverse_leave_nothing(tops, nearly_integrable):
    if not nearly_integrable.processor:
        pytest.skip("has no processor")
    problem, (q, m) = tops
    there = replace(nearly_integrable, a=(0.0, 0.0), b=(0.0,), c=())
    q1, m1 = integrate(problem, (q, m), 0.3, 1, there)
    np.testing.assert_allclose(m1, m, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(np.abs((q1 * q).sum(axis=0)), 1.0, rtol=0.0, atol=1e-13)


def test_force_gradients_are_asked_for():
    scheme = look_up("V2_gradient_C17")
    with pytest.raises(ValueError, match="choose another scheme"):
        compose(scheme, lambda state, tau: state, lambda state, tau: state)
    with pytest.raises(ValueError, match="choose another one"):
        rb.ExactRigidBodyIntegrator(0.1, scheme=scheme)
