"""Words of steps with a bath."""

import math

import pytest

import openmm_exactrb as rb
from openmm_exactrb.baths import words
from openmm_exactrb.schemes import shadow, stability_limit
from openmm_exactrb.schemes.word import merged, palindromic

PLAIN = [scheme for scheme in rb.SCHEMES.values() if not scheme.processor]


@pytest.mark.parametrize("scheme", [*PLAIN, *words.WITHIN.values()], ids=lambda scheme: scheme.name)
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


@pytest.mark.parametrize(("name", "momenta", "places"), [("BAOAB", 1 / 6, -1 / 12), ("BAOA", -1 / 12, -1 / 12)])
def test_the_shadow_of_a_word_with_a_bath_is_that_of_its_splitting(name, momenta, places):
    """Leapfrog: the momenta of whole steps look cold, those of half steps hot, and its places are too wide."""
    found = shadow(words.WITHIN[name], 0.01)
    assert [(part - 1.0) / 0.01**2 for part in found] == pytest.approx([momenta, places], abs=2e-5)


def test_w2_3m_has_canonical_momenta_up_to_fast_librations():
    """Half a percent up to 160/ps at 6 fs per force, and it passes half a period of an oscillator, at 166/ps."""
    scheme = words.WITHIN["W2_3m"]
    for frequency in (20.0, 50.0, 80.0, 110.0, 130.0, 145.0, 160.0):
        assert shadow(scheme, 0.018 * frequency).kinetic == pytest.approx(1.0, abs=0.005)
    assert stability_limit(scheme) == pytest.approx(4.807, abs=0.002)  # 267/ps
    assert shadow(words.WITHIN["BAOA"], 0.006 * 130.0).kinetic < 0.95
