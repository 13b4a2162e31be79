"""Laws that every flow in the registry obeys, and what it says to wrong input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import openmm_exactrb as rb
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.quaternions import rotation_matrix


def spatial(q, m):
    return np.einsum("nij,nj->ni", rotation_matrix(q), m)


def within_reach(method, inertia, m, t):
    """Return the times t (N,), shortened where the method does not take such long steps."""
    rate = np.linalg.norm(m, axis=1) / np.min(inertia, axis=1)
    with np.errstate(all="ignore"):
        longest = np.fmin(rb.ROTORS[method].largest_angle / rate, np.abs(t))
    return np.copysign(longest, t)


def test_spatial_momentum_and_norms_are_kept(bodies, method):
    inertia, q, m = bodies
    for t in (0.03, 0.7, -20.0):
        q1, m1 = rb.free_rotor(inertia, q, m, within_reach(method, inertia, m, t), method=method)
        np.testing.assert_allclose(spatial(q1, m1), spatial(q, m), rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(q1, axis=1), 1.0, rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(np.linalg.norm(m1, axis=1), np.linalg.norm(m, axis=1), rtol=2e-15)


def test_flow_back_is_the_inverse(bodies, method):
    inertia, q, m = bodies
    t = within_reach(method, inertia, m, np.geomspace(0.03, 0.7, len(m)))
    q1, m1 = rb.free_rotor(inertia, *rb.free_rotor(inertia, q, m, t, method=method), -t, method=method)
    # Roundoff of the angle turned, which the way back doubles.
    angle = 1.0 + t.max() * np.linalg.norm(m / inertia, axis=1).max()
    np.testing.assert_allclose(rotation_matrix(q1), rotation_matrix(q), rtol=0.0, atol=1e-14 * angle)
    np.testing.assert_allclose(m1, m, rtol=0.0, atol=1e-14 * angle)


def test_two_steps_are_one(bodies):
    inertia, q, m = bodies
    q1, m1 = rb.free_rotor(inertia, *rb.free_rotor(inertia, q, m, 1.3), 2.1)
    q2, m2 = rb.free_rotor(inertia, q, m, 3.4)
    np.testing.assert_allclose(rotation_matrix(q1), rotation_matrix(q2), rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(m1, m2, rtol=0.0, atol=1e-13)


def test_energy_is_kept(bodies, method):
    if not rb.ROTORS[method].keeps_energy:
        pytest.skip("kept to the order of the flow only")
    inertia, q, m = bodies
    _, m1 = rb.free_rotor(inertia, q, m, within_reach(method, inertia, m, 50.0), method=method)
    np.testing.assert_allclose((m1**2 / inertia).sum(1), (m**2 / inertia).sum(1), rtol=1e-14)


def test_measured_order_is_the_declared_one(method):
    order = rb.ROTORS[method].order
    if order is None:
        pytest.skip("exact")
    inertia, m0 = np.array([0.3, 0.5, 1.0]), np.array([0.5, 0.8, 0.3])
    rate = np.linalg.norm(m0 / inertia)
    # One step from everywhere on an orbit: the root mean square of its error has no accidental zeros.
    q, m = rb.free_rotor(inertia, [1, 0, 0, 0], m0, np.linspace(0.0, 40.0 / rate, 200))
    steps = 1.2 ** -np.arange(12.0) / rate
    errors = np.array([one_step_error(method, inertia, q, m, h) for h in steps])
    clear = errors > 3e-15
    slopes = np.diff(np.log(errors[clear])) / np.diff(np.log(steps[clear]))
    assert len(slopes) >= 5
    np.testing.assert_allclose(slopes[-4:], order + 1, rtol=0.0, atol=0.35)


def one_step_error(method, inertia, q, m, h):
    q1, m1 = rb.free_rotor(inertia, q, m, h, method=method)
    q2, m2 = rb.free_rotor(inertia, q, m, h)
    differences = np.concatenate([(rotation_matrix(q1) - rotation_matrix(q2)).ravel(), (m1 - m2).ravel()])
    return np.sqrt((differences**2).mean())


def test_inputs_are_not_modified(bodies, method):
    inertia, q, m = bodies
    before = inertia.copy(), q.copy(), m.copy()
    rb.free_rotor(inertia, q, m, 0.3, method=method)
    for now, then in zip(bodies, before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_bodies_do_not_depend_on_their_neighbours(bodies, method):
    inertia, q, m = bodies
    t = within_reach(method, inertia, m, np.geomspace(1e-6, 1e3, len(m)))
    q_all, m_all = rb.free_rotor(inertia, q, m, t, method=method)
    for k in range(len(m)):
        q_one, m_one = rb.free_rotor(inertia[k], q[k], m[k], t[k], method=method)
        np.testing.assert_allclose(q_one, q_all[k], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(m_one, m_all[k], rtol=0.0, atol=1e-12)


def test_a_body_that_is_not_finite_spoils_no_neighbour(bodies, method):
    inertia, q, m = (a.copy() for a in bodies)
    t = within_reach(method, inertia, m, 0.4)
    reference = rb.free_rotor(inertia, q, m, t, method=method)
    m[3, 1], m[7, 0], q[11, 2] = np.nan, np.inf, np.nan
    q1, m1 = rb.free_rotor(inertia, q, m, t, method=method)
    bad = [3, 7]
    assert np.isnan(m1[bad]).any(axis=1).all()
    assert np.isnan(q1[[*bad, 11]]).any(axis=1).all()
    good = np.setdiff1d(np.arange(len(m)), [*bad, 11])
    # The last bit may depend on the place in the array, where numpy's vector loops end.
    np.testing.assert_allclose(q1[good], reference[0][good], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(m1[good], reference[1][good], rtol=0.0, atol=1e-15)


def test_rotation_of_a_sphere_agrees_with_scipy(rng, method):
    m = rng.standard_normal((20, 3))
    q, _ = rb.free_rotor([1.0, 1.0, 1.0], [1.0, 0.0, 0.0, 0.0], m, 1e-3, method=method)
    expected = Rotation.from_rotvec(1e-3 * m).as_matrix()
    tolerance = 1e-15 if rb.ROTORS[method].order is None else 1e-8
    np.testing.assert_allclose(rotation_matrix(q), expected, rtol=0.0, atol=tolerance)


def test_any_number_of_bodies_is_taken(method):
    for n in (0, 1, 3):
        q, m = rb.free_rotor([1.0, 2.0, 2.5], np.tile([1.0, 0, 0, 0], (n, 1)), np.ones((n, 3)), 0.1, method=method)
        assert q.shape == (n, 4)
        assert m.shape == (n, 3)


def test_one_body_and_many_times_broadcast(method):
    q, _ = rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], np.linspace(0, 1, 5), method=method)
    assert q.shape == (5, 4)
    np.testing.assert_allclose(q[0], [1, 0, 0, 0], rtol=0.0, atol=1e-15)
    assert rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.5, method=method)[1].shape == (3,)


def test_attitudes_are_normalised():
    q, _ = rb.free_rotor([1, 2, 3], [2e200, 0, 0, 0], [1, 0.5, 0.1], 0.3)
    unit, _ = rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 0.5, 0.1], 0.3)
    np.testing.assert_allclose(q, unit, rtol=0.0, atol=1e-15)


def test_views_and_other_dtypes_are_taken(bodies):
    inertia, q, m = bodies
    expected = rb.free_rotor(inertia, q, m.astype(np.float32), 0.3)
    strided = rb.free_rotor(np.asfortranarray(inertia), np.repeat(q, 2, 0)[::2], m.astype(np.float32)[::-1][::-1], 0.3)
    for a, b in zip(expected, strided, strict=True):
        np.testing.assert_array_equal(a, b)


@given(
    inertia=st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=3),
    m=st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
    t=st.floats(-1e2, 1e2),
)
def test_any_body_keeps_its_invariants(inertia, m, t):
    inertia, m = np.array(inertia), np.array(m)
    q1, m1 = rb.free_rotor(inertia, [1, 0, 0, 0], m, t)
    norm = np.linalg.norm(m)
    angle = 1.0 + np.abs(t) * np.linalg.norm(m / inertia)
    np.testing.assert_allclose(rotation_matrix(q1) @ m1, m, rtol=0.0, atol=1e-15 * (10.0 + angle) * norm)
    # The energy has the condition of the largest term m_i²/I_i.
    energy = (m * m / inertia).sum()
    np.testing.assert_allclose(
        (m1 * m1 / inertia).sum(), energy, rtol=0.0, atol=1e-15 * (20.0 + angle) * norm**2 / inertia.min()
    )


def test_quaternion_of_a_matrix_is_the_quaternion(rng):
    q = quaternions.random(rng, 200)
    q[:8] = np.vstack([np.eye(4), -np.eye(4)])
    again = quaternions.from_matrix(quaternions.matrix(np.ascontiguousarray(q.T))).T
    sign = np.sign(np.einsum("ni,ni->n", q, again))
    np.testing.assert_allclose(again * sign[:, None], q, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(
        rotation_matrix(q), Rotation.from_quat(q, scalar_first=True).as_matrix(), rtol=0.0, atol=1e-15
    )


def test_flows_take_sums_or_say_that_they_do_not(method, rng):
    q, m = quaternions.random(rng, 5).T, rng.standard_normal((3, 5))
    flow = rb.rotors.rotor(method, [1.0, 2.0, 2.5])
    expected = flow(np.ascontiguousarray(q), m, 0.1)
    if rb.ROTORS[method].sums:
        for zeros in (0, 1):
            sums = [np.stack([a, *zeros * [np.zeros_like(a)]]) for a in (q, m)]
            for got, want in zip(flow(*sums, 0.1), expected, strict=True):
                assert got.shape == (1 + zeros, *want.shape)
                np.testing.assert_allclose(got.sum(axis=0), want, rtol=0.0, atol=1e-15)
    else:
        with pytest.raises(ValueError, match="do not agree on the number N of bodies"):
            flow(np.stack([q, 0.0 * q]), np.stack([m, 0.0 * m]), 0.1)


def test_flows_take_the_times_and_numbers_of_any_real_kind(method):
    flow = rb.rotors.rotor(method, [1.0, 2.0, 2.5])
    q, m = np.full((4, 3), 0.5), np.ones((3, 3)) * [1.0, 0.5, 0.25]
    expected = flow(q, m, 0.125)
    for t in (np.float64(0.125), np.array(0.125), np.full(1, 0.125), np.full(3, 0.125), np.float32(0.125)):
        for got, want in zip(flow(q.astype(np.float32), m.astype(np.float32), t), expected, strict=True):
            np.testing.assert_allclose(got, want, rtol=0.0, atol=1e-15)
    for wrong in ((q, m + 1.0j, 0.125), (q, m, np.full(3, 0.125j))):
        with pytest.raises(ValueError, match="must be real numbers"):
            flow(*wrong)
