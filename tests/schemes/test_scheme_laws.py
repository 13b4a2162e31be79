"""The laws of a splitting, for every scheme with the exact rotor and every rotor with one scheme, on heavy tops."""

import numpy as np
import pytest

import charts
import openmm_exactrb as rb
from benchmarks.paper.problems import HeavyTop, energy, integrate
from openmm_exactrb.mathematics import quaternions
from orders import composes_verlet, slope


@pytest.fixture(scope="module")
def tops():
    """Strongly torqued tops: the potential is as large as the kinetic energy."""
    rng = np.random.default_rng(4)
    n = 12
    u = rng.standard_normal((3, n))
    problem = HeavyTop(rng.uniform(1.0, 3.0, (3, n)), 1.0, u / np.linalg.norm(u, axis=0))
    return problem, (np.ascontiguousarray(quaternions.random(rng, n).T), rng.standard_normal((3, n)))


# Time and force evaluations by order, enough for the leading term of the error and few enough to stay above roundoff.
RUNS = {2: (1.0, 60), 4: (1.0, 75), 6: (2.0, 75), 8: (2.0, 80)}


def measured_order(problem, state, scheme, method, steps):
    """Return the slope of the error of the final momentum over the step sizes."""
    T, _ = RUNS[scheme.order]
    return slope(lambda k: integrate(problem, state, T / k, k, scheme, method)[1], steps)


def step_numbers(scheme):
    return [round(factor * RUNS[scheme.order][1] / scheme.stages) for factor in (1.0, 1.4, 2.0)]


def test_measured_order_with_the_exact_rotor_is_the_declared_one(tops, scheme):
    order = measured_order(*tops, scheme, "exact", step_numbers(scheme))
    assert abs(order - scheme.order) < 0.35


@pytest.mark.parametrize(
    "name", ["V2", "Y4_3", "Y6_7", "KL8_17", "S2_2", "PEFRL", "W4_4", "SRKN6_14a", "Chin4A", "V2_C17"]
)
def test_measured_order_with_mclachlan_reich_is_two_but_for_compositions(tops, name):
    """With some schemes of each kind: what limits the order of the others is the order of the drift."""
    scheme = rb.SCHEMES[name]
    steps = step_numbers(scheme) if composes_verlet(scheme) else (10, 14, 20)
    order = measured_order(*tops, scheme, "mclachlan_reich", steps)
    assert abs(order - (scheme.order if composes_verlet(scheme) else 2.0)) < 0.35


def test_steps_are_reversible(tops, pairing):
    scheme, method = pairing
    if not scheme.symmetric:
        pytest.skip("does not claim it")
    problem, (q, m) = tops
    q1, m1 = integrate(problem, (q, m), 0.1, 5, scheme, method)
    q2, m2 = integrate(problem, (q1, -m1), 0.1, 5, scheme, method)
    np.testing.assert_allclose(-m2, m, rtol=0.0, atol=3e-14)
    np.testing.assert_allclose(np.abs((q2 * q).sum(axis=0)), 1.0, rtol=0.0, atol=3e-15)


def test_steps_are_symplectic(tops, pairing):
    """The Jacobian of a step keeps the symplectic form, in exponential coordinates about q."""
    scheme, method = pairing
    problem, (q, m) = tops
    q0, m0 = q[:, :1], m[:, :1]

    def copies(n):
        return HeavyTop(problem.inertia[:, :1].repeat(n, axis=1), 1.0, problem.direction[:, :1].repeat(n, axis=1))

    q_end, _ = integrate(copies(1), (q0, m0), 0.2, 1, scheme, method)

    def step(x):
        n = x.shape[1]
        starts = [charts.state_at(q0, column) for column in x.T]
        state = tuple(np.concatenate(parts, axis=1) for parts in zip(*starts, strict=True))
        q1, m1 = integrate(copies(n), state, 0.2, 1, scheme, method)
        return np.stack([charts.coordinates_of(q_end, q1[:, k : k + 1], m1[:, k : k + 1]) for k in range(n)], axis=1)

    jacobian = charts.jacobian(step, np.concatenate([np.zeros(3), m0[:, 0]]))
    assert charts.symplectic_defect(jacobian) < 1e-9


def test_the_momentum_along_the_field_is_kept(tops, pairing):
    """Gravity has no torque about itself: kicks keep this momentum, and so do free rotations."""
    scheme, method = pairing
    problem, (q, m) = tops

    def along(q, m):
        field = np.einsum("ijn,in->jn", quaternions.matrix(q), problem.direction)
        return (field * m).sum(axis=0)

    np.testing.assert_allclose(
        along(*integrate(problem, (q, m), 0.1, 5, scheme, method)), along(q, m), rtol=0.0, atol=5e-14
    )


def test_energy_error_has_no_trend(tops):
    problem, state = tops
    scheme = rb.SCHEMES["SRKN4_6b"]
    start = energy(problem, state)
    halves = []
    for _ in range(2):
        largest = 0.0
        for _ in range(100):
            state = integrate(problem, state, 0.25, 2, scheme)
            largest = np.maximum(largest, np.abs(energy(problem, state) - start))
        halves.append(np.median(largest))
    assert halves[1] < 2.0 * halves[0]
