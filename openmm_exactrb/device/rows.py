"""The substeps of a scheme as a table of stages, a row for each turn of the program's loop."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.sequence import Sequence
from openmm_exactrb.substeps import LastForcesKick


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


#: A row that only computes virtual sites.
REST = Row()
_ORDER = tuple(entry.name for entry in fields(Row))
#: Stages whose statements are told by `stage`.
STAGES = {entry.name: entry.metadata["statements"] for entry in fields(Row) if "statements" in entry.metadata}


@dataclass(frozen=True)
class Table:
    """The rows of a scheme: its processor, a step, its postprocessor and its output.

    Attributes
    ----------
    rows : tuple of Row
        With a `REST` after the step, after the postprocessor and after the output.
    enter, step, leave, output : int
        Numbers of rows of processor, step, postprocessor and output, without rests.
    memory : (int, int)
        How many forces of kicks are remembered for the output, and how many differences of displaced ones.
    """

    rows: tuple[Row, ...]
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
        sequences = scheme.processor, scheme.sequence, scheme.postprocessor, scheme.output
        enter, step, leave, output = (_rows(sequence, thermostat, scheme.memory) for sequence in sequences)
        if output and not step[0].kick:
            memory, step = scheme.memory, _remembering(step)
        else:
            memory, output = (0, 0), []
        rest = [REST]
        rows = [*enter, *step, *rest, *leave, *rest * bool(leave), *output, *rest * bool(output)]
        return cls(tuple(rows), len(enter), len(step), len(leave), len(output), memory)

    def span(self, turns: int, sites: bool, begin: str, end: str) -> tuple[int, int]:
        """Return the first and the last turn of a pass from the begin of a part to the end of one.

        Parts are "enter", "step", "leave" and "output", and "rest" before "leave", which only places the bodies. There
        are so many turns per row, and virtual sites need one more at the end.
        """
        rest = self.enter + self.step
        first = {"enter": 0, "step": self.enter, "rest": rest, "leave": rest + 1}
        first["output"] = first["leave"] + self.leave + bool(self.leave)
        return first[begin] * turns, (first[end] + getattr(self, end)) * turns - (not sites)

    @property
    def continues(self) -> bool:
        """Whether the inner state of a processed scheme can last from call to call: if a step begins with a drift."""
        return bool(self.enter) and not (self.rows[self.enter].kick or self.rows[self.enter].shift)

    def remembered(self) -> tuple[int, int]:
        """Return how many forces and differences a step adds to what is remembered."""
        step = self.rows[self.enter : self.enter + self.step]
        return sum(bool(row.remember) for row in step), sum(bool(row.differ) for row in step)

    @cached_property
    def longest_drift(self) -> float:
        """The longest drift, whatever its sign; 0 without any."""
        return max(abs(row.drift) for row in self.rows)

    def has(self, part: str) -> bool:
        """Return whether a row has a part that is not zero."""
        return any(getattr(row, part) for row in self.rows)

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
        return tuple(part for name in _ORDER for part in (last if name == "last" else (name,)))

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


def _entry(row: Row, part: str) -> float:
    """Return a number of a row."""
    if not part.startswith("last"):
        return float(getattr(row, part))
    k = int(part.removeprefix("last"))
    return row.last[k] if row.last else 0.0


def _remembering(rows: list[Row]) -> list[Row]:
    """Return rows in which forces at true places are remembered, and what those at displaced ones differ by."""
    displaced = (False, *(bool(row.shift) for row in rows))
    return [
        replace(row, remember=float(bool(row.kick or row.shift) and not there), differ=float(there))
        for row, there in zip(rows, displaced, strict=False)
    ]


def _rows(sequence: Sequence, thermostat: bool, memory: tuple[int, int]) -> list[Row]:
    """Return the rows of a sequence."""
    rows: list[Row] = []
    for substep, part in sequence:
        if isinstance(substep, LastForcesKick):
            _append(rows, "last", substep.padded(part, memory))
            continue
        entries = substep.device_rows(part)
        for name, number in entries or (("", 0.0),):
            if name == "shift":
                _append(rows, "shift", number, unless=("after", "drift", "shift"))
                rows.append(REST)  # the kick there
            elif name == "thermostat" and thermostat:
                _append(rows, "after" if rows and rows[-1].kick else "before", number)
            elif name in ("drift", "kick", *STAGES):
                _append(rows, name, number)
            else:
                raise ValueError(f"the device does not support the substep {substep!r}")
    return rows


def _append(rows: list[Row], name: str, part: float | tuple[float, ...], unless: tuple[str, ...] | None = None) -> None:
    """Add a part to the last row, or to a new one if the last row has parts that come later."""
    later = _ORDER[_ORDER.index(name) :] if unless is None else unless
    if not rows or any(getattr(rows[-1], other) for other in later):
        rows.append(REST)
    news: dict[str, Any] = {name: part}
    rows[-1] = replace(rows[-1], **news)
