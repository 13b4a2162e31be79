"""Counter-based random numbers: Philox with the documented layout; bits depend on seed, step and stream alone."""

import mpmath
import numpy as np
import pytest
from scipy import stats

from openmm_exactrb.random.rng import PURPOSES, Instant, Purpose

_WORD = 2**64 - 1


def drawn(kind, seed, step, stream, *shape):
    """Return what an instant draws from the stream of a substep and a purpose."""
    substep, purpose = divmod(stream, PURPOSES)
    return getattr(Instant(seed, step, substep), kind)(purpose, *shape)


def normals(*address_and_shape):
    return drawn("normals", *address_and_shape)


def philox(counter, key):
    """Return the four words that Philox4x64-10 makes of a counter and a key, as published."""
    c, k = list(counter), list(key)
    for _ in range(10):
        (high0, low0), (high1, low1) = (
            divmod(0xD2E7470EE14C6C93 * c[0], 2**64),
            divmod(0xCA5A826395121157 * c[2], 2**64),
        )
        c = [high1 ^ c[1] ^ k[0], low1, high0 ^ c[3] ^ k[1], low0]
        k = [(k[0] + 0x9E3779B97F4A7C15) & _WORD, (k[1] + 0xBB67AE8584CAA73B) & _WORD]
    return c


def test_the_reference_gives_the_published_numbers():
    """Known answers of the authors' library, Random123."""
    zeros = "16554d9eca36314c db20fe9d672d0fdc d7e772cee186176b 7e68b68aec7ba23b"
    ones = "87b092c3013fe90b 438c3c67be8d0224 9cc7d7c69cd777b6 a09caebf594f0ba0"
    assert philox([0] * 4, [0] * 2) == [int(word, 16) for word in zeros.split()]
    assert philox([_WORD] * 4, [_WORD] * 2) == [int(word, 16) for word in ones.split()]


@pytest.mark.parametrize(("seed", "step"), [(1, 0), (-3, 2**40 + 5), (2**53 - 1, -1)])
def test_key_and_counter_have_the_documented_layout(seed, step):
    """NumPy's generator, which increments the counter before each block, has the same words."""
    first = philox([1, 0, 77, step & _WORD], [seed & _WORD, 0])[0]
    key, counter = (np.array(words, dtype=np.uint64) for words in ([seed & _WORD, 0], [0, 0, 77, step & _WORD]))
    assert np.random.Philox(key=key, counter=counter).random_raw() == first
    assert drawn("uniforms", seed, step, 77, 1) == ((first >> 11) + 0.5) * 2.0**-53


def test_normals_of_a_body_are_those_of_box_and_muller_from_its_block():
    """Body n has the block n + 1, and further rows further blocks: so another engine can draw for each body alone."""
    seed, step, stream, n = 5, 2**33 + 1, 81, 7
    expected = []
    for block in (0, 1):
        words = [philox([body + 1, block, stream, step], [seed, 0]) for body in range(n)]
        with mpmath.workdps(30):
            u = [[((word >> 11) + mpmath.mpf(0.5)) * mpmath.mpf(2) ** -53 for word in some] for some in words]
            for turn in (0, 2):
                radius = [mpmath.sqrt(-2 * mpmath.log(some[turn])) for some in u]
                angle = [2 * mpmath.pi * some[turn + 1] for some in u]
                expected.append([float(r * mpmath.cos(a)) for r, a in zip(radius, angle, strict=True)])
                expected.append([float(r * mpmath.sin(a)) for r, a in zip(radius, angle, strict=True)])
    np.testing.assert_allclose(normals(seed, step, stream, (8, n)), expected, rtol=1e-14, atol=3e-15)


def test_numbers_depend_on_neither_the_number_nor_the_order_of_draws():
    first = normals(4, 5, 6, (3, 100))
    normals(4, 5, 7, (3, 10)), normals(4, 6, 6, (3, 10))
    np.testing.assert_array_equal(normals(4, 5, 6, (3, 100)), first)
    np.testing.assert_array_equal(normals(4, 5, 6, (2, 50)), first[:2, :50])
    np.testing.assert_array_equal(normals(4, 5, 6, (50,)), first[0, :50])


@pytest.mark.parametrize("shape", [0.2, 0.5, 1.0, 7.5, 3e5])
def test_gamma_variates_have_their_distribution(shape):
    x = [drawn("gamma", 30, step, 4, shape) for step in range(4000)]
    assert stats.kstest(x, "gamma", args=(shape,)).pvalue > 1e-3


def test_gamma_variates_are_independent_of_the_normals_of_their_stream():
    x = np.array([(drawn("gamma", 31, step, 4, 2.0), *normals(31, step, 4, (4, 1))[:, 0]) for step in range(4000)])
    assert np.abs(np.corrcoef(x.T)[0, 1:]).max() < 4.0 / np.sqrt(len(x))


def test_every_part_of_the_address_counts():
    """Seeds, steps and streams that differ by one, or in their upper words only, give numbers without correlation."""
    n = 20_000
    addresses = [(1, 0, 0), (2, 0, 0), (1 + 2**32, 0, 0), (1, 1, 0), (1, 2**32, 0), (1, 0, 1), (0, 1, 1)]
    rows = np.concatenate([normals(*address, (4, n)) for address in addresses])
    rows = np.concatenate([rows[:, :-1], rows[:, 1:]])  # neighbouring columns too
    # The largest of 1500 correlations, each of width 1/sqrt(n), beyond 5 widths: once in a thousand such tests.
    for each in (rows, rows**2):
        assert np.abs(np.corrcoef(each) - np.eye(len(rows))).max() < 5.0 / np.sqrt(n)


def test_first_numbers_of_successive_steps_are_independent():
    """A step of few bodies takes the first numbers of a stream only."""
    x = np.array([normals(1, step, 0, (3,)) for step in range(20_000)])
    assert stats.kstest(x.ravel(), "norm").pvalue > 1e-3
    pairs = np.concatenate([x[:-1], x[1:]], axis=1)
    assert np.abs(np.corrcoef(pairs.T) - np.eye(6)).max() < 4.0 / np.sqrt(len(x))


def test_normals_and_uniforms_have_their_distributions():
    assert stats.kstest(normals(20, 1, 2, (10, 100_000)).ravel(), "norm").pvalue > 1e-3
    u = np.array([drawn("uniforms", 21, step, 2, 1)[0] for step in range(20_000)])
    assert 0.0 < u.min() < u.max() < 1.0
    assert stats.kstest(u, "uniform").pvalue > 1e-3


def test_substeps_and_purposes_have_streams_of_their_own():
    first = {Instant(1, 2, substep).uniforms(purpose, 1)[0] for substep in range(50) for purpose in Purpose}
    assert len(first) == 50 * len(Purpose)
    assert 0 <= min(Purpose) < max(Purpose) < PURPOSES
