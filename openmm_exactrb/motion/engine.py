"""The loop over the letters of a word, and the words that a number of steps is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import Word

_S = TypeVar("_S")

#: flow(state, tau) moves a state by the time tau; it may return the state itself, and does not change what it is given.
Flow = Callable[[_S, float], _S]


def run(word: Word, flows: Mapping[str, Flow[_S]], state: _S, h: float) -> _S:
    """Carry a word out.

    Parameters
    ----------
    word : Word
    flows : mapping
        What each letter does: ``flow(state, tau)`` returns the state moved by the time tau.
    state : object
    h : float
        Size of the step.

    Raises
    ------
    KeyError
        If a letter has no flow.
    """
    for letter, part in word:
        state = flows[letter](state, part * h)
    return state


def steps(scheme: Scheme, n: int, alone: bool = False) -> Iterator[tuple[Word, bool]]:
    """Yield the words of n steps, each with whether the state behind it is that of the problem.

    It is not within a processed scheme, which prepares the state before the first step and finishes it after the last.

    Parameters
    ----------
    scheme : Scheme
    n : int
    alone : bool
        Whether each step is prepared and finished by itself, because something follows it that needs the true state.
    """
    alone = alone or not scheme.processor
    for number in range(n):
        begins, ends = alone or number == 0, alone or number == n - 1
        yield scheme.processor * begins + scheme.word + scheme.postprocessor * ends, ends
