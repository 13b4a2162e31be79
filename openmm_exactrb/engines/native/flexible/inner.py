"""The moves of bodies with inner steps: drifts of a scheme that include the fast forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from openmm_exactrb.engines.native.segments import Segment, merged
from openmm_exactrb.steps.moves import Move, Op
from openmm_exactrb.steps.sequence import Sequence, repeated
from openmm_exactrb.steps.substeps import KICK

Moves = tuple[Move, ...]


@dataclass(frozen=True)
class InnerSteps:
    """The sequence of an inner step, and the number of inner steps in a drift over a fraction of the outer step."""

    sequence: Sequence
    repetitions: Callable[[float], int]

    def within(self, drift: Move) -> Moves:
        """Return the moves of the inner steps that form a drift."""
        n = self.repetitions(drift.part)
        ops = ((Op.FAST_KICK if substep == KICK else Op.DRIFT, part) for substep, part in repeated(self.sequence, n))
        return tuple(Move(op, part * drift.part / n, late=drift.late) for op, part in ops)

    def evaluations(self, part: float) -> int:
        """Return the number of evaluations of fast forces in a drift; successive drifts share one evaluation."""
        kicks = [substep == KICK for substep, _ in repeated(self.sequence, self.repetitions(part))]
        return sum(kicks) - (kicks[0] and kicks[-1])


def moves_of(segment: Segment, inner: InnerSteps | None) -> Moves:
    """Return the moves of a segment for flexible molecules with the given inner steps, or without inner steps.

    If `segment.leaves` is true, the last fast kick of its last drift is deferred to the next segment, which needs the
    fast forces at the same positions.
    """
    not_theirs = "inner" if inner is None else "others"
    moves = [move for move in segment.moves if move.op != Op.DRIFT or move.bodies != not_theirs]
    if inner is None:
        return merged(moves)
    due = inner.within(Move(Op.DRIFT, segment.behind))[-1:] if segment.behind else ()
    found = [move for move in due if move.op == Op.FAST_KICK]
    for move in moves:
        found += inner.within(move) if move.op == Op.DRIFT else (move,)
    if segment.leaves and found[-1].op == Op.FAST_KICK:
        found.pop()
    return merged(found)


def up_to_drifts(moves: Moves) -> list[Moves]:
    """Divide moves into parts that end with a drift, except possibly the last part."""
    ends = [place + 1 for place, move in enumerate(moves) if move.op == Op.DRIFT]
    parts = [moves[begin:end] for begin, end in zip([0, *ends], [*ends, len(moves)], strict=True)]
    return [part for part in parts if part]
