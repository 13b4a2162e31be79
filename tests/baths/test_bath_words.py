"""Words of steps with a bath."""

import math

import pytest

import openmm_exactrb as rb
from openmm_exactrb.baths import words
from openmm_exactrb.schemes import WITH_BATH
from openmm_exactrb.schemes.word import merged, palindromic

PLAIN = [scheme for scheme in rb.SCHEMES.values() if not scheme.processor]


@pytest.mark.parametrize("scheme", [*PLAIN, *WITH_BATH.values()], ids=lambda scheme: scheme.name)
def test_steps_have_one_bath_of_the_whole_step_and_read_the_same_from_behind(scheme):
    """From bath to bath, wherever a step ends."""
    word = words.with_bath(scheme).word
    baths = [(letter, part) for letter, part in word if letter[0] == "O"]
    assert math.fsum(part for _, part in baths) == 1.0
    assert [letter for letter, _ in baths] == [f"O{k}" for k in range(len(baths))]
    first = word.index(baths[0])
    between = word[first + 1 :] + word[:first]
    assert palindromic(merged((letter, part) for letter, part in between if letter[0] != "O"))


@pytest.mark.parametrize("scheme", PLAIN, ids=lambda scheme: scheme.name)
@pytest.mark.parametrize("steps", [1, 3])
def test_a_proposal_of_some_steps_fills_the_same_time(scheme, steps):
    found = words.proposal(scheme, steps)
    for letter in {letter for letter, _ in scheme.word}:
        whole = math.fsum(part for name, part in scheme.word if name == letter)
        assert math.fsum(part for name, part in found.word if name == letter) == pytest.approx(whole, abs=1e-14)
    assert found.forces == steps * scheme.forces
    (_, first), (name, part), (_, last) = words.with_proposals(found).word
    assert (first, name, part, last) == (0.5, words.PROPOSAL, 1.0, 0.5)
