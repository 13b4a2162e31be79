"""A splitting scheme: a word with promises, and the ways to build one from a table of coefficients.

A step of size h alternates drifts, the flow of T over a_i h, with kicks, the flow of V over b_i h. A table holds the
free coefficients only: each scheme is a palindrome, and sum(a) = sum(b) = 1 gives the rest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from openmm_exactrb.schemes.word import DRIFT, GRADIENT, KICK, Word, count, inverse, is_kick, palindromic

Kind = Literal["general", "nystroem"]
Outer = Literal["drift", "kick"]
_NAMES = {DRIFT: "drift", KICK: "kick"}


@dataclass(frozen=True)
class Scheme:
    """A symmetric splitting scheme.

    Attributes
    ----------
    name : str
    order : int
        Order in the step size.
    word : Word
        The letters of one step with their parts: "A" drifts, "B" kicks, and "C" kicks with a force-gradient term.
    kind : {"general", "nystroem"}
        A Nyström scheme needs a kinetic energy that is quadratic in the momenta.
    reference : str
    generalised : tuple of int
        Generalised orders, where the scheme is made for a small V; else empty.
    processor : Word
        Letters that prepare the state before the first step; their inverse follows the last. Only then is the state
        that of the problem, and its energy of the accuracy promised.
    gradients : tuple of (letter, strength)
        Of each letter that is a force-gradient kick: over the time tau it is the flow of
        V - (strength/2) tau² f . M^-1 f, where f is the force of V and M the mass.

    Raises
    ------
    ValueError
        If the word is empty, or has a force-gradient kick of no strength.
    """

    name: str
    order: int
    word: Word
    kind: Kind = "general"
    reference: str = ""
    generalised: tuple[int, ...] = ()
    processor: Word = ()
    gradients: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if not self.word:
            raise ValueError(f"scheme {self.name}: the word of a step is empty")
        strengths = dict(self.gradients)
        for letter, _ in self.word:
            if letter.startswith(GRADIENT) and letter not in strengths:
                raise ValueError(f"scheme {self.name}: give the strength of the force-gradient kick {letter!r}")

    def __repr__(self) -> str:
        """Return a line for people: the word itself is `word`."""
        orders = ", ".join(map(str, self.generalised or (self.order,)))
        kind = ", Nyström" if self.kind == "nystroem" else ""
        processed = ", processed" if self.processor else ""
        return (
            f"Scheme({self.name!r}, order {orders}, {self.forces} forces per step, {self.first} first{kind}{processed})"
        )

    @property
    def first(self) -> Outer:
        """What a step starts and ends with, but for a bath."""
        return "drift" if [letter for letter, _ in self._moves()][:1] == [DRIFT] else "kick"

    @property
    def a(self) -> tuple[float, ...]:
        """All coefficients of the drifts, in the order of their use."""
        return tuple(part for letter, part in self.word if letter == DRIFT)

    @property
    def b(self) -> tuple[float, ...]:
        """All coefficients of the kicks, in the order of their use: a sum for each place that is kicked."""
        return tuple(math.fsum(part for _, part in kicks) for kicks in self._kicks())

    @property
    def c(self) -> tuple[float, ...]:
        """Coefficients of force-gradient terms that go with the kicks, as f . M^-1 f over c_i h³; empty without any."""
        strengths = dict(self.gradients)
        terms = (math.fsum(-0.5 * strengths.get(letter, 0.0) * t**3 for letter, t in kicks) for kicks in self._kicks())
        return tuple(terms) if strengths else ()

    def _kicks(self) -> list[list[tuple[str, float]]]:
        """Return the kicks of each place: those without a drift between them."""
        places = itertools.groupby(self._moves(), lambda part: is_kick(part[0]))
        return [list(group) for kicked, group in places if kicked]

    def _moves(self) -> Word:
        """Return the drifts and kicks: forces do not depend on what a bath does between them."""
        return tuple(part for part in self.word if part[0] == DRIFT or is_kick(part[0]))

    @property
    def sequence(self) -> tuple[tuple[str, float], ...]:
        """The word with "drift" and "kick" for its letters."""
        return tuple((_NAMES.get(letter, letter), part) for letter, part in self.word)

    @property
    def stages(self) -> int:
        """Places a step at which forces are evaluated, once the outer stages of neighbouring steps are one."""
        moves = self._moves()
        return len(self._kicks()) - (bool(moves) and is_kick(moves[0][0]) and is_kick(moves[-1][0]))

    @property
    def forces(self) -> int:
        """Force evaluations per step, where the force-gradient kicks take forces at displaced places."""
        return self.stages + sum(count(self.word, letter) for letter, _ in self.gradients)

    @property
    def postprocessor(self) -> Word:
        """The inverse of the processor, for after the last step."""
        return inverse(self.processor)

    @property
    def processing(self) -> int:
        """Force evaluations that the processor and its inverse cost, once a run or an output."""
        return 2 * count(self.processor, KICK)

    @property
    def symmetric(self) -> bool:
        """Whether a step back is the inverse of a step; a processor is symmetric to first order in V only."""
        return not self.processor and palindromic(self.word)

    @property
    def composes_verlet(self) -> bool:
        """Whether a step is a row of Verlet steps, kick first: it keeps its order with drifts of order 2."""
        halves = [0.0, *self.a, 0.0]
        return (
            self.first == "kick"
            and not self.gradients
            and all(abs(b - 0.5 * (i + j)) < 1e-14 for b, i, j in zip(self.b, halves[:-1], halves[1:], strict=True))
        )


def symmetric(
    name: str,
    *,
    order: int,
    stages: int,
    first: Outer,
    a: Sequence[float] = (),
    b: Sequence[float] = (),
    kind: Kind = "general",
    reference: str = "",
    generalised: tuple[int, ...] = (),
) -> Scheme:
    """Build a scheme from its free coefficients.

    Parameters
    ----------
    name, order, stages, kind, first, reference, generalised
        As in `Scheme`.
    a, b : sequence of float
        The coefficients of drifts and kicks before the one that sum(a) = 1 or sum(b) = 1 decides.

    Raises
    ------
    ValueError
        If a table has not as many coefficients as the stages leave free, or holds a number that is not finite.
    """
    lengths = {first: stages + 1, "kick" if first == "drift" else "drift": stages}
    drifts = palindrome(name, "a", a, lengths["drift"])
    kicks = palindrome(name, "b", b, lengths["kick"])
    outer, inner = ((KICK, kicks), (DRIFT, drifts)) if first == "kick" else ((DRIFT, drifts), (KICK, kicks))
    return Scheme(name, order, _alternating(*outer, *inner), kind, reference, generalised)


def _alternating(first: str, outer: Sequence[float], second: str, inner: Sequence[float]) -> Word:
    """Return first, second, first, ... with their parts."""
    word = [(first, outer[0])]
    for i, o in zip(inner, outer[1:], strict=True):
        word += [(second, i), (first, o)]
    return tuple(word)


def processed(
    kernel: Scheme, name: str, *, order: int, a: Sequence[float], b: Sequence[float], reference: str
) -> Scheme:
    """Return a scheme of the steps of another one in other coordinates, which its processor changes to.

    Parameters
    ----------
    kernel : Scheme
        What a step is.
    name, order, reference
        As in `Scheme`, of the kernel and the processor together.
    a, b : sequence of float
        Drifts and kicks of the processor, by turns and a drift first, before the last ones, which make both sums zero.
    """
    drifts, kicks = ((*table, -math.fsum(table)) for table in (a, b))
    processor = tuple(itertools.chain(*zip(((DRIFT, x) for x in drifts), ((KICK, x) for x in kicks), strict=True)))
    return replace(kernel, name=name, order=order, processor=processor, reference=reference)


def palindrome(name: str, table: str, free: Sequence[float], length: int) -> tuple[float, ...]:
    """Close a table of free coefficients to a palindrome of the given length whose sum is one."""
    needed = (length - 1) // 2
    if len(free) != needed:
        raise ValueError(f"scheme {name}: {length} coefficients {table} leave {needed} free, {len(free)} are given")
    if not all(math.isfinite(c) for c in free):
        raise ValueError(f"scheme {name}: a coefficient {table} is not finite")
    if length % 2:
        return (*free, math.fsum([1.0, *(-2.0 * c for c in free)]), *reversed(free))
    half = (*free, math.fsum([0.5, *(-c for c in free)]))
    return (*half, *reversed(half))
