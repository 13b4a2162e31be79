"""Splitting schemes: sequences of substeps with their properties, and functions that build schemes from coefficients.

A step of size h alternates drifts, the flow of T over a_i h, with kicks, the flow of V over b_i h. A table contains
only the free coefficients; the others follow because each scheme is a palindrome and sum(a) = sum(b) = 1.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from openmm_exactrb.steps.sequence import Sequence as Substeps
from openmm_exactrb.steps.sequence import inverse, palindromic
from openmm_exactrb.steps.substeps import DRIFT, KICK, GradientKick, LastForcesKick, Substep

Validity = Literal["general", "nystroem"]
Outer = Literal["drift", "kick"]


@dataclass(frozen=True)
class Scheme:
    """A splitting scheme.

    Attributes
    ----------
    name : str
    order : int
        Order in the step size.
    sequence : tuple of (Substep, float)
        The substeps of one step, each with its fraction of the step.
    kind : {"general", "nystroem"}
        A Nyström scheme needs a kinetic energy that is quadratic in the momenta.
    reference : str
        Publication that describes the scheme.
    generalised : tuple of int
        Generalised orders (s1, s2, ...) of a scheme for potentials of relative size epsilon, whose error consists of
        terms of order epsilon h^s1, epsilon² h^s2, ...; otherwise empty.
    processor : tuple of (Substep, float)
        Substeps before the first step, which map the true coordinates to the inner coordinates, in which the steps are
        performed; their inverse maps back to the true coordinates.
    output : tuple of (Substep, float)
        A cheaper map to the true coordinates for output, or empty. Because the run continues in the inner coordinates,
        the error of this map does not accumulate.
    output_of_rigid : bool
        Whether the output was fitted to rigid molecules alone, so that it is replaced by the inverse of the processor
        if drifts have inner steps.

    Raises
    ------
    ValueError
        If the sequence is empty, or contains anything other than substeps, or if a kick by stored forces is not part of
        the output.
    """

    name: str
    order: int
    sequence: Substeps
    kind: Validity = "general"
    reference: str = ""
    generalised: tuple[int, ...] = ()
    processor: Substeps = ()
    output: Substeps = ()
    output_of_rigid: bool = False

    def __post_init__(self) -> None:
        if not self.sequence:
            raise ValueError(f"scheme {self.name}: the sequence of a step must contain at least one substep")
        for row in self.rows:
            if not (isinstance(row, tuple) and len(row) == 2 and isinstance(row[0], Substep)):
                raise ValueError(
                    f"scheme {self.name}: a sequence must consist of pairs of a Substep and its fraction of the step, "
                    f"not {row!r}: "
                    'use schemes.spelled("B A B"), which returns the sequence for a string of symbols'
                )
        stored = self._stored((*self.sequence, *self.processor))
        if any(type(substep).bind is LastForcesKick.bind for substep in stored):
            raise ValueError(
                f"scheme {self.name}: a kick by stored forces is for the output of a processed scheme alone: use "
                "output= for LastForcesKick"
            )

    def __repr__(self) -> str:
        """Return the name and the main properties."""
        orders = ", ".join(map(str, self.generalised or (self.order,)))
        kind = ", Nyström" if self.kind == "nystroem" else ""
        processed = ", processed" if self.processor else ""
        return (
            f"Scheme({self.name!r}, order {orders}, {self.forces} forces per step, {self.first} first{kind}{processed})"
        )

    @property
    def rows(self) -> Substeps:
        """The substeps of the sequence, the processor and the output, each with its fraction of the step."""
        return (*self.sequence, *self.processor, *self.output)

    @property
    def first(self) -> Outer:
        """The type of the first substep, apart from a thermostat."""
        return "drift" if [substep for substep, _ in self._moves()][:1] == [DRIFT] else "kick"

    @property
    def a(self) -> tuple[float, ...]:
        """Coefficients of all drifts, in order of execution."""
        return tuple(part for substep, part in self.sequence if substep == DRIFT)

    @property
    def b(self) -> tuple[float, ...]:
        """Coefficients of the kicks in order of execution; kicks that no drift separates are summed."""
        return tuple(math.fsum(part for _, part in kicks) for kicks in self._kicks())

    @property
    def c(self) -> tuple[float, ...]:
        """Coefficients c_i of the force-gradient terms f . M^-1 f of the kicks over c_i h³, or empty if all are 0."""
        terms = tuple(math.fsum(map(_gradient_term, kicks)) for kicks in self._kicks())
        return terms if any(terms) else ()

    @property
    def has_gradients(self) -> bool:
        """Whether the scheme has force-gradient kicks."""
        return any(isinstance(substep, GradientKick) for substep, _ in self.sequence)

    def has(self, substep: Substep) -> bool:
        """Return whether a step has a substep of this type."""
        return any(isinstance(present, type(substep)) for present, _ in self.sequence)

    def _kicks(self) -> list[list[tuple[Substep, float]]]:
        """Return the kicks grouped by position; kicks that no drift separates form a group."""
        places = itertools.groupby(self._moves(), lambda row: row[0].kicks)
        return [list(group) for kicked, group in places if kicked]

    def _moves(self) -> Substeps:
        """Return the drifts and kicks; a thermostat between them does not change the positions of the kicks."""
        return tuple(row for row in self.sequence if row[0] == DRIFT or row[0].kicks)

    @property
    def stages(self) -> int:
        """Number of positions per step with force evaluations; outer stages of neighbouring steps are merged."""
        moves = self._moves()
        return len(self._kicks()) - (bool(moves) and moves[0][0].kicks and moves[-1][0].kicks)

    @property
    def forces(self) -> int:
        """Number of force evaluations per step, including those at displaced positions for force-gradient kicks."""
        return self.stages + sum(substep.displaced_forces for substep, _ in self.sequence)

    @property
    def postprocessor(self) -> Substeps:
        """The inverse of the processor, applied after the last step."""
        return inverse(self.processor)

    @property
    def with_inner_steps(self) -> Scheme:
        """The scheme for drifts with inner steps, without an output that was fitted to rigid molecules."""
        return replace(self, output=()) if self.output_of_rigid else self

    @property
    def processing(self) -> int:
        """Number of force evaluations of the processor and its exact inverse together, for one application of each."""
        return 2 * sum(substep.kicks for substep, _ in self.processor)

    @staticmethod
    def _stored(rows: Substeps) -> list[LastForcesKick]:
        return [substep for substep, _ in rows if isinstance(substep, LastForcesKick)]

    @property
    def memory(self) -> tuple[int, int]:
        """Numbers of forces of the last kicks, and of differences of displaced forces, that the output needs."""
        last = self._stored(self.output)
        return max((len(s.weights) for s in last), default=0), max((len(s.differences) for s in last), default=0)

    @property
    def output_forces(self) -> int:
        """Number of force evaluations of the output, for each call of the integrator's `step`."""
        return sum(substep.kicks for substep, _ in self.output or self.processor)

    @property
    def symmetric(self) -> bool:
        """Whether a backward step inverts a step; a processor, symmetric only to first order in V, makes this false."""
        return not self.processor and palindromic(self.sequence)


def _gradient_term(row: tuple[Substep, float]) -> float:
    substep, part = row
    return -0.5 * substep.strength * part**3 if isinstance(substep, GradientKick) else 0.0


def symmetric(
    name: str,
    *,
    order: int,
    stages: int,
    first: Outer,
    a: Sequence[float] = (),
    b: Sequence[float] = (),
    kind: Validity = "general",
    reference: str = "",
    generalised: tuple[int, ...] = (),
) -> Scheme:
    """Return the symmetric scheme with given free coefficients.

    Parameters
    ----------
    name, order, stages, kind, first, reference, generalised
        As in `Scheme`.
    a, b : sequence of float
        The coefficients of drifts and kicks that precede the coefficient determined by sum(a) = 1 or sum(b) = 1.

    Raises
    ------
    ValueError
        If a table has the wrong number of coefficients for the stages, or contains a number that is not finite.
    """
    of_drifts, of_kicks = (stages + 1, stages) if first == "drift" else (stages, stages + 1)
    drifts = [(DRIFT, part) for part in palindrome(name, "a", a, of_drifts)]
    kicks = [(KICK, part) for part in palindrome(name, "b", b, of_kicks)]
    sequence = _alternating(drifts, kicks) if first == "drift" else _alternating(kicks, drifts)
    return Scheme(name, order, sequence, kind, reference, generalised)


def _alternating(first: Iterable[tuple[Substep, float]], second: Iterable[tuple[Substep, float]]) -> Substeps:
    """Return the rows of two sequences in alternation, beginning with the first."""
    return tuple(row for pair in itertools.zip_longest(first, second) for row in pair if row)


def processed(
    kernel: Scheme,
    name: str,
    *,
    order: int,
    a: Sequence[float],
    b: Sequence[float],
    output: Substeps = (),
    output_of_rigid: bool = False,
    reference: str,
) -> Scheme:
    """Return a scheme with the steps of a kernel between a processor and its inverse.

    The other arguments are those of `Scheme` for the processed scheme. The processor alternates drifts and kicks, drift
    first; a and b omit the last drift and the last kick, which make the sums of drifts and of kicks zero.
    """
    drifts, kicks = ([*table, -math.fsum(table)] for table in (a, b))
    processor = _alternating([(DRIFT, part) for part in drifts], [(KICK, part) for part in kicks])
    of_both = replace(kernel, name=name, order=order, processor=processor, reference=reference)
    return replace(of_both, output=output, output_of_rigid=output_of_rigid)


def palindrome(name: str, table: str, free: Sequence[float], length: int) -> tuple[float, ...]:
    """Return the palindrome of a given length and of sum one that begins with the free coefficients."""
    needed = (length - 1) // 2
    if len(free) != needed:
        raise ValueError(
            f"scheme {name}: the number of free coefficients {table} must be {needed} (of {length} in all), not "
            f"{len(free)}"
        )
    if not all(math.isfinite(c) for c in free):
        raise ValueError(f"scheme {name}: coefficients {table} must be finite")
    if length % 2:
        return (*free, math.fsum([1.0, *(-2.0 * c for c in free)]), *reversed(free))
    half = (*free, math.fsum([0.5, *(-c for c in free)]))
    return (*half, *reversed(half))
