"""Segments: a scheme divided at its force evaluations, and the sequences of the program that executes it.

A segment consists of the moves between two evaluations. Each part of a program (rigid bodies, flexible molecules)
performs these moves for its own bodies, in as few launches as possible. A step is

    open | evaluate, body ... | evaluate, close

where "open" precedes the first evaluation and "close" follows the last one. "between" joins the end of a step and the
start of the next step in one segment.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.engines.native.program import Program
from openmm_exactrb.steps.moves import ExchangeNumbers, Move, Op, of_substep
from openmm_exactrb.support.types import Array

Rows = Iterable[tuple[object, float]]

#: All active force groups, as a bit mask.
ALL = -1
# Integers per move in the table.
_COLUMNS = 4


@dataclass(frozen=True)
class Segment:
    """Moves of all bodies between two force evaluations.

    Attributes
    ----------
    moves : tuple of Move
    groups : int or None
        The force groups (bits) whose forces are evaluated before the segment, or None.
    time : float
        The time of the evaluation, as a fraction of the step.
    reduces : bool
        Whether the thermostat needs the kinetic energy before the segment.
    shows : bool
        Whether velocities are written to the Context after the segment, at the end of a step.
    behind : float
        The fraction of the step of an earlier drift whose last inner kick is due in this segment, or 0.
    leaves : bool
        Whether the last inner kick of the segment's last drift is due in the next segment.
    places : bool
        Whether positions are written to the Context even if no move changes them.
    copied : bool
        Whether the segment moves the shown copy of the bodies instead of the inner coordinates of a processed scheme.
    """

    moves: tuple[Move, ...] = ()
    groups: int | None = None
    time: float = 0.0
    reduces: bool = False
    shows: bool = False
    behind: float = 0.0
    leaves: bool = False
    copied: bool = False
    places: bool = False

    def has(self, *ops: Op) -> bool:
        """Return whether any move has one of these kinds."""
        return any(move.op in ops for move in self.moves)


def divided(
    rows: Rows, known: int | None = None, splits_exchanges: bool = False, remembered: int | None = None
) -> list[Segment]:
    """Divide a sequence of substeps into segments at its force evaluations.

    Parameters
    ----------
    rows : iterable of (Substep, float)
    known : int, optional
        The force groups (bits) whose forces are known at the start.
    splits_exchanges : bool, optional
        Whether heat exchanges need the kinetic energy.
    remembered : int, optional
        The force groups (bits) whose forces are stored, or None.

    Raises
    ------
    ValueError
        If the native engine does not support a substep.
    """
    segments, time = [Segment()], 0.0
    moves: list[Move] = []
    memories = differences = 0

    def begin(**what: object) -> None:
        segments[-1] = replace(segments[-1], moves=tuple(moves))
        moves.clear()
        segments.append(Segment(time=time, **what))  # type: ignore[arg-type]

    for move in (move for substep, part in rows for move in of_substep(substep, part)):
        if move.op == Op.DISPLACED_KICK or (move.groups and move.groups != known):
            begin(groups=move.groups)
            known = move.groups
            if move.op == Op.DISPLACED_KICK:
                move, differences = replace(move, number=differences), differences + 1
            elif move.groups == remembered:
                moves.append(Move(Op.REMEMBER, number=memories))
                memories += 1
        if move.op == Op.EXCHANGE and splits_exchanges:
            begin(reduces=True)
        moves.append(move)
        if move.op == Op.DRIFT and move.bodies != "inner":
            time += move.part
        if move.displaces or move.op == Op.DISPLACED_KICK:
            known = None
    segments[-1] = replace(segments[-1], moves=tuple(moves))
    return segments


def merged(moves: Iterable[Move]) -> tuple[Move, ...]:
    """Return the moves of a segment, with adjacent additive moves of the same kind in the same step merged.

    Moves of two steps are not merged, so that the result does not depend on how steps are divided into calls.
    """
    rows: list[Move] = []
    for move in moves:
        if (
            rows
            and (rows[-1].op, rows[-1].late) == (move.op, move.late)
            and move.op in (Op.DRIFT, Op.KICK, Op.FAST_KICK)
        ):
            rows[-1] = replace(rows[-1], part=rows[-1].part + move.part)
        else:
            rows.append(move)
    return tuple(move for move in rows if move.op != Op.DRIFT or move.part)  # a held drift and its inverse cancel


def known_after(segments: Sequence[Segment], known: int | None = None) -> int | None:
    """Return the force groups whose forces at the final positions of segments are known, or None."""
    for segment in segments:
        known = segment.groups if segment.groups is not None else known
        for move in segment.moves:
            if move.displaces or move.op == Op.DISPLACED_KICK:
                known = None
    return known


def _joined(segments: Sequence[Segment]) -> list[Segment]:
    """Return segments in which the last inner kick of a drift at a segment's end is deferred to the next segment."""
    joined, behind = [], 0.0
    for number, segment in enumerate(segments):
        before = behind
        for move in segment.moves:
            if move.op != Op.DRIFT:
                behind = 0.0
            elif move.bodies != "others":
                behind = move.part
        if number == len(segments) - 1 or segments[number + 1].reduces:  # which need complete velocities
            behind = 0.0
        joined.append(replace(segment, behind=before, leaves=bool(behind)))
    return joined


def _drifts(moves: Sequence[Move]) -> int:
    """Return the number of drifts with which a sequence of moves begins."""
    return len(list(itertools.takewhile(lambda move: move.op == Op.DRIFT, moves)))


@dataclass(frozen=True)
class Step:
    """The segments of a step. The first segment uses forces that are already known.

    Attributes
    ----------
    segments : tuple of Segment
    needs : int or None
        The force groups (bits) whose forces the first segment needs.
    held, leading : int
        The numbers of drifts at the end and at the start of a step that are merged, because the next call performs the
        drifts at the end; zero if the Context shows the state in which a step ends.
    """

    segments: tuple[Segment, ...]
    needs: int | None
    held: int = 0
    leading: int = 0

    @classmethod
    def of(
        cls, rows: Rows, splits_exchanges: bool = False, remembered: int | None = None, processed: bool = False
    ) -> Step:
        """Return the segments of a sequence; `processed` is true for a processed scheme, which shows other positions.

        The other arguments are those of `divided`.
        """
        rows = tuple(rows)
        known = known_after(divided(rows))
        segments = divided(rows, known, splits_exchanges, remembered)
        if len(segments) == 1:
            segments.insert(0, Segment())
        before = itertools.takewhile(lambda segment: segment.groups is None, segments)
        needs = next((move.groups for segment in before for move in segment.moves if move.groups), None)
        segments[-1] = replace(segments[-1], shows=True)
        held, leading = _drifts(segments[-1].moves[::-1]), _drifts(segments[0].moves)
        merges = processed and held > 0 and leading > 0
        return cls(tuple(_joined(segments)), needs, held * merges, leading * merges)

    @property
    def between(self) -> Segment:
        """The last segment of a step, joined with the first segment of the next step."""
        first, last = self.segments[0], self.segments[-1]
        early, late = first.moves[: self.leading], (replace(move, late=True) for move in first.moves[self.leading :])
        return replace(last, moves=(*last.moves, *early, *late), shows=False, leaves=first.leaves)

    @property
    def hold(self) -> Segment:
        """The last segment of a step without the drifts at its end."""
        last = self.segments[-1]
        return replace(last, moves=last.moves[: len(last.moves) - self.held], shows=False)

    @property
    def resume(self) -> Segment:
        """The drifts that `hold` omits, joined with the first segment of the next step."""
        first, last = self.segments[0], self.segments[-1]
        return replace(first, moves=last.moves[len(last.moves) - self.held :] + first.moves)

    def evaluations(self, groups: int) -> int:
        """Return the number of evaluations per step of the forces of given groups."""
        return sum(segment.groups == groups for segment in self.segments)

    @property
    def remembered(self) -> tuple[int, int]:
        """The numbers of forces and of differences of displaced forces that a step stores."""
        ops = [move.op for segment in self.segments for move in segment.moves]
        return ops.count(Op.REMEMBER), ops.count(Op.DISPLACED_KICK)


class Table:
    """The moves of all segments as a table for kernels: rows of integers, and numbers that depend on the settings.

    A row contains the op, the number of the move (plus 2^16 if the move belongs to the next step), the index of its
    first number, and the count of its numbers.
    """

    #: The names of the arrays.
    MOVES, NUMBERS = "moves", "numbers"

    def __init__(self, own: tuple[str, ...] = ()) -> None:
        self.own = own  # source texts of the users' moves
        self._moves: list[Move] = []
        self._places: dict[tuple[Move, ...], int] = {}

    def rows(self, moves: tuple[Move, ...]) -> tuple[int, int]:
        """Return the index of the first row and the number of rows of some moves, which are added if they are new."""
        if moves not in self._places:
            self._places[moves] = len(self._moves)
            self._moves += moves
        return self._places[moves], len(moves)

    def values(self, h: float, exchange: ExchangeNumbers | None) -> tuple[NDArray[np.int32], Array]:
        """Return the arrays for the step size h (ps), where exchange(tau) returns the numbers of a heat exchange."""
        numbers = [move.numbers(h, exchange) for move in self._moves]
        starts = np.cumsum([0, *map(len, numbers)])
        rows = [
            (self._number(move), move.number + (move.late << 16), start, len(some))
            for move, some, start in zip(self._moves, numbers, starts[:-1], strict=True)
        ]
        flat = [value for some in numbers for value in some]
        return np.array(rows, dtype=np.int32).reshape(-1, _COLUMNS), np.array(flat, dtype=np.float64)

    def _number(self, move: Move) -> int:
        """Return the number of the op in kernels; users' ops are numbered in the order of their texts."""
        return move.op + self.own.index(move.text) if move.op == Op.OWN else move.op

    def declare(self, to: Program, exchange_numbers: int) -> None:
        """Declare the arrays when all segments are known; heat exchanges have `exchange_numbers` numbers and tau."""
        _, numbers = self.values(1.0, lambda tau: (0.0,) * exchange_numbers)
        to.array(self.MOVES, _COLUMNS * len(self._moves), element=4)
        to.array(self.NUMBERS, len(numbers))
