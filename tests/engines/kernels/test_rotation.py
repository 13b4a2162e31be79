"""The kernel of the free rigid body, function by function: errors against mpmath in units of roundoff, U.

A rotation by an angle A changes a body by at most A, and each of the fifty or so operations for this change, of which
none cancels, errs by a rounding of it. Their independent errors add up to 7 U A or so; twice as much is allowed.
"""

import re

import mpmath as mp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from kernel_functions import U, pairs, sum_of

import oracle
from openmm_exactrb.library import compilation
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.elliptic import RULES
from openmm_exactrb.rotors.exact import constants

ROUNDINGS = 16.0
#: Regimes whose motion depends on the momentum exponentially, until it has gone past the middle axis.
UNSTABLE = [regime for regime in oracle.REGIMES if "separatrix" in regime or "of axis 2" in regime]
#: Motion of no momentum is none, and is tested apart.
MOVING = [regime for regime in oracle.REGIMES if regime != "resting"]
UNIT = st.floats(0.0, 1.0)


@pytest.fixture(autouse=True)
def _forty_digits():
    with mp.workdps(40):
        yield


def bodies(regime, angles, seed=0):
    """Return moments, states (q, m) on a grid of two doubles, and times t in which bodies turn by angles |m| t/I1."""
    n, rng = len(angles), np.random.default_rng(seed)
    inertia, m = oracle.random_bodies(regime, n, seed)
    order = np.argsort(inertia, axis=1)
    inertia, m = np.take_along_axis(inertia, order, 1), np.take_along_axis(m, order, 1)
    q = quaternions.random(rng, n)
    t = rng.choice([-1.0, 1.0], n) * angles * inertia[:, 0] / np.linalg.norm(m, axis=1)
    return inertia, [pairs(a, np.spacing(a) * rng.uniform(-0.5, 0.5, a.shape)) for a in (q, m)], t


def rotated(kernels, inertia, state, t):
    """Return states (q, m) after times t."""
    q, m = (a.copy() for a in state)
    kernels("rotate", len(t), t, np.ascontiguousarray(constants(inertia.T)[:4].T), q, m)
    return q, m


def of_body(state, i):
    """Return the numbers of a body in mpf."""
    return [[sum_of(pair) for pair in a[i]] for a in state]


def largest_error(inertia, start, end, t):
    """Return the largest errors of the bodies, relative to |m| and to 1."""
    each = range(len(t))
    starts, ends = ([of_body(state, i) for i in each] for state in (start, end))
    references = [oracle.free_rotor(inertia[i], *starts[i], t[i]) for i in each]
    return np.array([max(oracle.errors(references[i], starts[i][1], *ends[i])) for i in each])


@pytest.mark.parametrize("regime", MOVING)
def test_a_rotation_errs_by_roundings_of_its_angle(kernels, regime):
    angles = np.array([1e-8, 1e-5, 0.01, 0.1, 0.3, 0.3, 1.0, 3.0])
    inertia, start, t = bodies(regime, angles)
    errors = largest_error(inertia, start, rotated(kernels, inertia, start, t), t)
    assert (errors <= ROUNDINGS * U * angles).all(), errors / (U * angles)


@pytest.mark.parametrize("regime", MOVING)
def test_a_body_moves_independently_of_the_bodies_beside_it(kernels, regime):
    """Bodies with short steps and with long ones, or at rest, in one group: the bits of each alone."""
    n = 240
    inertia, (q, m), _ = bodies(regime, np.ones(n), seed=3)
    m[::31] = 0.0
    own = np.ascontiguousarray(constants(inertia.T)[:4].T)
    angles = np.abs(own[:, 0]) * np.linalg.norm(m[..., 0], axis=1)
    for largest in np.quantile(angles, [0.5, 0.95]):
        t = 0.3 / largest if largest else 1.0  # the longest short step of half of the bodies, or of most
        alone = [a.copy() for a in (q, m)]
        kernels("rotate", n, np.full(n, t), own, *alone)
        assert (alone[0] != q).any()
        for together in range(1, kernels.at_once + 1):
            beside = [a.copy() for a in (q, m)]
            kernels("drift", n, together, float(t), own, *beside)
            assert all((a == b).all() for a, b in zip(alone, beside, strict=True)), together


@pytest.mark.parametrize("regime", [regime for regime in MOVING if regime not in UNSTABLE])
def test_many_turns_err_by_roundings_of_their_angle(kernels, regime):
    angles = np.array([30.0, 100.0, 300.0, 1000.0])
    inertia, start, t = bodies(regime, angles, seed=1)
    errors = largest_error(inertia, start, rotated(kernels, inertia, start, t), t)
    assert (errors <= ROUNDINGS * U * angles).all(), errors / (U * angles)


@pytest.mark.parametrize("regime", MOVING)
def test_many_turns_keep_what_is_kept(kernels, regime):
    """Beside the separatrix too, where the end depends on the start exponentially."""
    angles = np.geomspace(0.01, 2000.0, 12)
    inertia, start, t = bodies(regime, angles, seed=2)
    end = rotated(kernels, inertia, start, t)
    for i, angle in enumerate(angles):
        kept = []
        for q, m in (of_body(start, i), of_body(end, i)):
            square, Q = mp.fdot(m, m), oracle.rotation_matrix(q, normalise=True)
            energy = mp.fsum(x * x / moment for x, moment in zip(m, inertia[i].tolist(), strict=True))
            kept.append([*(Q * mp.matrix(m) / mp.sqrt(square)), square, energy])
        for before, after in zip(*kept, strict=True):
            assert abs(after - before) <= ROUNDINGS * U * angle * max(1, abs(before)), (angle, before)
        # The norm is renewed in each short step, so that its error does not grow.
        assert abs(mp.fdot(q, q) - 1) <= ROUNDINGS * U


def test_rotations_by_more_than_half_a_turn_keep_their_norm(kernels):
    """A short step may turn a body that is nearly a sphere by any angle."""
    inertia = np.array([[1.0, 1.0 + 1e-3, 1.0 + 2e-3]])
    state = pairs(np.full((1, 4), 0.5)), pairs(np.array([[0.3, -0.5, 0.8]]))
    for _ in range(300):
        state = rotated(kernels, inertia, state, np.array([4.5]))
    q, _ = of_body(state, 0)
    assert abs(mp.fdot(q, q) - 1) <= ROUNDINGS * U


def test_bodies_at_rest_stay_and_bodies_that_are_too_fast_become_nan(kernels):
    inertia, start, _ = bodies("generic", np.ones(3))
    start[1][0] = 0.0
    q, m = rotated(kernels, inertia, start, np.array([1.0, 0.0, 1e6]))
    for end, begin in ((q, start[0]), (m, start[1])):
        np.testing.assert_array_equal(end[:2], begin[:2])
        assert np.isnan(end[2, :3, 0]).all()


@given(v=st.tuples(*[st.floats(-1.0, 1.0)] * 3), size=st.sampled_from([0.0, 1e-12, 1e-8, 1e-3, 1.0, 3.0, 20.0]))
def test_a_turn_by_a_vector_is_that_of_half_its_angle(kernels, v, size):
    vector = size * np.array([v])
    q = pairs(np.full((1, 4), 0.5))
    kernels("turn_by", 1, q, vector)
    with mp.workdps(40):
        v = [mp.mpf(x) for x in vector[0].tolist()]
        angle = mp.norm(v)
        turn = [mp.cos(angle / 2), *(x * mp.sinc(angle / 2) / 2 for x in v)]
        signs = [(1, -1, -1, -1), (1, 1, 1, -1), (1, -1, 1, 1), (1, 1, -1, 1)]  # of 2q times the turn
        order = [(0, 1, 2, 3), (1, 0, 3, 2), (2, 3, 0, 1), (3, 2, 1, 0)]
        for got, sign, places in zip(q[0], signs, order, strict=True):
            expected = sum(s * turn[k] for s, k in zip(sign, places, strict=True)) / 2
            assert abs(sum_of(got) - expected) <= 4.0 * U * min(angle, 1) + U * angle


# -- the functions of a short step ------------------------------------------------------------------------------------


@st.composite
def arguments(draw):
    """Return x, z and b of a rotation: rho and 1 - rho are those of the moments, and the rest is on a sphere."""
    rho = draw(UNIT)
    y = np.array([draw(st.floats(-1.0, 1.0)) for _ in range(3)])
    y *= y / max(y @ y, 1e-300)
    sigma, transverse = 1.0 - rho, y[0] + (1.0 - rho) * y[1]
    return sigma * (y[2] + rho * y[1]), rho * transverse, sigma * transverse


def evaluated(kernels, name, arguments, results):
    """Return the results of a function of numbers."""
    out = [np.empty(1) for _ in range(results)]
    kernels(name, 1, *(np.array([x]) for x in arguments), *out)
    return [float(x[0]) for x in out]


def within(value, expected, roundings):
    return abs(value - expected) <= roundings * U * abs(expected)


@given(s=st.floats(-0.3, 0.3), xzb=arguments())
@example(s=0.3, xzb=(1.0, 0.0, 0.0))
@example(s=0.3, xzb=(0.0, 1.0, 0.0))
@example(s=1e-300, xzb=(0.5, 0.5, 0.5))
def test_short_elliptic_functions_have_all_digits(kernels, s, xzb):
    """The solution of dw/ds = sqrt((1-x w²)(1-z w²)) is sn/sqrt(k) of the larger k of x and z."""
    x, z, _ = xzb
    w, cn_less, dn_less = evaluated(kernels, "jacobi_short", (s, x, z), 3)
    with mp.workdps(40):
        x, z, s = map(mp.mpf, (x, z, s))
        root = mp.sqrt(max(x, z))
        moves = root and abs(s) > 1e-9  # otherwise w is s to 18 places
        expected = mp.ellipfun("sn", s * root, m=min(x, z) / max(x, z)) / root if moves else s
        assert within(w, expected, 8.0)
        for less, k in ((cn_less, x), (dn_less, z)):
            square = k * expected * expected
            assert within(less, square / (1 + mp.sqrt(1 - square)), 12.0) or abs(square) < 1e-290


@given(w=st.floats(-0.305, 0.305), xzb=arguments())
@example(w=0.14, xzb=(0.05, 0.0, 1.0))
@example(w=0.0999, xzb=(0.0, 0.0, 1.0))
@example(w=0.3, xzb=(0.0, 0.0, 1.0))
def test_the_short_integral_of_the_third_kind_has_all_digits_of_its_angle(kernels, w, xzb):
    """Where six nodes suffice, the error is below a rounding of w, and so of the angle."""
    (integral,) = evaluated(kernels, "third_kind_short", (w, *xzb), 1)
    with mp.workdps(30):
        w, x, z, b = map(mp.mpf, (w, *xzb))

        def integrand(v):
            u = w * w * v * v
            return b * v * v / ((1 + b * u) * mp.sqrt((1 - x * u) * (1 - z * u)))

        expected = w**3 * mp.quad(integrand, [0, 1])
        assert abs(integral - expected) <= U * abs(w) + 8.0 * U * abs(expected)


@given(
    angle=st.one_of(
        st.floats(-4.0, 4.0), st.floats(-1e6, 1e6), st.integers(-(10**6), 10**6).map(lambda k: k * np.pi / 4)
    )
)
def test_cosines_and_sines_are_rounded(kernels, angle):
    cosine, sine = evaluated(kernels, "cosine_and_sine", (angle,), 2)
    with mp.workdps(40):
        assert abs(cosine - mp.cos(angle)) <= 2.0 * U
        assert abs(sine - mp.sin(angle)) <= 2.0 * U
        if abs(angle) < 0.5:
            assert within(sine, mp.sin(angle), 2.0)


@given(q=st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: sum(x * x for x in q) > 0.01))
def test_the_defect_of_a_norm_has_24_places(kernels, q):
    unit = np.array(q) / np.linalg.norm(q)
    defect = np.empty(1)
    kernels("norm_defect", 1, pairs(unit[None]), defect)
    with mp.workdps(40):
        assert abs(defect[0] - (1 - mp.fsum(mp.mpf(x) ** 2 for x in unit.tolist()))) <= 1e-23


def test_nodes_and_weights_are_those_of_the_rules():
    text = next(file for file in compilation.INCLUDED if file.name == "nodes.cl").read_text(encoding="utf-8")
    found = [tuple(map(float, pair)) for pair in re.findall(r"REAL\(([\d.]+)\)\*integrand\(REAL\(([\d.]+)\)\*u,", text)]
    assert found == [pair for squares, weights in RULES for pair in zip(weights, squares[:, 0], strict=True)]
    assert text.count("integrand") == len(found)
