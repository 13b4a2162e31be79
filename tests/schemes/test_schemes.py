"""Tables are closed and symmetric, schemes say what is wrong with them, and the catalogue finds them."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import openmm_exactrb as rb
from openmm_exactrb import schemes
from openmm_exactrb.schemes import WITH_THERMOSTAT, Scheme, force_gradient, saba, sbab, symmetric
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.steps.substeps import DRIFT, KICK
from orders import composes_verlet
from sequences import advanced, gradient_kicks


def test_coefficients_sum_to_one_and_are_palindromes(scheme):
    for table in (scheme.a, scheme.b):
        assert table == table[::-1]
        assert abs(sum(table) - 1.0) < 1e-15
    assert scheme.stages == len(scheme.b) - (scheme.first == "kick")


@pytest.mark.parametrize(
    ("name", "stages"), [("V2", 1), ("V2_drift", 1), ("S6_10", 10), ("SRKN4_6b", 6), ("SRKN6_14a", 14)]
)
def test_stages_are_those_of_the_paper(name, stages):
    assert rb.SCHEMES[name].stages == stages


def test_no_force_is_evaluated_twice(scheme):
    kicks = []
    advanced(scheme, lambda place, tau: place + 1, lambda place, tau: kicks.append((place, tau)) or place, 0, 0.1, 7)
    assert len({place for place, _ in kicks}) == 7 * scheme.stages + (scheme.first == "kick") + scheme.processing
    assert abs(sum(tau for _, tau in kicks) - 0.7) < 1e-14


def test_no_step_does_nothing(scheme):
    assert advanced(scheme, None, None, "state", 0.1, 0) == "state"


@given(n=st.integers(0, 4), h=st.floats(-1.0, 1.0), name=st.sampled_from(list(rb.SCHEMES)))
def test_steps_advance_both_flows_by_the_time(n, h, name):
    drift, kick = (lambda s, tau: (s[0] + tau, s[1])), (lambda s, tau: (s[0], s[1] + tau))
    moved = advanced(rb.SCHEMES[name], drift, kick, (0.0, 0.0), h, n)
    np.testing.assert_allclose(moved, (n * h, n * h), rtol=0.0, atol=1e-13)


@given(
    stages=st.integers(1, 12),
    first=st.sampled_from(["drift", "kick"]),
    coefficients=st.lists(st.floats(-10.0, 10.0), min_size=12, max_size=12),
)
def test_every_table_is_closed_to_a_palindrome_of_sum_one(stages, first, coefficients):
    free = {table: (stages + (table == first) - 1) // 2 for table in ("drift", "kick")}
    a, b = coefficients[: free["drift"]], coefficients[: free["kick"]]
    scheme = symmetric("any", order=2, stages=stages, first=first, a=a, b=b)
    for table in (scheme.a, scheme.b):
        assert table == table[::-1]
        np.testing.assert_allclose(sum(table), 1.0, rtol=0.0, atol=1e-13)
    assert look_up(scheme) is scheme
    sizes = coefficients[: (stages - 1) // 2]
    if stages % 2:
        composed = schemes.composition("any", order=2, steps=sizes, stages=stages, reference="")
        assert composes_verlet(composed)
    with pytest.raises(ValueError, match="must be finite"):
        symmetric("any", order=2, stages=3, first=first, a=(np.inf,), b=(np.inf,) * (first == "drift"))


def test_nodes_are_generated_for_any_number():
    for n in range(1, 30):
        for name in (f"SABA_{n}", f"SBAB_{n}"):
            scheme = look_up(name)
            times = np.cumsum([c if substep == DRIFT else 0.0 for substep, c in scheme.sequence])
            kicks = np.array([c if substep == KICK else 0.0 for substep, c in scheme.sequence])
            assert scheme.stages == n
            for power in range(2 * n):
                np.testing.assert_allclose(kicks @ times**power, 1.0 / (power + 1), rtol=1e-12)
    with pytest.raises(ValueError, match="must be at least 1"):
        saba(0)
    with pytest.raises(ValueError, match="must be at least 1"):
        sbab(0)


@given(name=st.text(max_size=8))
def test_unknown_schemes_are_refused(name):
    assume(name not in {*rb.SCHEMES, *WITH_THERMOSTAT})
    assume(not name.startswith("S"))
    with pytest.raises(ValueError, match=r"(?s)the scheme .* is unknown.*ll names are in openmm_exactrb.SCHEMES"):
        look_up(name)


def test_stages_and_forces_of_sequences_with_more_substeps():
    """Kicks of two groups at one place are one stage, and a force-gradient kick takes forces at one place more."""
    thermostatted = Scheme("BAOAB", 2, schemes.spelled("B A O A B"))
    assert (thermostatted.stages, thermostatted.first) == (1, "kick")
    groups = Scheme("groups", 2, schemes.spelled("B0 B1 A B1 B0"))
    assert groups.stages == 1
    takahashi = rb.SCHEMES["TI2"]
    assert (takahashi.stages, takahashi.forces) == (1, 2)
    assert takahashi.c == (-1.0 / 24.0,)
    assert (rb.SCHEMES["Chin4A"].stages, rb.SCHEMES["Chin4A"].forces) == (2, 3)
    assert rb.SCHEMES["G4_7"].forces == 7


def test_force_gradients_are_built_from_the_pattern_of_a_step():
    numbers = {"order": 2, "a": (0.2,), "b": (0.1, 0.3), "e": (0.02, 0.03)}
    twice = force_gradient("twice", "CABACABAC", **numbers, magnification=1.0)
    outer, middle = gradient_kicks(twice)
    half = [outer, DRIFT, KICK, DRIFT]
    assert [substep for substep, _ in twice.sequence] == [*half, middle, *half[::-1]]
    assert twice.a == pytest.approx((0.2, 0.3, 0.3, 0.2))
    assert twice.b == pytest.approx((0.1, 0.3, 0.2, 0.3, 0.1))
    assert [kick.strength for kick in (outer, middle)] == pytest.approx([0.02 / 0.1**2, 0.03 / 0.2**2])
    magnified = force_gradient("twice", "CABACABAC", **numbers, magnification=8.0)
    for ours, theirs in ((magnified.a, twice.a), (magnified.b, twice.b), (magnified.c, twice.c)):
        assert ours == pytest.approx(theirs, rel=1e-14)
    assert magnified.forces == twice.forces
    kicks = zip(gradient_kicks(magnified), twice.b[0:3:2], strict=True)
    displaced = [kick.strength * 8.0**2 * b**2 for kick, b in kicks]
    assert displaced == pytest.approx([0.02 / 8.0, 0.03 / 8.0], rel=1e-14)
    for pattern in ("BACA", "BBACABB", "A", "BAXAB", ""):
        with pytest.raises(ValueError, match=f"'{pattern}' is not a palindrome"):
            force_gradient("wrong", pattern, order=2)
    for magnification in (0.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="magnification must be"):
            force_gradient("wrong", "ACA", order=2, e=(0.1,), magnification=magnification)
    with pytest.raises(ValueError, match="coefficients e must be finite"):
        force_gradient("wrong", "ACA", order=2, e=(np.nan,))
    with pytest.raises(ValueError, match=r"the length of e must be \d, not 2: pass one number for each C"):
        force_gradient("wrong", "BACAB", order=2, b=(0.1,), e=(0.1, 0.2))


@pytest.mark.parametrize(
    ("text", "stages", "first"),
    [
        ("O B A B O", 1, "kick"),
        ("O A B A O", 1, "drift"),
        ("O B A B A B O", 2, "kick"),
        ("B O A O B", 1, "kick"),
        ("O B A O B A", 2, "kick"),
        ("B A O A", 1, "kick"),
        ("A O B O A", 1, "drift"),
        ("O", 0, "kick"),
    ],
)
def test_a_thermostat_at_the_ends_of_a_step_needs_no_forces(text, stages, first):
    """The places are those of the kick before it: counted by those at which a long run is kicked."""
    scheme = Scheme(text, 2, schemes.spelled(text))
    assert (scheme.stages, scheme.forces, scheme.first) == (stages, stages, first)
    places = itertools.accumulate(symbol == "A" for symbol in text.split() * 100)
    kicked = {place for symbol, place in zip(text.split() * 100, places, strict=True) if symbol == "B"}
    assert 100 * stages <= len(kicked) <= 100 * stages + 1
