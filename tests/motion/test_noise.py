"""Noise: Philox as published, normals as their distribution says, and bits that depend on their address alone."""

import mpmath
import numpy as np
import pytest
from scipy import stats

from openmm_exactrb.kernels.compiled import noise as compiled
from openmm_exactrb.kernels.plain import noise as plain

ULP = 2.0**-52


@pytest.fixture(params=[plain, compiled], ids=["plain", "compiled"])
def noise(request):
    return request.param


def drawn(function, shape, seed=1, step=0, stream=0):
    out = np.full(shape, np.nan)
    function(seed, step, stream, 0, shape[1], out)
    return out


def words(*numbers):
    return [np.array([int(number, 16)], dtype=np.uint64) for number in numbers]


@pytest.mark.parametrize(
    ("counter", "key", "result"),
    [
        ("00000000 " * 4, "00000000 " * 2, "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        ("ffffffff " * 4, "ffffffff " * 2, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ],
)
def test_philox_gives_the_published_numbers(counter, key, result):
    """Known answers of the authors' library, Random123."""
    found = plain.philox(*words(*counter.split()), *words(*key.split()))
    assert [int(word[0]) for word in found] == [int(word, 16) for word in result.split()]


def test_both_functions_read_the_words_of_the_documented_counter():
    seed, step, stream, row, column = 0x0123456789ABCDEF, 0x76543210FEDCBA98, 77, 4, 3
    counter = words(hex(column), hex(stream * 256 + row // 2), "fedcba98", "76543210")
    a, b, c, d = (int(word[0]) for word in plain.philox(*counter, *words("89abcdef", "01234567")))
    u, v = ((2 * (w >> 12) + 1) * 2.0**-53 for w in (a << 32 | b, c << 32 | d))
    pair = drawn(plain.uniforms, (6, 5), seed, step, stream)[row : row + 2, column]
    assert list(pair) == [u, v]
    angle = (mpmath.mpf(v) - 0.5) * mpmath.pi / 2
    cosine, sine = float(mpmath.cos(angle)), float(mpmath.sin(angle))
    x, y = (sine, cosine) if d & 1 else (cosine, sine)
    r = float(mpmath.sqrt(-2 * mpmath.log(u))) * (-1 if d & 2 else 1)
    pair = drawn(plain.normals, (6, 5), seed, step, stream)[row : row + 2, column]
    np.testing.assert_allclose(pair, [r * x, r * y], rtol=4 * ULP)


def test_formulas_are_right_to_a_few_units_in_the_last_place(rng):
    with mpmath.workprec(200):
        far = 2.0 ** -rng.uniform(0.0, 53.0, 500)
        for u in (*far, *(1.0 - far[far < 0.5]), *rng.random(500), 2.0**-53, 1.0 - 2.0**-53, 0.5, np.sqrt(0.5)):
            exact = mpmath.sqrt(-2 * mpmath.log(mpmath.mpf(float(u))))
            assert abs(plain.radius(np.array([u]))[0] / exact - 1) < 2 * ULP
        for v in (*rng.random(1000), 2.0**-53, 0.5 + 2.0**-53, 1.0 - 2.0**-53):
            angle = (mpmath.mpf(float(v)) - 0.5) * mpmath.pi / 2
            x, y = plain.direction(np.array([v]), np.array([0], dtype=np.uint64))
            assert abs(x[0] / mpmath.cos(angle) - 1) < 2 * ULP
            assert abs(y[0] / mpmath.sin(angle) - 1) < 2 * ULP


def test_the_four_quarters_close_the_circle():
    """Edges of neighbouring quarters meet: none is left out, none is there twice."""
    edges = np.array([2.0**-53, 1.0 - 2.0**-53])
    angles = sorted(
        np.arctan2(y, x)
        for choice in range(4)
        for x, y in zip(*plain.direction(edges, np.full(2, choice, dtype=np.uint64)), strict=True)
    )
    quarters = np.repeat(np.array([-0.75, -0.25, 0.25, 0.75]) * np.pi, 2)
    np.testing.assert_allclose(angles, quarters, atol=1e-15)


@pytest.mark.parametrize("function", ["normals", "uniforms"])
@pytest.mark.parametrize("shape", [(1, 1), (3, 63), (3, 64), (6, 65), (5, 1000), (3, 0)])
@pytest.mark.parametrize(("seed", "step"), [(1, 0), (-3, 2**40 + 5), (2**63 - 1, -1)])
def test_twins_give_the_same_bits(function, shape, seed, step):
    twins = [drawn(getattr(twin, function), shape, seed, step, plain.STREAMS - 1) for twin in (plain, compiled)]
    np.testing.assert_array_equal(*twins)
    assert np.isfinite(twins[0]).all()


def test_twins_give_the_same_bits_of_a_million():
    np.testing.assert_array_equal(*(drawn(twin.normals, (4, 250_000), 9, 8, 7) for twin in (plain, compiled)))


def test_the_numbers_of_a_seed_stay_what_they_are(noise):
    """Checkpoints of older versions go on with them."""
    values = [
        ["0x1.7861ad0568ad9p-2", "-0x1.27973a3b44652p+0"],
        ["-0x1.994045470def6p-4", "0x1.b0f55b6d245cbp-1"],
        ["0x1.185102fc03ccep-2", "-0x1.65b3d2cfec8cfp-3"],
    ]
    found = drawn(noise.normals, (3, 2), seed=1, step=2, stream=3)
    assert [[value.hex() for value in row] for row in found.tolist()] == values


@pytest.mark.parametrize("function", ["normals", "uniforms"])
def test_a_number_depends_on_its_address_alone(noise, function):
    draw = getattr(noise, function)
    whole = drawn(draw, (6, 300), 4, 5, 6)
    np.testing.assert_array_equal(drawn(draw, (3, 100), 4, 5, 6), whole[:3, :100])
    parts = np.full((6, 300), np.nan)
    for first, last in ((200, 300), (0, 1), (1, 70), (70, 200)):
        draw(4, 5, 6, first, last, parts)
    np.testing.assert_array_equal(parts, whole)


def test_a_call_writes_its_columns_only(noise):
    out = np.full((3, 200), np.nan)
    noise.normals(1, 2, 3, 70, 90, out)
    assert np.isnan(out[:, :70]).all()
    assert np.isnan(out[:, 90:]).all()
    assert np.isfinite(out[:, 70:90]).all()


def test_every_part_of_the_address_counts():
    """Seeds, steps and streams next to each other, and in every word: numbers without correlation."""
    n = 20_000
    addresses = [(1, 0, 0), (2, 0, 0), (1 + 2**32, 0, 0), (1, 1, 0), (1, 2**32, 0), (1, 0, 1), (0, 1, 1)]
    rows = np.concatenate([drawn(compiled.normals, (4, n), *address) for address in addresses])
    rows = np.concatenate([rows[:, :-1], rows[:, 1:]])  # neighbouring columns too
    correlation = np.corrcoef(rows) - np.eye(len(rows))
    # The largest of 1500 correlations, each of width 1/sqrt(n), beyond 5 widths: once in a thousand such tests.
    assert np.abs(correlation).max() < 5.0 / np.sqrt(n)
    squares = np.corrcoef(rows**2) - np.eye(len(rows))
    assert np.abs(squares).max() < 5.0 / np.sqrt(n)


def test_normals_are_normal():
    x = drawn(compiled.normals, (10, 1_000_000), 20, 1, 2).ravel()
    n = len(x)
    # Moments k = 1 ... 8 within 4 widths: Var(x^k) = (2k - 1)!! - ((k - 1)!!)² for even k.
    exact = stats.norm.moment
    power = np.ones(n)
    for k in range(1, 9):
        power *= x
        width = np.sqrt((exact(2 * k) - exact(k) ** 2) / n)
        assert abs(power.mean() - exact(k)) < 4.0 * width, k
    assert stats.kstest(x, "norm").pvalue > 1e-3
    for far in (3.0, 4.0, 5.0):
        expected = 2.0 * stats.norm.sf(far) * n
        assert stats.poisson.interval(0.9999, expected)[0] <= (np.abs(x) > far).sum()
        assert (np.abs(x) > far).sum() <= stats.poisson.interval(0.9999, expected)[1]


def test_uniforms_are_uniform():
    u = drawn(compiled.uniforms, (10, 100_000), 21, 1, 2).ravel()
    assert u.min() > 0.0
    assert u.max() < 1.0
    assert stats.kstest(u, "uniform").pvalue > 1e-3


def test_pairs_of_normals_have_no_direction():
    x, y = drawn(compiled.normals, (2, 1_000_000), 22, 0, 0)
    angle = np.arctan2(y, x) / (2.0 * np.pi) + 0.5
    assert stats.kstest(angle, "uniform").pvalue > 1e-3
    assert stats.kstest(x**2 + y**2, "chi2", args=(2,)).pvalue > 1e-3
    assert abs(np.corrcoef(angle, x**2 + y**2)[0, 1]) < 4e-3


@pytest.mark.validate
def test_normals_have_tails_to_six_widths():
    """Counts beyond 4, 5 and 6 widths of 2e9 normals; 2.3e-10 would be the resolution of 32 bits."""
    out, edges, found = np.empty((2, 1_000_000)), np.array([4.0, 5.0, 6.0]), np.zeros(3)
    for step in range(1000):
        compiled.normals(23, step, 0, 0, out.shape[1], out)
        far = np.abs(out[np.abs(out) > edges[0]])
        found += (far[:, None] > edges).sum(axis=0)
    low, high = stats.poisson.interval(0.9999, 2.0 * stats.norm.sf(edges) * 2e9)
    assert (low <= found).all(), found
    assert (found <= high).all(), found
