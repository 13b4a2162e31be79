"""Words of steps with a bath: about a splitting, within it, or about a proposal."""

from __future__ import annotations

import itertools
from dataclasses import replace

from openmm_exactrb.schemes import Scheme, scheme_for_bath
from openmm_exactrb.schemes.word import BATH, Word, palindromic, repeated

#: The letter of a proposal with Metropolis's decision.
PROPOSAL = "X"


def splitting(name: str | Scheme) -> Scheme:
    """Look a splitting up that a bath can be joined to: one of the catalogue, or one with a bath within it.

    Raises
    ------
    ValueError
        If there is none of this name, or it is a processed scheme: a bath acts on the true state, at every step.
    """
    found = scheme_for_bath(name)
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


def refuse_lopsided_inner(inner: Scheme | None) -> None:
    """Refuse an inner scheme that makes proposals which are not symmetric in time.

    Raises
    ------
    ValueError
        If it is not symmetric itself.
    """
    if inner is not None and not palindromic(inner.word):
        raise ValueError(
            f"the inner scheme {inner.name} is not symmetric in time, as proposals must be: choose one that is"
        )


def _between_halves(word: Word) -> Word:
    return (BATH, 0.5), *word, (BATH, 0.5)
