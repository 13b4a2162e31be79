"""The kernels' numbers: sums of two doubles in exact fractions, and random numbers against those of NumPy."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from kernel_functions import U, pairs, words_of_numpy
from scipy import stats

from openmm_exactrb.mathematics import compensated
from openmm_exactrb.random.rng import PURPOSES, Instant

NUMBER = st.floats(-1e100, 1e100)
LOW = st.floats(-0.5, 0.5)
WORD = st.integers(0, 2**64 - 1)


def pair_of(high, part):
    """Return an array (1, 2) with a number of the state, whose low part is this part of a unit in the last place."""
    return pairs(np.array([high]), part * np.spacing(high))


def exact(pair):
    return sum(map(Fraction, pair.ravel().tolist()))


# -- sums of two doubles ----------------------------------------------------------------------------------------------


@given(high=NUMBER, part=LOW, step=NUMBER)
def test_a_sum_errs_by_a_rounding_of_its_step(kernels, high, part, step):
    start = pair_of(high, part)
    for name, change in (("add_to", step), ("take_from", -step)):
        end = start.copy()
        kernels(name, 1, end, np.array([step]))
        together = Fraction(step) + Fraction(start[0, 1]) * (1 if name == "add_to" else -1)
        assert abs(exact(end) - exact(start) - Fraction(change)) <= Fraction(U) * abs(together)
        assert end[0, 0] == end[0, 0] + end[0, 1]
        of_host = compensated.add(start.T[:, :, None], np.array([[change]]))
        np.testing.assert_array_equal(end[0], of_host[:, 0, 0])


@given(a=NUMBER, b=NUMBER, near=st.booleans(), parts=st.tuples(LOW, LOW))
def test_a_difference_has_a_rest(kernels, a, b, near, parts):
    a, b = pair_of(a, parts[0]), pair_of(a * (1.0 + 1e-9) if near else b, parts[1])
    high, rest = np.empty(1), np.empty(1)
    kernels("difference", 1, a, b, high, rest)
    low = abs(a[0, 1]) + abs(b[0, 1]) + U * abs(a[0, 0] - b[0, 0])  # what is added with roundings
    assert abs(Fraction(high[0]) + Fraction(rest[0]) - (exact(a) - exact(b))) <= 3 * Fraction(U) * Fraction(low)
    assert high[0] == high[0] + rest[0]


@given(
    d=st.floats(0.01, 10.0),
    direction=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda r: sum(x * x for x in r) > 0.01),
    stretch=st.sampled_from([0.0, 1e-15, -1e-12, 1e-8]),
    parts=st.tuples(LOW, LOW, LOW),
)
def test_the_defect_of_a_length_is_exact_to_a_rounding_of_roundoff(kernels, d, direction, stretch, parts):
    r = np.array(direction) * (d * (1.0 + stretch) / np.linalg.norm(direction))
    rest, defect = np.array(parts) * np.spacing(r), np.empty(1)
    kernels("defect_of_length", 1, np.array([d]), r, rest, defect)
    square = sum((Fraction(x) + Fraction(low)) ** 2 for x, low in zip(r.tolist(), rest.tolist(), strict=True))
    expected = (Fraction(d) ** 2 - square) / 2
    assert abs(Fraction(defect[0]) - expected) <= Fraction(1e-7 * U * d * d) + 4 * Fraction(U) * abs(expected)


# -- random numbers ---------------------------------------------------------------------------------------------------


@given(a=WORD, b=WORD)
def test_the_upper_word_of_a_product_is_exact(kernels, a, b):
    product = np.empty(1, np.uint64)
    kernels("upper_words", 1, np.array([a], np.uint64), np.array([b], np.uint64), product)
    assert int(product[0]) == a * b >> 64


@given(key=WORD, counter=st.tuples(WORD, WORD, WORD, WORD))
def test_words_are_those_of_numpy(kernels, key, counter):
    words = np.array(counter, np.uint64)
    kernels("philox", 1, np.array([key], np.uint64), words)
    np.testing.assert_array_equal(words, words_of_numpy(key, counter))


@given(word=st.one_of(WORD, st.sampled_from([0, 2**64 - 1, 2**11 - 1, 2**11])))
def test_uniform_numbers_are_in_the_middle_of_their_cells(kernels, word):
    number = np.empty(1)
    kernels("uniform", 1, np.array([word], np.uint64), number)
    assert number[0] == ((word >> 11) + 0.5) * 2.0**-53
    assert 0.0 < number[0] < 1.0 or word >> 11 == 2**53 - 1


def normals(kernels, key, step, stream, bodies):
    """Return the four normal numbers of each body (n, 4)."""
    n, out = len(bodies), np.empty((len(bodies), 4))
    address = np.full(n, key, np.int64), np.full(n, step, np.int64), np.full(n, stream, np.int32)
    kernels("normals", n, *address, np.asarray(bodies, np.int32), out)
    return out


@given(
    key=st.integers(-(2**53), 2**53),
    step=st.integers(0, 2**40),
    substep=st.integers(0, 99),
    purpose=st.integers(0, PURPOSES - 1),
    body=st.integers(0, 10**6),
)
def test_normal_numbers_are_those_of_box_and_muller_and_of_the_host(kernels, key, step, substep, purpose, body):
    (drawn,) = normals(kernels, key, step, PURPOSES * substep + purpose, [body])
    words = words_of_numpy(key % 2**64, (body + 1, 0, PURPOSES * substep + purpose, step))
    u = ((words >> np.uint64(11)) + 0.5) * 2.0**-53
    radius, angle = np.sqrt(-2.0 * np.log(u[::2])), 2.0 * np.pi * u[1::2]
    np.testing.assert_allclose(
        drawn, np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).ravel(), atol=4e-15
    )
    if body < 1000:
        of_host = Instant(key, step, substep).normals(purpose, (4, body + 1))[:, body]
        np.testing.assert_allclose(drawn, of_host, rtol=0.0, atol=4e-15)


def test_normal_numbers_have_their_distribution_and_are_independent(kernels):
    n = 50_000
    x = np.concatenate([normals(kernels, 3, step, 16, np.arange(n)).T for step in (7, 8)])
    assert stats.kstest(x.ravel(), "norm").pvalue > 1e-3
    for power, moment, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):
        assert abs((x**power).mean() - moment) < 4.0 * (variance / x.size) ** 0.5
    for each in (x, x * x):
        assert np.abs(np.corrcoef(each) - np.eye(len(x))).max() < 5.0 / np.sqrt(n)
