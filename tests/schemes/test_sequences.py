"""Sequences: what inverting, merging, repeating and spelling make of them, and how they are carried out."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

import openmm_exactrb as rb
from openmm_exactrb.steps.sequence import inverse, merged, palindromic, repeated, run, spelled
from openmm_exactrb.steps.substeps import DRIFT, HEAT_EXCHANGE, KICK, GradientKick, HeatExchange, Kick, Substep

GRADIENT, SLOW, PLACE = GradientKick(0.1), Kick(1), Substep()
SUBSTEPS = [DRIFT, KICK, SLOW, GRADIENT, HEAT_EXCHANGE, HeatExchange(1), PLACE]
SEQUENCES = st.lists(st.tuples(st.sampled_from(SUBSTEPS), st.floats(-1.0, 1.0)), max_size=12).map(tuple)


def noted():
    """Return flows that note what they are asked for in the state, a tuple."""
    return {substep: lambda state, tau, substep=substep: (*state, (substep, tau)) for substep in SUBSTEPS}


def times(sequence):
    """Return for how long each substep acts in all."""
    return {substep: sum(part for other, part in sequence if other == substep) for substep, _ in sequence}


@given(sequence=SEQUENCES, h=st.floats(-2.0, 2.0))
def test_a_sequence_is_carried_out_in_its_order(sequence, h):
    assert run(sequence, noted(), (), h) == tuple((substep, part * h) for substep, part in sequence)


@given(sequence=SEQUENCES)
def test_the_inverse_of_the_inverse_is_the_sequence_and_it_takes_back_all_times(sequence):
    assert inverse(inverse(sequence)) == sequence
    assert all(abs(time) < 1e-14 for time in times(sequence + inverse(sequence)).values())
    assert [substep for substep, _ in inverse(sequence)] == [substep for substep, _ in sequence[::-1]]


@given(sequence=SEQUENCES)
def test_merged_sequences_have_the_same_times_and_no_neighbours_that_could_be_one(sequence):
    short = merged(sequence)
    for substep, time in times(sequence).items():
        assert times(short)[substep] == pytest.approx(time, abs=1e-14)
    for (one, _), (other, _) in pairwise(short):
        assert one != other or one in (GRADIENT, PLACE)
    assert merged(short) == short


def test_force_gradient_kicks_and_substeps_that_are_no_flows_are_not_merged():
    """Two of the first are no longer one; the second is done as often as it is said."""
    twice = (GRADIENT, 0.5), (GRADIENT, 0.5), (PLACE, 1.0), (PLACE, 1.0)
    assert merged(twice) == twice
    assert merged(((SLOW, 0.5), (KICK, 0.5), (SLOW, 0.5))) == ((SLOW, 0.5), (KICK, 0.5), (SLOW, 0.5))
    apart = (HeatExchange(0), 0.5), (HeatExchange(1), 0.5)  # each has random numbers of its own
    assert merged(apart) == apart


@given(name=st.sampled_from(list(rb.SCHEMES)), n=st.integers(0, 5))
def test_repeated_steps_share_their_outer_substep(name, n):
    scheme = rb.SCHEMES[name]
    sequence = repeated(scheme.sequence, n)
    assert len(sequence) == (len(scheme.sequence) - 1) * n + 1 if n else not sequence
    assert sum(part for substep, part in sequence if substep == DRIFT) == pytest.approx(n, abs=1e-13)


def test_a_text_is_a_sequence_whose_substeps_have_equal_shares():
    half = 0.5
    assert spelled("B A O A B") == ((KICK, half), (DRIFT, half), (HEAT_EXCHANGE, 1.0), (DRIFT, half), (KICK, half))
    assert spelled("B1 A A A B1")[1:4] == ((DRIFT, 1.0 / 3.0),) * 3
    assert spelled("B1 A B1")[0] == (SLOW, 0.5)
    with pytest.raises(ValueError, match='substeps separated by spaces, such as "B A O A B"'):
        spelled("  ")


def test_a_sequence_reads_the_same_from_behind_up_to_kicks_that_commute():
    assert palindromic(((DRIFT, 0.5), (KICK, 1.0), (DRIFT, 0.5)))
    assert palindromic(((DRIFT, 0.5), (KICK, -3.0), (GRADIENT, 4.0), (DRIFT, 0.5)))
    assert palindromic(((KICK, 0.5), (SLOW, 0.5), (DRIFT, 1.0), (KICK, 0.5), (SLOW, 0.5)))
    assert not palindromic(((DRIFT, 0.4), (KICK, 1.0), (DRIFT, 0.6)))
    assert not palindromic(((KICK, 0.5), (DRIFT, 0.5), (GRADIENT, 0.5), (DRIFT, 0.5)))
    assert not palindromic(((HEAT_EXCHANGE, 0.5), (KICK, 1.0), (DRIFT, 0.5), (HEAT_EXCHANGE, 0.5)))
    assert not palindromic(((GradientKick(0.1), 0.5), (DRIFT, 1.0), (GradientKick(0.2), 0.5)))
