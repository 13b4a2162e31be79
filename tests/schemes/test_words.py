"""Words: what inverting, merging, repeating, nesting and spelling make of them, and the loop that carries them out."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import openmm_exactrb as rb
from openmm_exactrb.motion.engine import run, steps
from openmm_exactrb.schemes.word import count, inverse, merged, nested, palindromic, repeated, spelled

LETTERS = st.sampled_from(["A", "B", "B1", "C", "O", "M", "F"])
WORDS = st.lists(st.tuples(LETTERS, st.floats(-1.0, 1.0)), max_size=12).map(tuple)


def noted(letters="ABCOMF"):
    """Return flows that note what they are asked for in the state, a tuple."""
    names = [*letters, "B1"]
    return {name: lambda state, tau, name=name: (*state, (name, tau)) for name in names}


def times(word):
    """Return for how long each letter acts in all."""
    return {letter: sum(part for name, part in word if name == letter) for letter, _ in word}


@given(word=WORDS, h=st.floats(-2.0, 2.0))
def test_the_loop_does_what_the_word_says_in_its_order(word, h):
    assert run(word, noted(), (), h) == tuple((letter, part * h) for letter, part in word)


def test_a_letter_without_a_flow_is_an_error():
    with pytest.raises(KeyError, match="F"):
        run((("F", 1.0),), {"A": None}, None, 0.1)


@given(word=WORDS)
def test_the_inverse_of_the_inverse_is_the_word_and_it_takes_back_all_times(word):
    assert inverse(inverse(word)) == word
    assert all(abs(time) < 1e-14 for time in times(word + inverse(word)).values())
    assert [letter for letter, _ in inverse(word)] == [letter for letter, _ in word[::-1]]


@given(word=WORDS)
def test_merged_words_have_the_same_times_and_no_neighbours_that_could_be_one(word):
    short = merged(word)
    for letter, time in times(word).items():
        assert times(short)[letter] == pytest.approx(time, abs=1e-14)
    for (one, _), (other, _) in pairwise(short):
        assert one != other or one[0] not in "ABO"
    assert merged(short) == short


def test_force_gradient_kicks_and_what_openmm_does_are_not_merged():
    """Two of the first are no longer one; the second is done as often as it is said."""
    assert merged((("C", 0.5), ("C", 0.5), ("M", 1.0), ("M", 1.0))) == (("C", 0.5),) * 2 + (("M", 1.0),) * 2
    assert merged((("B1", 0.5), ("B", 0.5), ("B1", 0.5))) == (("B1", 0.5), ("B", 0.5), ("B1", 0.5))


@given(name=st.sampled_from(list(rb.SCHEMES)), n=st.integers(0, 5))
def test_repeated_steps_share_their_outer_letter(name, n):
    scheme = rb.SCHEMES[name]
    word = repeated(scheme.word, n)
    assert len(word) == (len(scheme.word) - 1) * n + 1 if n else not word
    assert sum(part for letter, part in word if letter == "A") == pytest.approx(n, abs=1e-13)


def test_a_text_is_a_word_whose_letters_have_equal_shares():
    half = 0.5
    assert spelled("B A O A B") == (("B", half), ("A", half), ("O", 1.0), ("A", half), ("B", half))
    assert spelled("B1 A A A B1")[1:4] == (("A", 1.0 / 3.0),) * 3
    with pytest.raises(ValueError, match='letters with blanks between them, such as "B A O A B"'):
        spelled("  ")


def test_letters_are_counted_by_their_whole_name():
    assert count(spelled("B1 A B A B1"), "B1") == 2
    assert count(spelled("B1 A B A B1"), "B") == 1


@given(n=st.integers(1, 6))
def test_a_nested_word_fills_the_time_of_the_letter_that_gives_way(n):
    """r-RESPA: slow kicks of group 1 outside, n Verlet steps with the fast forces inside."""
    word = nested(spelled("B1 D B1"), "D", spelled("B0 A B0"), n)
    assert times(word) == pytest.approx({"B1": 1.0, "B0": 1.0, "A": 1.0})
    assert [letter for letter, _ in word] == ["B1", *["B0", "A"] * n, "B0", "B1"]
    assert word[1][1] == pytest.approx(0.5 / n)


def test_a_letter_of_a_part_of_the_step_gets_its_share_of_repetitions_and_never_none():
    inner = spelled("B0 A B0")
    outer = (("D", 0.5), ("B1", 1.0), ("D", 0.5))
    assert count(nested(outer, "D", inner, 4), "A") == 4
    assert count(nested(outer, "D", inner, 1), "A") == 2
    backward = nested((("D", -0.5),), "D", inner, 4)
    assert times(backward) == pytest.approx({"A": -0.5, "B0": -0.5})
    assert nested(outer, "X", inner, 3) == outer


def test_nested_steps_of_a_harmonic_oscillator_are_those_written_by_hand():
    flows = {
        "A": lambda s, tau: (s[0] + tau * s[1], s[1]),
        "B0": lambda s, tau: (s[0], s[1] - 9.0 * tau * s[0]),
        "B1": lambda s, tau: (s[0], s[1] - tau * s[0]),
    }
    got = run(nested(spelled("B1 D B1"), "D", spelled("B0 A B0"), 3), flows, (1.0, 0.2), 0.3)
    x, v = 1.0, 0.2
    v -= 0.15 * x
    for _ in range(3):
        v -= 0.05 * 9.0 * x
        x += 0.1 * v
        v -= 0.05 * 9.0 * x
    v -= 0.15 * x
    np.testing.assert_allclose(got, (x, v), rtol=1e-14)


@pytest.mark.parametrize("alone", [False, True])
def test_the_steps_of_a_run_say_when_their_state_is_that_of_the_problem(scheme, alone):
    made = list(steps(scheme, 3, alone))
    wholes = [whole for _, whole in made]
    if scheme.processor and not alone:
        assert wholes == [False, False, True]
        assert sum((word for word, _ in made), ()) == scheme.processor + scheme.word * 3 + scheme.postprocessor
    else:
        assert all(wholes)
        assert [word for word, _ in made] == [scheme.processor + scheme.word + scheme.postprocessor] * 3


def test_a_word_reads_the_same_from_behind_up_to_kicks_that_commute():
    assert palindromic((("A", 0.5), ("B", 1.0), ("A", 0.5)))
    assert palindromic((("A", 0.5), ("B", -3.0), ("C", 4.0), ("A", 0.5)))
    assert not palindromic((("A", 0.4), ("B", 1.0), ("A", 0.6)))
    assert not palindromic((("B", 0.5), ("A", 0.5), ("C", 0.5), ("A", 0.5)))
    assert not palindromic((("O", 0.5), ("B", 1.0), ("A", 0.5), ("O", 0.5)))
