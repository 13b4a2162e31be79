"""The exact flow is exact: errors against 30 digits, in every regime, for steps of any size."""

import numpy as np
import pytest

import openmm_exactrb as rb
import oracle
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.compensated import exactly

# h*omega from 1e-8 to 0.3 and from 0.3 to 1e4.
STEPS = {"short": (1e-8, 0.3), "long": (0.3, 1e4)}


def allowed(rate):
    """Roundoff of a few operations for short steps, of the angle itself for long ones."""
    return np.where(rate <= 0.3, 2e-15, 1e-16 * (20.0 + 20.0 * rate))


TWINS = ["exact_numpy", "exact"]


def largest_errors(inertia, q, m, t):
    """Return the errors of both twins, (2, n): the reference takes longer than all else."""
    ends = [rb.free_rotor(inertia, q, m, t, method=method) for method in TWINS]
    reference = [oracle.free_rotor(*body) for body in zip(inertia, q, m, t, strict=True)]
    return np.array([[max(oracle.errors(*body)) for body in zip(reference, m, q1, m1, strict=True)] for q1, m1 in ends])


@pytest.fixture(params=TWINS)
def twin(request):
    return request.param


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("regime", oracle.REGIMES)
def test_error_is_roundoff(regime, steps, pytestconfig):
    n = 100 if pytestconfig.getoption("--validate") else 4
    inertia, m = oracle.random_bodies(regime, n)
    rng = np.random.default_rng(n)
    rate = np.exp(rng.uniform(*np.log(STEPS[steps]), n))
    omega = np.linalg.norm(m / inertia, axis=1)
    t = rng.choice([-1.0, 1.0], n) * rate / np.where(omega > 0.0, omega, 1.0)
    rate = np.abs(t) * omega
    errors = largest_errors(inertia, quaternions.random(rng, n), m, t)
    assert (errors <= allowed(rate)).all(), f"largest error {np.max(errors / allowed(rate)):.2f} of the allowed one"


def test_one_step_of_five_has_an_error_below_2e_14():
    inertia, m = oracle.random_bodies("generic", 40, seed=5)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (40, 1))
    assert largest_errors(inertia, q, m, np.full(40, 5.0)).max() < 2e-14


def test_momenta_of_any_size_are_solved(twin):
    inertia, m = oracle.random_bodies("generic", 20, seed=6)
    q_unit, m_unit = rb.free_rotor(inertia, [1, 0, 0, 0], m, 0.2, method=twin)
    for scale in (1e-300, 1e-160, 1e-80, 1e80, 1e150):
        q, m1 = rb.free_rotor(inertia, [1, 0, 0, 0], m * scale, 0.2 / scale, method=twin)
        np.testing.assert_allclose(m1 / scale, m_unit, rtol=0.0, atol=3e-15)
        np.testing.assert_allclose(q, q_unit, rtol=0.0, atol=3e-15)


def test_a_momentum_beside_an_axis_in_denormal_numbers_turns_about_it(twin):
    inertia = [0.5, 0.8, 1.0]
    for axis in range(3):
        m = np.full(3, 1e-310)
        m[axis] = 1.0
        q, m1 = rb.free_rotor(inertia, [1, 0, 0, 0], m, 0.7, method=twin)
        angle = 0.7 / inertia[axis]
        expected = np.zeros(4)
        expected[0], expected[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
        np.testing.assert_allclose(q, expected, rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(m1, np.eye(3)[axis], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("parts", [1, 2])
def test_steps_of_more_than_half_a_turn_keep_the_norm(twin, parts):
    """In a step that is short for the elliptic functions, a body that is nearly a sphere may turn by any angle."""
    flow = rb.rotors.rotor_of_sums(twin, [1.0, 1.001, 1.002])
    q, m = (exactly(np.array(x)[:, None])[:parts] for x in ([0.5, 0.5, -0.5, 0.5], [0.3, -0.5, 0.8]))
    spatial = quaternions.rotation_matrix(q[0].T)[0] @ m[0, :, 0]
    for _ in range(300):
        q, m = flow(q, m, 4.5)
    assert abs(np.linalg.norm(q[0]) - 1.0) < 1e-15
    np.testing.assert_allclose(quaternions.rotation_matrix(q[0].T)[0] @ m[0, :, 0], spatial, rtol=0.0, atol=1e-14)


def drift_of_invariants(n_steps, method, n=32):
    """Return norm(m), kinetic energy, spatial momentum and norm(q) along a run, relative to the start."""
    rng = np.random.default_rng(11)
    inertia, m = oracle.random_bodies("generic", n, seed=11)
    q = quaternions.random(rng, n)
    flow = rb.rotors.rotor(method, inertia)
    q, m = np.ascontiguousarray(q.T), np.ascontiguousarray(m.T)
    records = []
    for block in range(10):
        for _ in range(n_steps // 10):
            q, m = flow(q, m, 0.05)
        spatial = np.einsum("ijn,jn->in", quaternions.matrix(q), m)
        records.append([(m * m).sum(0) ** 0.5, (m * m / inertia.T).sum(0), *spatial, (q * q).sum(0) ** 0.5])
        if block == 0:
            start = records[0]
    scale = np.stack([start[0], start[1], *3 * [start[0]], start[5]])
    return (np.array(records) - start) / scale


def assert_random_walk(n_steps, method):
    drift = drift_of_invariants(n_steps, method)[-1]
    walk = 2.2e-16 * np.sqrt(n_steps)
    assert np.abs(drift[-1]).max() < 1e-15, "norm of q"
    # Each body walks with up to a few roundings a step; all of them together have no common direction.
    assert np.abs(drift[:-1]).max() < 10.0 * walk
    assert np.abs(drift[:-1].mean(axis=1)).max() < 10.0 * walk / np.sqrt(drift.shape[1])


def test_invariants_walk_randomly_over_many_steps(twin):
    assert_random_walk(1000, twin)


@pytest.mark.validate
@pytest.mark.parametrize(("method", "steps"), [("exact_numpy", 10_000), ("exact", 100_000)])
def test_invariants_walk_randomly_over_more_steps(method, steps):
    assert_random_walk(steps, method)


@pytest.mark.validate
def test_invariants_walk_randomly_over_a_million_steps(twin):
    assert_random_walk(1_000_000, twin)
