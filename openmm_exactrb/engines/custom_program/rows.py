"""The substeps of a scheme as a table of stages, a row for each turn of the program's loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.sequence import Sequence, repeated
from openmm_exactrb.substeps import KICK, LastForcesKick


def stage(**statements: str) -> float:
    """Return a field of `Row` for a stage that changes momenta once in a row.

    Statements are the expressions of the momenta ``P`` and ``L`` (angular, in the body) behind it, in terms of those
    before it; ``t`` is its time in ps.
    """
    default: float = field(default=0.0, metadata={"statements": statements})
    return default


@dataclass(frozen=True)
class Row:
    """The stages of a turn in the order of their execution; parts of a step.

    Attributes
    ----------
    before : float
        A thermostat.
    kick : float
    last : tuple of float
        A kick by what is remembered: weights of the forces, then of the differences.
    after : float
        A thermostat.
    drift : float
    shift : float
        Displacement along the forces over the square of the step, at which the next row evaluates its forces.
    remember, differ : float
        1 if forces that the row evaluates are remembered, or what displaced ones differ by, else 0.
    """

    before: float = 0.0
    kick: float = 0.0
    last: tuple[float, ...] = ()
    after: float = 0.0
    drift: float = 0.0
    shift: float = 0.0
    remember: float = 0.0
    differ: float = 0.0

    flags: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True)
class DriftRow:
    """The same where OpenMM's constraints close the drifts, which have fast forces within them.

    Attributes
    ----------
    before : float
        A thermostat.
    long : float
        The drift of rigid bodies, which feel no fast force.
    fast : float
        A kick by the fast forces.
    drift : float
        The drift of all other particles.
    kick, last, remember, differ
        As in `Row`.
    """

    before: float = 0.0
    long: float = 0.0
    fast: float = 0.0
    drift: float = 0.0
    kick: float = 0.0
    last: tuple[float, ...] = ()
    remember: float = 0.0
    differ: float = 0.0

    flags: ClassVar[tuple[str, ...]] = ("moves", "acts")

    @property
    def moves(self) -> bool:
        """Whether particles are placed by the constraints; a row with nothing in it does so too."""
        return bool(self.fast or self.drift or not self.acts)

    @property
    def acts(self) -> bool:
        """Whether the row ends behind a kick, or behind a thermostat."""
        alone = self.before and not (self.fast or self.drift)
        return bool(self.kick or any(self.last) or alone)


_R = TypeVar("_R", bound=Row | DriftRow)

#: A row that only computes virtual sites.
REST = Row()
#: Stages whose statements are told by `stage`.
STAGES = {entry.name: entry.metadata["statements"] for entry in fields(Row) if "statements" in entry.metadata}


@dataclass(frozen=True)
class Inner:
    """The inner steps of drifts: the sequence of one, and how many there are in a drift of a part of a step."""

    sequence: Sequence
    repetitions: Callable[[float], int]


@dataclass(frozen=True)
class Table:
    """The rows of a scheme: its processor, a step, its postprocessor and its output.

    Attributes
    ----------
    rows : tuple of Row, or of DriftRow
        With an empty one after the step, after the postprocessor and after the output; before the step too if they are
        of the second kind.
    enter, step, leave, output : int
        Numbers of rows of processor, step, postprocessor and output, without empty ones.
    memory : (int, int)
        How many forces of kicks are remembered for the output, and how many differences of displaced ones.
    """

    rows: tuple[Row, ...] | tuple[DriftRow, ...]
    enter: int
    step: int
    leave: int
    output: int = 0
    memory: tuple[int, int] = (0, 0)

    @classmethod
    def of(cls, scheme: Scheme, thermostat: bool = True) -> Table:
        """Return the rows of a scheme; ValueError if a substep fits into no row.

        That of a thermostat fits only if the integrator has a `thermostat`.
        """
        parts = (_rows(sequence, thermostat, scheme.memory) for sequence in _sequences(scheme))
        return cls._joined(scheme, REST, *parts)

    @classmethod
    def with_constraints(cls, scheme: Scheme, inner: Inner | None = None) -> Table:
        """Return the rows of a scheme whose drifts OpenMM's constraints close, with inner steps if there are some."""
        parts = (_drift_rows(_flattened(sequence, scheme, inner)) for sequence in _sequences(scheme))
        return cls._joined(scheme, DriftRow(), *parts)

    @classmethod
    def _joined(
        cls, scheme: Scheme, rest: _R, enter: list[_R], step: list[_R], leave: list[_R], output: list[_R]
    ) -> Table:
        if output and not _begins_with_kick(step[0]):
            memory, step = scheme.memory, _remembering(step)
        else:
            memory, output = (0, 0), []
        again = [rest] * isinstance(rest, DriftRow)
        behind = ([*some, rest] if some else [] for some in (leave, output))
        rows: Any = (*enter, *again, *step, rest, *(row for some in behind for row in some))
        return cls(rows, len(enter), len(step), len(leave), len(output), memory)

    @property
    def constrained(self) -> bool:
        """Whether OpenMM's constraints close the drifts."""
        return isinstance(self.rows[0], DriftRow)

    def span(self, turns: int, sites: bool, begin: str, end: str) -> tuple[int, int]:
        """Return the first and the last turn of a pass from the begin of a part to the end of one.

        Parts are "enter", "step", "leave" and "output"; "again" begins before "step" and "rest" before "leave" with
        placing the bodies. There are so many turns per row, and virtual sites need one more at the end.
        """
        first = self._first()
        last = first[end] + getattr(self, end)
        if self.constrained:
            return first[begin], last - 1
        return first[begin] * turns, last * turns - (not sites)

    def _first(self) -> dict[str, int]:
        step = self.enter + self.constrained
        rest = step + self.step
        leave = rest + 1
        output = leave + self.leave + bool(self.leave)
        return {"enter": 0, "again": self.enter, "step": step, "rest": rest, "leave": leave, "output": output}

    def fast_kicks(self, begin: str, end: str) -> int:
        """Return how often a pass evaluates the fast forces."""
        first, last = self.span(1, False, begin, end)
        return sum(bool(getattr(row, "fast", 0.0)) for row in self.rows[first : last + 1])

    def heat_exchanges(self, sites: bool) -> int:
        """Return how often a step carries out the stages of a thermostat, whether they are of a time or none."""
        if self.constrained:
            first, last = self.span(1, False, "step", "step")
            return sum(bool(row.before) for row in self.rows[first : last + 1])
        return (self.has("before") + self.has("after")) * (self.step + sites)

    @property
    def continues(self) -> bool:
        """Whether the inner state of a processed scheme can last from call to call: if a step begins with a drift."""
        return bool(self.enter) and not _begins_with_kick(self.rows[self._first()["step"]])

    def remembered(self) -> tuple[int, int]:
        """Return how many forces and differences a step adds to what is remembered."""
        first = self._first()["step"]
        step = self.rows[first : first + self.step]
        return sum(bool(row.remember) for row in step), sum(bool(row.differ) for row in step)

    @cached_property
    def longest_drift(self) -> float:
        """The longest drift of rigid bodies, whatever its sign; 0 without any."""
        return max(abs(row.long if isinstance(row, DriftRow) else row.drift) for row in self.rows)

    def has(self, part: str) -> bool:
        """Return whether a row has a part that is not zero."""
        return any(getattr(row, part, 0.0) for row in self.rows)

    @property
    def displaces(self) -> bool:
        """Whether a row takes forces at displaced places."""
        return self.has("shift")

    @property
    def has_thermostat(self) -> bool:
        """Whether a row has a part of a thermostat."""
        return self.has("before") or self.has("after")

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """The names of the columns."""
        last = tuple(f"last{k}" for k in range(sum(self.memory)))
        kind = type(self.rows[0])
        return tuple(part for name in _order(kind) + kind.flags for part in (last if name == "last" else (name,)))

    def column(self, part: str) -> int:
        """Return the column of a part; those of the last forces have numbers, such as "last0"."""
        return self.parts.index(part)

    def columns(self) -> list[list[float]]:
        """Return three tables whose sum is the numbers of the rows, column by column; each number fits into 24 bits."""
        exact = np.array([_entry(row, name) for name in self.parts for row in self.rows])
        tables = []
        for _ in range(3):
            rounded = exact.astype(np.float32).astype(np.float64)
            exact = exact - rounded
            tables.append(rounded.tolist())
        return tables


def _order(kind: type) -> tuple[str, ...]:
    """Return the stages of a kind of rows in the order of their execution."""
    return tuple(entry.name for entry in fields(kind))


def _sequences(scheme: Scheme) -> tuple[Sequence, ...]:
    return scheme.processor, scheme.sequence, scheme.postprocessor, scheme.output


def _begins_with_kick(row: Row | DriftRow) -> bool:
    if isinstance(row, DriftRow):
        return bool(row.kick) and not (row.long or row.drift)
    return bool(row.kick or row.shift)


def _entry(row: Row | DriftRow, part: str) -> float:
    """Return a number of a row."""
    if not part.startswith("last"):
        return float(getattr(row, part))
    k = int(part.removeprefix("last"))
    return row.last[k] if row.last else 0.0


def _remembering(rows: list[_R]) -> list[_R]:
    """Return rows in which forces at true places are remembered, and what those at displaced ones differ by."""
    shifts = [getattr(row, "shift", 0.0) for row in rows]
    displaced = (False, *map(bool, shifts))
    return [
        replace(row, remember=float(bool(row.kick or shift) and not there), differ=float(there))
        for row, shift, there in zip(rows, shifts, displaced, strict=False)
    ]


def _unsupported(substep: object) -> ValueError:
    return ValueError(f"the device does not support the substep {substep!r}")


def _rows(sequence: Sequence, thermostat: bool, memory: tuple[int, int]) -> list[Row]:
    """Return the rows of a sequence."""
    rows: list[Row] = []
    for substep, part in sequence:
        if isinstance(substep, LastForcesKick):
            _append(rows, REST, "last", substep.padded(part, memory))
            continue
        entries = substep.device_rows(part)
        for name, number in entries or (("", 0.0),):
            if name == "shift":
                _append(rows, REST, "shift", number, unless=("after", "drift", "shift"))
                rows.append(REST)  # the kick there
            elif name == "thermostat" and thermostat:
                _append(rows, REST, "after" if rows and rows[-1].kick else "before", number)
            elif name in ("drift", "kick", *STAGES):
                _append(rows, REST, name, number)
            else:
                raise _unsupported(substep)
    return rows


def _append(
    rows: list[_R], rest: _R, name: str, part: float | tuple[float, ...], unless: tuple[str, ...] | None = None
) -> None:
    """Add a part to the last row, or to a new one if the last row has parts that come later."""
    order = _order(type(rest))
    later = order[order.index(name) :] if unless is None else unless
    if not rows or any(getattr(rows[-1], other) for other in later):
        rows.append(rest)
    news: dict[str, Any] = {name: part}
    rows[-1] = replace(rows[-1], **news)


def _flattened(sequence: Sequence, scheme: Scheme, inner: Inner | None) -> Iterator[tuple[str, Any]]:
    """Yield the stages of a sequence with the inner steps of its drifts, and their parts of a step."""
    for substep, part in sequence:
        if isinstance(substep, LastForcesKick):
            yield "last", substep.padded(part, scheme.memory)
            continue
        for name, number in substep.device_rows(part) or (("", 0.0),):
            if name in ("drift", "long"):
                yield "long", number
            if name in ("drift", "inner"):
                yield from _inner_stages(number, inner)
            elif name in ("kick", "thermostat"):
                yield {"thermostat": "before"}.get(name, name), number
            elif name != "long":
                raise _unsupported(substep)


def _inner_stages(part: float, inner: Inner | None) -> Iterator[tuple[str, float]]:
    if inner is None:
        yield "drift", part
        return
    n = inner.repetitions(part)
    for substep, fraction in repeated(inner.sequence, n):
        yield "fast" if substep == KICK else "drift", fraction * (part / n)


def _drift_rows(stages: Iterator[tuple[str, Any]]) -> list[DriftRow]:
    """Return rows of stages; kicks by the fast forces at one place are one, behind those by the others there."""
    rows: list[DriftRow] = []
    fast = 0.0
    for name, part in stages:
        if name == "fast":
            fast += part
            continue
        if fast and name in ("before", "drift"):
            _append(rows, DriftRow(), "fast", fast)
            fast = 0.0
        _append(rows, DriftRow(), name, part)
    if fast:
        _append(rows, DriftRow(), "fast", fast)
    return rows
