"""Words: a step is a row of letters, each with its part of the step.

A letter stands for a flow, the motion under one part of the Hamiltonian or under a bath. What a letter does is told
elsewhere, by a table from letters to flows; a word is data, which can be inverted, merged, repeated and nested.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable

#: Pairs of a letter and its part of the step, in the order of their use.
Word = tuple[tuple[str, float], ...]

#: The letters of the package: the flow of the kinetic energy; of the potential; of the potential with a force-gradient
#: term; a heat bath; and what OpenMM itself does between steps.
DRIFT, KICK, GRADIENT, BATH, OPENMM = "A", "B", "C", "O", "M"


def inverse(word: Word) -> Word:
    """Return the word that undoes another one."""
    return tuple((letter, -part) for letter, part in reversed(word))


def is_kick(letter: str) -> bool:
    """Tell whether a letter changes momenta by what places are, so that it commutes with its like."""
    return letter.startswith((KICK, GRADIENT))


def palindromic(word: Word) -> bool:
    """Tell whether a word reads the same from behind, where kicks without a letter between them are in any order."""
    pairs = zip(_in_order(word), _in_order(word[::-1]), strict=True)
    return all(a == b and math.isclose(i, j, rel_tol=1e-14) for (a, i), (b, j) in pairs)


def _in_order(word: Word) -> Word:
    """Return a word with the kicks between two other letters in one order."""
    places = ((kicks, list(some)) for kicks, some in itertools.groupby(word, lambda row: is_kick(row[0])))
    return tuple(itertools.chain(*(sorted(some) if kicks else some for kicks, some in places)))


def merged(word: Iterable[tuple[str, float]]) -> Word:
    """Make one letter of neighbours that are the same."""
    letters: list[tuple[str, float]] = []
    for letter, part in word:
        if letters and letters[-1][0] == letter and letter.startswith((DRIFT, KICK, BATH)):
            part += letters.pop()[1]
        letters.append((letter, part))
    return tuple(letters)


def repeated(word: Word, n: int) -> Word:
    """Return n steps, where neighbouring steps share their outer letter."""
    return merged(word * n)


def nested(outer: Word, letter: str, inner: Word, n: int | Callable[[float], int]) -> Word:
    """Put n repetitions of a word in the place of a letter: multiple time steps.

    Parameters
    ----------
    outer : Word
    letter : str
        Which letter of `outer` gives way.
    inner : Word
        Its parts are those of the time that it fills.
    n : int or callable
        Repetitions for the part 1 of the letter, or n(part) for each part; at least one for each.
    """
    number = n if callable(n) else lambda part: round(n * part)
    steps: list[tuple[str, float]] = []
    for name, part in outer:
        if name != letter:
            steps.append((name, part))
            continue
        times = max(1, number(abs(part)))
        steps += merged([(small, part / times * share) for _ in range(times) for small, share in inner])
    return merged(steps)


def spelled(text: str) -> Word:
    """Return the word of a text such as "B A O A B": every letter has an equal share of the step.

    Raises
    ------
    ValueError
        If there is no letter.
    """
    letters = text.split()
    if not letters:
        raise ValueError('a word needs letters with blanks between them, such as "B A O A B"')
    return tuple((letter, 1.0 / letters.count(letter)) for letter in letters)


def count(word: Word, letter: str) -> int:
    """Return how often a word has a letter."""
    return sum(name == letter for name, _ in word)
