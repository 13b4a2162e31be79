"""Every public function of the numpy layers, for arbitrary shapes, types, layouts and sizes of numbers."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import integrate as quadrature
from scipy.special import ellipj, ellipkinc

import openmm_exactrb as rb
from benchmarks.paper import problems
from openmm_exactrb.mathematics import compensated, elliptic, quaternions
from openmm_exactrb.rotors import LARGEST_MOMENT, SMALLEST_MOMENT, WIDEST, rotor, rotor_of_sums

TWINS = ["exact_numpy", "exact"]
UNIT = st.floats(0.0, 1.0)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
#: Denormal, tiny, usual and huge sizes.
SIZES = st.sampled_from([5e-324, 1e-310, 1e-300, 1e-150, 1e-45, 1e-8, 1.0, 1e8, 1e45, 1e150, 1e300])


@pytest.fixture(scope="module", params=TWINS)
def twin(request):
    return request.param


@st.composite
def momenta(draw):
    """Three components, each of its own size."""
    return np.array([draw(st.floats(-1.0, 1.0)) * draw(SIZES) for _ in range(3)])


@st.composite
def moments(draw):
    """Three moments of one size, up to `WIDEST` apart."""
    relative = np.array([10.0 ** draw(st.floats(-7.4, 7.4)) for _ in range(3)])
    return relative * draw(st.sampled_from([1e-290, 1e-150, 1.0, 1.0, 1e150, 1e290]))


def layouts(x):
    """Yield the same numbers in other layouts."""
    yield x
    yield np.asfortranarray(x)
    yield np.repeat(x, 2, axis=0)[::2]
    yield np.ascontiguousarray(x[..., ::-1])[..., ::-1]


def spatial(q, m):
    return np.einsum("...ij,...j->...i", quaternions.rotation_matrix(q), m)


# -- rotors ---------------------------------------------------------------------------------------------------------


@given(inertia=moments(), m=momenta(), angle=st.floats(-50.0, 50.0))
@example(inertia=np.array([1.9, 18.6, 0.07]), m=np.array([-2e-46, -0.18, -1e-221]), angle=1.0)
@example(inertia=np.array([1.0, 1.0, 1.0]), m=np.full(3, 5e-324), angle=1.0)
@example(inertia=np.array([1e306, 1e307, 2e306]), m=np.array([0.1, 1.0, 2.0]), angle=1.0)
def test_a_flow_keeps_its_invariants_or_is_nan(twin, inertia, m, angle):
    with np.errstate(all="ignore"):
        rate = np.abs(m / inertia).max()
        t = angle / rate
    q1, m1 = rb.free_rotor(inertia, [1, 0, 0, 0], m, t, method=twin)
    if not np.isfinite(t):
        assert np.isnan(q1).all()
        return
    size = np.abs(m).max()
    if not size > 1e-290:  # only what is below it can be wrong: the precision of denormal numbers
        np.testing.assert_allclose(m1, spatial(q1 * [1, -1, -1, -1], m), rtol=0.0, atol=1e-303)
        return
    m, m1 = m / size, m1 / size
    np.testing.assert_allclose(np.linalg.norm(q1), 1.0, rtol=0.0, atol=5e-16)
    np.testing.assert_allclose(np.linalg.norm(m1), np.linalg.norm(m), rtol=1e-15)
    np.testing.assert_allclose(spatial(q1, m1), m, rtol=0.0, atol=1e-15 * (10.0 + abs(angle)))
    relative = inertia / inertia.min()
    energy, energy1 = (m * m / relative).sum(), (m1 * m1 / relative).sum()
    assert abs(energy1 - energy) <= 1e-15 * (20.0 + abs(angle)) * (m * m).sum()


@given(m=momenta(), t=FINITE, bad=st.sampled_from([np.nan, np.inf, -np.inf]), place=st.integers(0, 7))
def test_what_is_not_finite_is_nan_in_its_body_and_no_other(twin, m, t, bad, place):
    inertia = np.array([0.5, 0.8, 1.0])
    body = np.array([1.0, 0.0, 0.0, 0.0, *m, t])
    alone = rb.free_rotor(inertia, body[:4], body[4:7], body[7], method=twin)
    rows = np.tile(body, (5, 1))
    rows[2, place] = bad
    q1, m1 = rb.free_rotor(inertia, rows[:, :4], rows[:, 4:7], rows[:, 7], method=twin)
    assert np.isnan(q1[2]).all() or (place < 4 and np.isnan(q1[2]).any())
    for together, one in zip((q1, m1), alone, strict=True):
        for k in (0, 1, 3, 4):
            # The last bit may depend on the place in the array, where numpy's vector loops end.
            np.testing.assert_allclose(together[k], one, rtol=1e-15, atol=1e-15 * np.abs(one).max())


@given(
    dtype=st.sampled_from([np.float32, np.float64, np.int64, np.int8, bool, object]),
    shape=st.sampled_from([(), (0,), (1,), (3,)]),
    data=st.data(),
)
def test_any_type_shape_and_layout_gives_the_same(twin, dtype, shape, data):
    q = data.draw(arrays.arrays(np.int8, (*shape, 4), elements=st.integers(-9, 9)))
    q[..., 0] |= 1  # a direction
    m = data.draw(arrays.arrays(np.int8, (*shape, 3), elements=st.integers(0, 1)))
    t = data.draw(st.sampled_from([0, 1, np.float32(0.5)]))
    q, m, inertia = q.astype(dtype), m.astype(dtype), np.array([1, 2, 2], dtype=np.int8)
    expected = rb.free_rotor(inertia.astype(float), q.astype(float), m.astype(float), float(t), method=twin)
    assert [x.shape for x in expected] == [(*shape, 4), (*shape, 3)]
    for a, b in zip(layouts(np.atleast_2d(q)), layouts(np.atleast_2d(m)), strict=True):
        for got, x in zip(rb.free_rotor(inertia, a, b, t, method=twin), expected, strict=True):
            assert got.dtype == np.float64
            np.testing.assert_array_equal(got, np.atleast_2d(x))


@given(scale=st.sampled_from([1e-300, 1e-200, 1e-20, 0.5, 2.0, 1e20, 1e200, 1e300]))
def test_quaternions_of_any_norm_are_directions(twin, scale):
    q = np.array([0.1, -0.7, 0.5, 0.5])
    expected = rb.free_rotor([1, 2, 3], q, [1, 1, 1], 0.3, method=twin)
    got = rb.free_rotor([1, 2, 3], scale * q, [1, 1, 1], 0.3, method=twin)
    np.testing.assert_allclose(got[0], expected[0], rtol=0.0, atol=4e-16)
    np.testing.assert_array_equal(got[1], expected[1])


@given(moment=st.one_of(st.floats(max_value=0.0), st.sampled_from([np.nan, np.inf, 5e-324, 1e-308])))
@pytest.mark.parametrize("name", rb.ROTORS)
def test_moments_that_no_formula_can_take_are_refused(name, moment):
    for prepare in (rotor, rotor_of_sums):
        with pytest.raises(ValueError, match="inertia must"):
            prepare(name, [[1.0, 1.0, 1.0], [1.0, moment, 1.0]])


def test_moments_may_be_those_of_no_masses_but_not_too_far_apart(twin):
    q, m = rb.free_rotor([1.0, 1.0, 9.0], [1, 0, 0, 0], [1.0, 2.0, 3.0], 0.2, method=twin)
    np.testing.assert_allclose(spatial(q, m), [1.0, 2.0, 3.0], rtol=1e-15)
    for inertia in ([1.0, 2.0, 2.01 * WIDEST], [0.5 * SMALLEST_MOMENT] * 3, [2.0 * LARGEST_MOMENT] * 3):
        with pytest.raises(ValueError, match="other units"):
            rb.free_rotor(inertia, [1, 0, 0, 0], [1.0, 2.0, 3.0], 0.2, method=twin)


@given(m=momenta(), t=st.floats(-0.3, 0.3))
def test_the_high_part_of_sums_is_the_plain_flow(twin, m, t):
    q = np.array([[0.5], [0.5], [-0.5], [0.5]])
    flow = rotor(twin, [0.5, 0.8, 1.0])
    with np.errstate(all="ignore"):
        plain, of_sums = flow(q, m[:, None], t), flow(compensated.exactly(q), compensated.exactly(m[:, None]), t)
    for one, other in zip(plain, of_sums, strict=True):
        np.testing.assert_array_equal(other[0], one)
        assert not (np.abs(other[1]) > 0.5000001 * np.spacing(np.abs(one))).any()


# -- sums -----------------------------------------------------------------------------------------------------------


@given(start=FINITE.filter(lambda x: abs(x) < 1e300), steps=st.lists(st.floats(-1.0, 1.0), max_size=30), size=SIZES)
def test_a_sum_rounds_as_its_steps_do_and_not_as_itself(start, steps, size):
    total, exact = compensated.exactly(np.full((1, 1), start)), Fraction(start)
    for step in steps:
        total = compensated.add(total, np.full((1, 1), step * size))
        exact += Fraction(step * size)
    high, low = total[:, 0, 0]
    # A step is rounded together with the low part, and that to half a unit of it.
    rounding = 2.0**-53 * sum(abs(step * size) for step in steps) + len(steps) * 2.0**-106 * (abs(start) + 30.0 * size)
    assert abs(Fraction(high) + Fraction(low) - exact) <= 2.0 * rounding + len(steps) * 5e-324
    assert high == high + low


@given(high=st.floats(-1e10, 1e10), step=st.floats(-1.0, 1.0), n=st.integers(0, 4))
def test_a_sum_of_one_part_rounds(high, step, n):
    x = np.full((1, 3, n), high)
    np.testing.assert_array_equal(compensated.add(x, np.full((3, n), step))[0], x[0] + step)


def test_a_new_high_part_keeps_the_low_part_of_what_stayed():
    x = np.array([[1.0, 2.0], [1e-17, 1e-17]])
    np.testing.assert_array_equal(compensated.renewed(x, np.array([1.0, 3.0])), [[1.0, 3.0], [1e-17, 0.0]])


# -- quaternions ----------------------------------------------------------------------------------------------------


@given(n=st.integers(0, 5), seed=st.integers(0, 1000))
def test_quaternions_multiply_as_matrices_do(n, seed):
    rng = np.random.default_rng(seed)
    p, q = (quaternions.random(rng, n) for _ in range(2))
    assert p.shape == (n, 4)
    product = quaternions.multiply(np.ascontiguousarray(p.T), np.ascontiguousarray(q.T))
    matrices = [quaternions.rotation_matrix(x) for x in (p, q, product.T)]
    np.testing.assert_allclose(matrices[0] @ matrices[1], matrices[2], rtol=0.0, atol=2e-15)
    again = quaternions.from_matrix(quaternions.matrix(product))
    np.testing.assert_allclose(np.abs((again * product).sum(axis=0)), 1.0, rtol=0.0, atol=1e-15)
    slightly_off = product * (1.0 + 1e-9)
    np.testing.assert_allclose(quaternions.renormalise(slightly_off), product, rtol=0.0, atol=1e-15)


@given(x=arrays.arrays(np.float64, (3, 4), elements=st.floats(-2.0, 2.0)))
def test_rotation_matrices_take_any_layout_and_type(x):
    expected = quaternions.rotation_matrix(x)
    for y in layouts(x):
        np.testing.assert_array_equal(quaternions.rotation_matrix(y), expected)
    single = x.astype(np.float32)
    np.testing.assert_array_equal(
        quaternions.rotation_matrix(single), quaternions.rotation_matrix(single.astype(float))
    )
    assert quaternions.rotation_matrix(np.zeros((0, 4))).shape == (0, 3, 3)
    assert quaternions.rotation_matrix(np.zeros((2, 5, 4))).shape == (2, 5, 3, 3)


@given(x=arrays.arrays(np.float64, (4, 3), elements=st.floats(-1.0, 1.0)))
def test_the_defect_of_a_norm_is_exact(x):
    size = np.linalg.norm(x, axis=0)
    assume((size > 0.1).all())
    q = x / size
    exact = [float(1 - sum(Fraction(component) ** 2 for component in column)) for column in q.T]
    np.testing.assert_allclose(quaternions.norm_defect(q), exact, rtol=0.0, atol=1e-23)


def test_a_quaternion_that_is_not_finite_spoils_no_neighbour():
    q = np.tile([0.5, 0.5, 0.5, 0.5], (3, 1))
    q[1, 2] = np.nan
    Q = quaternions.rotation_matrix(q)
    assert np.isnan(Q[1]).any()
    assert np.isfinite(Q[::2]).all()
    back = quaternions.from_matrix(np.moveaxis(Q, 0, -1)).T
    assert np.isnan(back[1]).all()
    np.testing.assert_allclose(back[::2], q[::2], rtol=1e-15)


# -- elliptic -------------------------------------------------------------------------------------------------------


@given(v=st.floats(-30.0, 30.0), kc2=st.floats(1e-3, 1.0))
def test_jacobi_agrees_with_scipy(v, kc2):
    values = elliptic.jacobi(np.array([v]), np.array([kc2]))
    np.testing.assert_allclose(np.ravel(values[:3]), ellipj(v, 1.0 - kc2)[:3], rtol=0.0, atol=1e-13 * (1.0 + abs(v)))


@given(v=st.lists(st.floats(-1e15, 1e15), max_size=4), kc2=st.one_of(st.just(0.0), UNIT))
@example(v=[1e15, 5e-324, -1e-300], kc2=5e-324)
def test_jacobi_is_on_its_curve_for_every_argument(v, kc2):
    with np.errstate(all="ignore"):
        sn, cn, dn, half_turns = elliptic.jacobi(np.array(v), np.full(len(v), kc2))
    assert sn.shape == (len(v),)
    np.testing.assert_allclose(sn * sn + cn * cn, 1.0, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(dn * dn, cn * cn + kc2 * sn * sn, rtol=1e-12, atol=1e-300)
    assert ((half_turns % 2 == 1) == (cn < 0.0)).all()


def test_jacobi_of_what_is_not_finite_is_nan_alone():
    v, kc2 = np.array([0.5, np.nan, 0.5, np.inf, 0.5]), np.array([0.3, 0.3, np.nan, 0.3, 0.3])
    with np.errstate(all="ignore"):
        values = np.array(elliptic.jacobi(v, kc2)[:3])
    assert np.isnan(values[:, 1:4]).all()
    np.testing.assert_array_equal(values[:, 0], values[:, 4])


@given(v=st.floats(-6.0, 6.0), kc2=st.floats(0.01, 1.0), c=st.floats(0.1, 1.0), b=UNIT)
def test_integrals_of_the_third_kind_are_those_of_quadrature(v, kc2, c, b):
    def integrand(u):
        w = ellipj(u, 1.0 - kc2)[0] / c
        return b * w * w / (1.0 + b * w * w) / c

    arguments = np.array([v]), np.array([kc2])
    sn, cn, dn, half_turns = elliptic.jacobi(*arguments)
    got = elliptic.third_kind(*arguments, np.array([c]), np.array([b]), sn / c, cn, dn, half_turns)
    expected, _ = quadrature.quad(integrand, 0.0, v, epsabs=1e-11, limit=200)
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-9)
    nc = 1.0 + b / (c * c)  # n sn² = -b w²: the same integral, in Legendre's form
    legendre = elliptic.third_kind_legendre(sn, cn, dn, half_turns, arguments[1], np.array([nc]))
    np.testing.assert_allclose(-legendre / c, expected, rtol=0.0, atol=1e-9)


@given(s=st.floats(-0.3, 0.3), x=UNIT, z=UNIT, b=UNIT)
def test_short_series_are_inverse_and_quadrature(s, x, z, b):
    w = elliptic.sine_short(*(np.array([a]) for a in (s, x, z)))
    small, large = sorted((x, z))
    if large > 1e-6:  # w = sn(v | small/large)/sqrt(large) at v = s sqrt(large)
        inverse = ellipkinc(np.arcsin(w * np.sqrt(large)), small / large) / np.sqrt(large)
        np.testing.assert_allclose(inverse, s, rtol=1e-12, atol=1e-300)

    def integrand(u):
        return b * u * u / ((1.0 + b * u * u) * np.sqrt((1.0 - x * u * u) * (1.0 - z * u * u)))

    got = elliptic.third_kind_short(w, *(np.array([a]) for a in (x, z, b)))
    np.testing.assert_allclose(got, quadrature.quad(integrand, 0.0, w[0], epsabs=1e-14)[0], rtol=1e-11, atol=1e-14)
    assert elliptic.third_kind_short(w[:0], w[:0], w[:0], w[:0]).shape == (0,)


@given(name=st.text(max_size=8))
def test_unknown_rotors_are_refused(name):
    assume(name not in rb.ROTORS)
    with pytest.raises(ValueError, match="choose one of"):
        rotor(name, [1, 1, 1])


# -- problems -------------------------------------------------------------------------------------------------------


@given(n=st.integers(0, 4), seed=st.integers(0, 99), h=st.floats(-0.1, 0.1), method=st.sampled_from(TWINS))
def test_problems_are_advanced_body_by_body_for_any_number(n, seed, h, method):
    top, (q, m) = problems.HeavyTop.random(np.random.default_rng(seed), 0.5, 1.0, n)
    I1, I2, I3 = top.inertia
    assert (I1 + I2 >= I3).all()
    np.testing.assert_allclose(problems.kinetic_energy(top.inertia, m), 1.0, rtol=1e-14)
    for problem in (top, problems.Satellite(top.inertia, gravity=1.0, radius=2.0)):
        scheme = rb.SCHEMES["SRKN4_6b"]
        q1, m1 = problems.integrate(problem, (q, m), h, 3, scheme, method)
        assert (q1.shape, m1.shape) == ((4, n), (3, n))
        q2, m2 = problems.integrate(problem, (compensated.exactly(q), compensated.exactly(m)), h, 3, scheme, method)
        np.testing.assert_array_equal(q2[0], q1)
        np.testing.assert_array_equal(m2[0], m1)
        np.testing.assert_allclose(problems.energy(problem, (q1, m1)), problems.energy(problem, (q, m)), atol=1e-6)
        back = problems.integrate(problem, (q1, m1), -h, 3, scheme, method)
        np.testing.assert_allclose(back[1], m, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("method", TWINS)
def test_a_problem_that_is_not_finite_is_so_alone(method):
    top, (q, m) = problems.HeavyTop.random(np.random.default_rng(1), 0.5, 1.0, 4)
    good = problems.integrate(top, (q, m), 0.05, 5, rb.SCHEMES["V2"], method)
    m = m.copy()
    m[1, 2] = np.nan
    q1, m1 = problems.integrate(top, (q, m), 0.05, 5, rb.SCHEMES["V2"], method)
    assert np.isnan(q1[:, 2]).all()
    assert np.isnan(m1[:, 2]).all()
    for got, x in zip((q1, m1), good, strict=True):
        np.testing.assert_allclose(np.delete(got, 2, 1), np.delete(x, 2, 1), rtol=0.0, atol=1e-15)
