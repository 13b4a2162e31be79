"""The substeps of a scheme as a table of stages, a row for each turn of the program's loop."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.sequence import Sequence


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
    after : float
        A thermostat.
    drift : float
    shift : float
        Displacement along the forces over the square of the step, at which the next row evaluates its forces.
    """

    before: float = 0.0
    kick: float = 0.0
    after: float = 0.0
    drift: float = 0.0
    shift: float = 0.0


#: A row that only computes virtual sites.
REST = Row()
_ORDER = tuple(entry.name for entry in fields(Row))
#: Stages whose statements are told by `stage`.
STAGES = {entry.name: entry.metadata["statements"] for entry in fields(Row) if "statements" in entry.metadata}


@dataclass(frozen=True)
class Table:
    """The rows of a scheme: its processor, a step, and its postprocessor.

    Attributes
    ----------
    rows : tuple of Row
        With a `REST` after the step and after the postprocessor.
    enter, step, leave : int
        Numbers of rows of processor, step and postprocessor, without rests.
    """

    rows: tuple[Row, ...]
    enter: int
    step: int
    leave: int

    @classmethod
    def of(cls, scheme: Scheme, thermostat: bool = True) -> Table:
        """Return the rows of a scheme; ValueError if a substep fits into no row.

        That of a thermostat fits only if the integrator has a `thermostat`.
        """
        sequences = scheme.processor, scheme.sequence, scheme.postprocessor
        enter, step, leave = (_rows(sequence, thermostat) for sequence in sequences)
        last = (*leave, REST) if leave else ()
        return cls((*enter, *step, REST, *last), len(enter), len(step), len(leave))

    def span(self, turns: int, sites: bool, enters: bool, leaves: bool) -> tuple[int, int]:
        """Return the first and the last turn of a step, with so many turns per row; virtual sites need one more turn.

        The processor precedes it if it enters, and the postprocessor follows it if it leaves inner coordinates.
        """
        end = len(self.rows) - 1 if leaves and self.leave else self.enter + self.step
        return (0 if enters else self.enter) * turns, end * turns - (not sites)

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

    def column(self, part: str) -> int:
        """Return the column of a part."""
        return _ORDER.index(part)

    def columns(self) -> list[list[float]]:
        """Return three tables whose sum is the numbers of the rows, column by column; each number fits into 24 bits."""
        exact = np.array([getattr(row, name) for name in _ORDER for row in self.rows])
        tables = []
        for _ in range(3):
            rounded = exact.astype(np.float32).astype(np.float64)
            exact = exact - rounded
            tables.append(rounded.tolist())
        return tables


def _rows(sequence: Sequence, thermostat: bool) -> list[Row]:
    """Return the rows of a sequence."""
    rows: list[Row] = []
    for substep, part in sequence:
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


def _append(rows: list[Row], name: str, part: float, unless: tuple[str, ...] | None = None) -> None:
    """Add a part to the last row, or to a new one if the last row has parts that come later."""
    later = _ORDER[_ORDER.index(name) :] if unless is None else unless
    if not rows or any(getattr(rows[-1], other) for other in later):
        rows.append(REST)
    rows[-1] = replace(rows[-1], **{name: part})
