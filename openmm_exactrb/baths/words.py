"""Words of steps with a bath: about a splitting, within it, or about a proposal."""

from __future__ import annotations

import itertools
from dataclasses import replace

from openmm_exactrb.schemes.catalogue import scheme as look_up
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import BATH, DRIFT, KICK, Word, palindromic, repeated, spelled

#: The letter of a proposal with Metropolis's decision.
PROPOSAL = "X"

_PARTICLES = "B. Leimkuhler and C. Matthews, J. Chem. Phys. 138, 174102 (2013), doi:10.1063/1.4802990, for particles"
_MIDDLE = "Z. Zhang et al., J. Phys. Chem. A 123, 6056 (2019), doi:10.1021/acs.jpca.9b02771, for particles"
_CANONICAL = "openmm-exactrb, for equipartition and the density of rigid water at 4 to 6 fs per force evaluation"


def _three_kicks(outer: float) -> Word:
    """Return three kicks about a drift with a bath in its middle; a step ends between the bath and the first kick.

    Of the drifts `outer` is the one on each side of the bath. Of the kicks the middle one has the part with which the
    step touches the bound of stability at half a period of an oscillator, and does not cross it.
    """
    inner, middle = 0.5 - outer, (1.0 - 4.0 * outer) / (2.0 - 6.0 * outer)
    kick = 0.5 * (1.0 - middle)
    bath = (DRIFT, outer), (BATH, 1.0), (DRIFT, outer)
    return (KICK, kick), (DRIFT, inner), (KICK, middle), (DRIFT, inner), (KICK, kick), *bath


#: Splittings with a bath within them. Those of Leimkuhler and Matthews need one force per step, as does BAOA, the word
#: of OpenMM's LangevinMiddleIntegrator. With an outer drift of 0.135 momenta next to the bath are canonical within half
#: a percent up to 160/ps at 6 fs per force: tests/baths/test_bath_words.py.
WITHIN = {
    scheme.name: scheme
    for scheme in (
        Scheme("BAOAB", 2, spelled("B A O A B"), reference=_PARTICLES),
        Scheme("ABOBA", 2, spelled("A B O B A"), reference=_PARTICLES),
        Scheme("BAOA", 2, spelled("B A O A"), reference=_MIDDLE),
        Scheme("W2_3m", 2, _three_kicks(0.135), reference=_CANONICAL),
    )
}


def splitting(name: str | Scheme) -> Scheme:
    """Look a splitting up that a bath can be joined to: one of the catalogue or of `WITHIN`.

    Raises
    ------
    ValueError
        If there is none of this name, or it is a processed scheme: a bath acts on the true state, at every step.
    """
    if isinstance(name, str) and name in WITHIN:
        return WITHIN[name]
    try:
        found = look_up(name)
    except ValueError as error:
        raise ValueError(f"{error}, or with the bath within it {', '.join(WITHIN)}") from None
    if found.processor:
        raise ValueError(
            f"scheme {found.name} prepares the state before a run and finishes it after, but a bath acts on the true "
            "state at every step: choose a scheme without a processor, such as S2_2"
        )
    return found


def numbered(word: Word) -> Word:
    """Give each letter of a bath its number in the step, O0, O1, ...: no two of them get the same noise."""
    numbers = itertools.count()
    return tuple((f"{BATH}{next(numbers)}" if letter == BATH else letter, part) for letter, part in word)


def with_bath(scheme: Scheme) -> Scheme:
    """Return a scheme with a bath: half of it before and half after each step, unless the word has it already."""
    if any(letter == BATH for letter, _ in scheme.word):
        return replace(scheme, word=numbered(scheme.word))
    return replace(scheme, word=numbered(_between_halves(scheme.word)))


def with_proposals(scheme: Scheme) -> Scheme:
    """Return a scheme whose step is a proposal between two halves of a bath."""
    return replace(scheme, word=numbered(_between_halves(((PROPOSAL, 1.0),))), gradients=())


def proposal(scheme: Scheme, steps: int) -> Scheme:
    """Return a scheme whose step is made of so many steps of another one.

    Raises
    ------
    ValueError
        If it is not symmetric in time, or has a bath in it: Metropolis's rule needs both.
    """
    if any(letter == BATH for letter, _ in scheme.word):
        raise ValueError(f"{scheme.name} has a bath within it, but a proposal has none: choose a scheme such as S2_2")
    if not palindromic(scheme.word):
        raise ValueError(f"scheme {scheme.name} is not symmetric in time, as proposals must be: choose one that is")
    word = repeated(scheme.word, steps)
    return replace(scheme, word=tuple((letter, part / steps) for letter, part in word))


def _between_halves(word: Word) -> Word:
    return (BATH, 0.5), *word, (BATH, 0.5)
