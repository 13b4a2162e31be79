"""The moves of bodies with inner steps: the drifts of a scheme, including the fast forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from openmm_exactrb.engines.device.segments import Segment, merged
from openmm_exactrb.moves import Move, Op
from openmm_exactrb.schemes.sequence import Sequence, repeated
from openmm_exactrb.substeps import KICK

Moves = tuple[Move, ...]


@dataclass(frozen=True)
class InnerSteps:
    """An inner scheme, and the number of its steps in a drift over a fraction of a step."""

    sequence: Sequence
    repetitions: Callable[[float], int]

    def within(self, drift: Move) -> Moves:
        """Return the moves of a drift."""
        n = self.repetitions(drift.part)
        ops = ((Op.FAST_KICK if substep == KICK else Op.DRIFT, part) for substep, part in repeated(self.sequence, n))
        return tuple(Move(op, part * drift.part / n, late=drift.late) for op, part in ops)

    def evaluations(self, part: float) -> int:
        """Return the number of evaluations of fast forces in a drift; neighbouring drifts share those at its ends."""
        kicks = [substep == KICK for substep, _ in repeated(self.sequence, self.repetitions(part))]
        return sum(kicks) - (kicks[0] and kicks[-1])


def moves_of(segment: Segment, inner: InnerSteps | None) -> Moves:
    """Return the moves of a segment for flexible molecules.

    If the next segment begins with a kick, it also needs the fast forces at the end of this drift: a kick that a
    segment `leaves` is due in the next one.
    """
    moves = [move for move in segment.moves if move.op != Op.DRIFT or move.bodies != "others"]
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
    """Return moves in parts, all of which except the last end with a drift."""
    ends = [place + 1 for place, move in enumerate(moves) if move.op == Op.DRIFT]
    parts = [moves[begin:end] for begin, end in zip([0, *ends], [*ends, len(moves)], strict=True)]
    return [part for part in parts if part]
