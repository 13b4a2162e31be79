"""The paper's formulations of the exact flow: errors against 30 digits, and what they do where they are singular."""

import itertools

import mpmath as mp
import numpy as np
import pytest

import openmm_exactrb as rb
import oracle
from openmm_exactrb.mathematics import elliptic, quaternions
from openmm_exactrb.rotors import euler, rotation

EXACT = ["rotation", "quaternion_a", "quaternion_b", "quaternion_c"]
GAUSS = [f"{name}_gauss{order}" for name in ("rotation", "quaternion") for order in (6, 8, 10)]
STEPS = {"short": (1e-6, 0.3), "long": (0.3, 1e2)}


def random_steps(regime, steps, n):
    """Return inertia, q, m, t and the angles h omega of random bodies and steps."""
    inertia, m = oracle.random_bodies(regime, n, seed=3)
    rng = np.random.default_rng(n)
    rate = np.exp(rng.uniform(*np.log(STEPS[steps]), n))
    omega = np.linalg.norm(m / inertia, axis=1)
    t = rng.choice([-1.0, 1.0], n) * rate / np.where(omega > 0.0, omega, 1.0)
    return inertia, quaternions.random(rng, n), m, t, rate


def condition(inertia, m, rate):
    """Return by how much the formulas of the paper enlarge roundoff.

    The angle is b/lambda times the difference of two integrals of the third kind, each of which grows as the quarter
    period, log(16/kc²)/2. The distance from the separatrix is a difference, whose relative error shifts the phase
    as soon as the momentum has gone past the middle axis, and the more the longer it goes on.
    """
    out = np.ones(len(m))
    order = np.argsort(inertia, axis=1)
    inertia, m = np.take_along_axis(inertia, order, 1).T, np.take_along_axis(m, order, 1).T
    covered = euler.is_regular(inertia, m)
    I1, I2, I3 = inertia = inertia[:, covered]
    x = np.abs(m[:, covered] / np.linalg.norm(m[:, covered], axis=0))
    orbit = euler.solve(inertia, x, np.zeros(x.shape[1]))
    period = np.log(16.0 / orbit.kc2)
    first, third = x[0] ** 2 * (I2 - I1) / I1, x[2] ** 2 * (I3 - I2) / I3
    cancellation = (first + third) / np.abs(first - third)
    shift = np.where(rate[covered] > 1.0, rate[covered] * cancellation, 0.0)
    out[covered] += (1.0 / I1 - 1.0 / I3) / orbit.rate * period + shift
    return out


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("regime", oracle.REGIMES)
def test_error_is_roundoff_times_the_condition(regime, steps, pytestconfig):
    inertia, q, m, t, rate = random_steps(regime, steps, 30 if pytestconfig.getoption("--validate") else 4)
    reference = [oracle.free_rotor(*body) for body in zip(inertia, q, m, t, strict=True)]
    allowed = 1e-16 * (20.0 + 20.0 * rate) * condition(inertia, m, rate)
    for method in EXACT:
        q1, m1 = rb.free_rotor(inertia, q, m, t, method=method)
        errors = np.array([max(oracle.errors(*body)) for body in zip(reference, m, q1, m1, strict=True)])
        assert (errors <= allowed).all(), f"{method}: {np.max(errors / allowed):.2f} of the allowed error"


def test_a_step_of_five_as_in_table_1():
    inertia, m = oracle.random_bodies("generic", 40, seed=5)
    reference = [oracle.free_rotor(i, [1, 0, 0, 0], v, 5.0) for i, v in zip(inertia, m, strict=True)]
    for method in EXACT:
        q1, m1 = rb.free_rotor(inertia, [1, 0, 0, 0], m, 5.0, method=method)
        errors = [max(oracle.errors(*body)) for body in zip(reference, m, q1, m1, strict=True)]
        assert np.median(errors) < 2e-15, method


@pytest.mark.parametrize(
    "regime",
    [
        *("I1 = I2", "I2 = I3", "spherical", "thin", "resting"),
        *("on axis 1", "on axis 2", "on axis 3", "on the separatrix"),
    ],
)
def test_singular_bodies_take_the_exact_flow(regime):
    inertia, q, m, t, _ = random_steps(regime, "long", 20)
    # Among bodies that are not singular, so that both are there.
    others = random_steps("generic", "long", 20)
    mixed = [np.concatenate([a, b]) for a, b in zip((inertia, q, m, t), others, strict=False)]
    q2, m2 = rb.free_rotor(inertia, q, m, t, method="exact_numpy")
    for method in EXACT + GAUSS:
        q1, m1 = rb.free_rotor(*mixed, method=method)
        np.testing.assert_allclose(q1[:20], q2, rtol=0.0, atol=1e-15, err_msg=method)
        np.testing.assert_allclose(m1[:20], m2, rtol=0.0, atol=1e-15, err_msg=method)
        assert np.isfinite(q1).all(), method
        assert np.isfinite(m1).all(), method


@pytest.mark.parametrize("distance", [1e-15, 1e-14, 1e-13, 1e-11])
def test_no_body_becomes_nan_near_the_edge_of_the_domain(distance, rng):
    n = 50
    inertia, m = oracle.random_bodies("generic", n)
    q = quaternions.random(rng, n)
    symmetric = inertia.copy()
    symmetric[:, 1] = symmetric[:, 0] * (1.0 + distance)
    on_axis = m * distance
    on_axis[np.arange(n), rng.integers(0, 3, n)] = 1.0
    small = m.copy()
    small[np.arange(n), rng.integers(0, 3, n)] *= distance
    bodies = [(symmetric, m), (inertia, on_axis), (symmetric, on_axis), (inertia, small)]
    for method, (moments, momenta) in itertools.product(EXACT + GAUSS, bodies):
        for t in (0.0, 0.01, 3.0, -200.0):
            q1, m1 = rb.free_rotor(moments, q, momenta, t, method=method)
            assert np.isfinite(q1).all(), method
            assert np.isfinite(m1).all(), method
            np.testing.assert_allclose(np.linalg.norm(m1, axis=1), np.linalg.norm(momenta, axis=1), rtol=2e-15)


@pytest.mark.parametrize("method", EXACT + GAUSS)
def test_momenta_of_any_size_are_solved(method):
    inertia, m = oracle.random_bodies("generic", 20, seed=6)
    q_unit, m_unit = rb.free_rotor(inertia, [1, 0, 0, 0], m, 0.05)
    expected = quaternions.rotation_matrix(q_unit)
    tolerance = 1e-8 if method in GAUSS else 1e-14  # that of the rule of three points
    for scale in (1e-300, 1e-160, 1e-60, 1e60, 1e200):
        q, m1 = rb.free_rotor(inertia, [1, 0, 0, 0], m * scale, 0.05 / scale, method=method)
        np.testing.assert_allclose(m1 / scale, m_unit, rtol=0.0, atol=3e-15)
        np.testing.assert_allclose(quaternions.rotation_matrix(q), expected, rtol=0.0, atol=tolerance)


def test_more_points_are_better():
    inertia, q, m, _, _ = random_steps("generic", "short", 200)
    t = 0.5 / np.linalg.norm(m / inertia, axis=1)
    exact = quaternions.rotation_matrix(rb.free_rotor(inertia, q, m, t)[0])
    for family in ("rotation", "quaternion"):
        medians = []
        for order in (6, 8, 10):
            q1, _ = rb.free_rotor(inertia, q, m, t, method=f"{family}_gauss{order}")
            medians.append(np.median(np.abs(quaternions.rotation_matrix(q1) - exact).max(axis=(1, 2))))
        assert medians[0] > 10.0 * medians[1] > 10.0 * medians[2]


@pytest.mark.parametrize("nc", [0.01, 0.3, 1.0, 40.0])
@pytest.mark.parametrize("kc2", [1e-4, 0.2, 1.0])
def test_integral_of_the_third_kind(kc2, nc):
    v = np.array([-20.0, -1.3, -1e-3, 0.0, 0.4, 2.0, 9.0])
    got = elliptic.third_kind_legendre(*elliptic.jacobi(v, np.full_like(v, kc2)), kc2, nc)
    for value, argument in zip(got, v, strict=True):
        expected = legendre(argument, kc2, nc)
        # Roundoff of the value, and of the argument where the integrand is as large as 1/nc.
        assert abs(value - expected) <= 1e-15 * (1.0 + abs(expected) + abs(argument) * (1.0 + 1.0 / nc))


@mp.workdps(30)
def legendre(v, kc2, nc):
    """Return Pi(n; am v, k) - v by mpmath."""
    n, k2, v = 1 - mp.mpf(nc), 1 - mp.mpf(kc2), mp.mpf(v)
    turns = mp.nint(v / (2 * mp.ellipk(k2)))
    rest = v - 2 * turns * mp.ellipk(k2)
    sn, cn = (mp.ellipfun(name, rest, m=k2) for name in ("sn", "cn"))
    return mp.ellippi(n, mp.atan2(sn, cn) + turns * mp.pi, k2) - v


@pytest.mark.parametrize("difference", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_frame_of_a_body_that_is_all_but_symmetric(axis, difference):
    inertia, x = np.roll([0.7, 0.7 * (1.0 + difference), 0.9], axis), np.roll([0.9, 1e-4, 1e-4 * difference], axis)
    v, _, _ = rotation.frame(inertia[:, None], x[:, None])
    with mp.workdps(40):
        momentum, moments = ([mp.mpf(float(number)) for number in numbers] for numbers in (x, inertia))
        omega = [a / b for a, b in zip(momentum, moments, strict=True)]
        slope = [momentum[j] * omega[k] - momentum[k] * omega[j] for j, k in ((1, 2), (2, 0), (0, 1))]
        size = mp.sqrt(sum(s * s for s in slope))
        for got, s in zip(v[:, 0], slope, strict=True):
            assert abs(got - s / size) < 2e-15


def carlson(x, y, p):
    """Return R_J(x, y, 1, p) by mpmath."""
    with mp.workdps(60):
        return mp.elliprj(mp.mpf(x), mp.mpf(y), 1, mp.mpf(p))


def test_carlsons_integral_of_large_p():
    """At every size of p, about those where asymptotic expansions begin too."""
    rng = np.random.default_rng(7)
    p = np.concatenate([10.0 ** np.linspace(0.0, 20.0, 81), elliptic.LARGE_P * (1.0 + np.array([-1e-9, 1e-9]))])
    x, y = rng.random((2, len(p)))
    x[::4] = 0.0
    y[::5] = 1e-30
    got = elliptic.carlson_rj(x, y, p)
    for value, *arguments in zip(got, x, y, p, strict=True):
        assert abs(value / carlson(*arguments) - 1) < 2e-15


@pytest.mark.parametrize("p", [1.0, 1.5, 1e10, 1e13])
def test_carlsons_integral_beside_the_separatrix(p):
    x = np.array([1e-310, 1e-300, 1e-170, 1e-160, 1e-120, 1e-60, 0.0, 1e-300, 1e-300, 1e-100])
    y = np.array([1e-310, 1e-300, 1e-170, 1e-160, 1e-120, 1e-60, 1e-300, 1e-50, 0.5, 1e-80])
    got = elliptic.carlson_rj(x, y, np.full(10, p))
    for value, *arguments in zip(got, x, y, strict=True):
        assert abs(value / carlson(*arguments, p) - 1) < 2e-15


@pytest.mark.parametrize("method", ["exact_numpy", "exact"])
def test_a_body_that_leaves_the_middle_axis_after_hundreds_of_turns(method):
    body = [1.0, 2.0, 3.5], [1.0, 0.0, 0.0, 0.0], [1e-120, 1.0, 0.7e-120], 900.0
    q1, m1 = rb.free_rotor(*body, method=method)
    # Turned by 450 rad about the axis before it goes to the other end.
    assert max(oracle.errors(oracle.free_rotor(*body), body[2], q1, m1)) < 1e-12
