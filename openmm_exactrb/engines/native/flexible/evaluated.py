"""Inner steps as part of the scheme, with fast forces that OpenMM evaluates because no kernel supports them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

from openmm_exactrb.engines.native.flexible.inner import InnerSteps
from openmm_exactrb.engines.native.segments import ALL
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.moves import Move, Op, of_substep
from openmm_exactrb.steps.sequence import Sequence, merged, repeated
from openmm_exactrb.steps.substeps import DRIFT, KICK, Drift, Substep

_ALL = 0xFFFFFFFF


@dataclass(frozen=True)
class GroupsKick(Substep):
    """A kick by the forces of several force groups, given as a bit mask."""

    groups: int

    symbol: ClassVar[str] = "B"
    moves: ClassVar[bool] = False
    kicks: ClassVar[bool] = True
    additive: ClassVar[bool] = True

    def kernel_moves(self, part: float) -> tuple[Move, ...]:
        """Return the move of the kick."""
        return (Move(Op.KICK, part, groups=self.groups),)


@dataclass(frozen=True)
class OfGroups(Substep):
    """A substep that uses the forces of several force groups, given as a bit mask, instead of all forces."""

    substep: Substep
    groups: int

    def kernel_moves(self, part: float) -> tuple[Move, ...]:
        """Return the moves of the substep."""
        moves = of_substep(self.substep, part)
        return tuple(replace(move, groups=self.groups) if move.groups == ALL else move for move in moves)


class Evaluated(NamedTuple):
    """Fast force groups (bits) that OpenMM evaluates in inner steps, because no kernel supports `what`."""

    groups: int
    inner: InnerSteps
    what: str

    @property
    def slow(self) -> int:
        """The force groups that are not fast (bits)."""
        return _ALL & ~self.groups

    @property
    def warning(self) -> str:
        """The message that warns of fast forces that OpenMM evaluates."""
        groups = ", ".join(str(group) for group in range(32) if self.groups >> group & 1)
        return (
            f"the native engine has no kernel for {self.what}: OpenMM evaluates all forces of the fast groups "
            f"({groups}) at every inner step, which is slower"
        )

    def within(self, scheme: Scheme) -> Scheme:
        """Return the scheme with its drifts replaced by inner steps of all bodies."""
        rows = (self.rows(some) for some in (scheme.sequence, scheme.processor, scheme.output))
        sequence, processor, output = rows
        return replace(scheme, sequence=sequence, processor=processor, output=output)

    def rows(self, sequence: Sequence) -> Sequence:
        """Return a sequence with inner steps for its drifts, and with separate kicks by the fast and the slow forces.

        If a fast and a slow kick are adjacent, the fast kick comes first. At the start of the sequence, the slow kick
        comes first, because its forces are known if the previous step ended with a slow kick.
        """
        places = itertools.groupby(self._each(sequence), lambda row: isinstance(row[0], GroupsKick))
        rows: list[tuple[Substep, float]] = []
        for kicks, some in places:
            here = list(some)
            if kicks:
                here.sort(key=lambda row: (row[0] == GroupsKick(self.slow)) == bool(rows))
            rows += here
        return merged(rows)

    def _each(self, sequence: Sequence) -> Iterator[tuple[Substep, float]]:
        fast, slow = GroupsKick(self.groups), GroupsKick(self.slow)
        for substep, part in sequence:
            if not isinstance(substep, Drift):
                all_forces = any(move.groups == ALL for move in of_substep(substep, part))
                other = OfGroups(substep, self.slow) if all_forces else substep
                yield slow if substep == KICK else other, part
                continue
            n = self.inner.repetitions(part)
            for inner, of_inner in repeated(self.inner.sequence, n):
                yield fast if inner == KICK else DRIFT, of_inner * part / n
