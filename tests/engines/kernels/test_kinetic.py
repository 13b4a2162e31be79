"""The sums of the kernels over bodies and atoms: kinetic energies, invalid states and heat, in exact fractions."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kernel_functions import U, pairs

from openmm_exactrb.mechanics.divergence import LIGHT

HEAT = 2  # the index of the heat among the numbers of a thermostat
SIZES = st.integers(1, 12)
SEEDS = st.integers(0, 2**32 - 1)


class Bodies:
    """Bodies of two kinds: n with common constants, and n with constants each; the last is linear."""

    def __init__(self, n, seed):
        rng = np.random.default_rng(seed)
        self.n, scales = 2 * n, 10.0 ** rng.uniform(-3, 3, 2 * n)
        self.kind = np.repeat(np.arange(2, dtype=np.int32), n)
        self.kinds = np.array([[0, n, 3, 0, 0, 0, 0, 1], [n, n, 3, 3 * n, 3, 3, 1, 2]], np.int32)
        rows = np.array([1, *range(2, 2 + n)])  # the first row belongs to no body
        self.constants = rng.uniform(0.01, 2.0, (2 + n, 12))
        self.constants[-1, 4] = 0.0
        self.of_body = self.constants[np.concatenate([np.full(n, rows[0]), rows[1:]])]
        self.R, self.P, self.L = (pairs(scales * rng.standard_normal((3, 2 * n)), 1e-20) for _ in range(3))
        self.q = pairs(rng.standard_normal((4, 2 * n)))
        self.heat = rng.standard_normal(2 * n)

    def sums(self, kernels, place=HEAT):
        """Return the four sums."""
        out, state = np.full(4, np.nan), [np.ascontiguousarray(a) for a in (self.R, self.P, self.q, self.L)]
        kernels("kinetic", self.n, place, self.kind, self.kinds, self.constants, *state, self.heat, out)
        return out


def energy_of(momenta, rates):
    """Return the exact kinetic energy of momenta (3, n), with reciprocal masses or moments (3, n)."""
    terms = zip(momenta.ravel().tolist(), rates.ravel().tolist(), strict=True)
    return sum(Fraction(x) ** 2 * Fraction(rate) for x, rate in terms) / 2


@given(n=SIZES, seed=SEEDS)
def test_kinetic_energies_and_the_heat_are_sums_over_bodies(kernels, n, seed):
    bodies = Bodies(n, seed)
    heat = bodies.heat.copy()
    found = bodies.sums(kernels)
    rates = np.broadcast_to(bodies.of_body[:, 7], (3, bodies.n)), bodies.of_body[:, 4:7].T
    for got, momenta, rate in zip(found, (bodies.P, bodies.L), rates, strict=False):
        expected = energy_of(momenta[..., 0], rate)
        assert abs(Fraction(got) - expected) <= (bodies.n + 6) * Fraction(U) * expected
    assert found[2] == 0.0
    assert found[3] == pytest.approx(math.fsum(heat), abs=bodies.n * U * np.abs(heat).sum())
    assert not bodies.heat.any()


def test_heat_is_left_where_no_thermostat_has_any(kernels):
    bodies = Bodies(3, 0)
    heat = bodies.heat.copy()
    assert bodies.sums(kernels, place=-1)[3] == 0.0
    np.testing.assert_array_equal(bodies.heat, heat)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e160])
@pytest.mark.parametrize("name", ["R", "P", "q", "L"])
def test_bodies_whose_state_is_not_finite_are_counted(kernels, name, value):
    bodies = Bodies(4, 1)
    state = getattr(bodies, name)
    state[-1, [2, 5], 0] = value
    assert bodies.sums(kernels)[2] == 2.0


@pytest.mark.parametrize(("part", "invalid"), [(1.0 - 1e-9, 0.0), (1.0 + 1e-9, 1.0)])
def test_bodies_that_are_faster_than_light_are_counted(kernels, part, invalid):
    bodies = Bodies(4, 2)
    bodies.P[:, 6, 0] = part * LIGHT / bodies.of_body[6, 7] * np.array([0.6, -0.8, 0.0])
    assert bodies.sums(kernels)[2] == invalid


@pytest.mark.parametrize("place", [HEAT, -1])
@pytest.mark.parametrize("adds", [0, 1])
def test_sums_of_a_part_are_written_or_added_to_the_totals(kernels, adds, place):
    sums, totals, own = np.array([1.0, 2.0, 3.0, 4.0]), np.array([10.0, 20.0, 30.0]), np.array([5.0, 6.0, 7.0])
    kernels("total", place, sums, totals, own, adds)
    np.testing.assert_array_equal(totals, sums[:3] + adds * np.array([10.0, 20.0, 30.0]))
    np.testing.assert_array_equal(own, [5.0, 6.0, 11.0 if place >= 0 else 7.0])


# -- flexible molecules -----------------------------------------------------------------------------------------------


def sums_of_atoms(kernels, inverse, x, v, heat):
    out = np.full(4, np.nan)
    kernels("flexible_kinetic", len(inverse), HEAT, inverse, pairs(x), pairs(v), heat, out)
    return out


@given(n=SIZES, seed=SEEDS)
def test_kinetic_energies_and_the_heat_are_sums_over_atoms(kernels, n, seed):
    rng = np.random.default_rng(seed)
    inverse, x, v, heat = rng.uniform(0.005, 1.0, n), *rng.standard_normal((2, n, 3)), rng.standard_normal(n)
    inverse[n // 2] = 0.0  # an atom without mass
    before = heat.copy()
    found = sums_of_atoms(kernels, inverse, x, v, heat)
    rows = ((1 / Fraction(w), row) for w, row in zip(inverse.tolist(), v.tolist(), strict=True) if w)
    expected = sum((mass * sum(Fraction(c) ** 2 for c in row) for mass, row in rows), Fraction(0)) / 2
    assert abs(Fraction(found[0]) - expected) <= (n + 6) * Fraction(U) * expected
    assert found[1] == found[2] == 0.0
    assert found[3] == pytest.approx(math.fsum(before), abs=n * U * np.abs(before).sum())
    assert not heat.any()


def test_invalid_atoms_are_counted(kernels):
    x, v = np.zeros((2, 6, 3))
    x[0, 1], x[1, 2], v[2, 0], v[3, 1] = np.nan, np.inf, np.nan, 1.1 * LIGHT
    v[4, 1] = 0.9 * LIGHT
    assert sums_of_atoms(kernels, np.ones(6), x, v, np.zeros(6))[2] == 4.0
