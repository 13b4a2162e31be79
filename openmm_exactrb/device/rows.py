"""The word of a step as a table: a row is what one turn of the program's loop does."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import BATH, DRIFT, GRADIENT, KICK, Word


@dataclass(frozen=True)
class Row:
    """What a turn does, in this order; parts of a step.

    Attributes
    ----------
    before : float
        A heat bath.
    kick : float
    after : float
        A heat bath.
    drift : float
    shift : float
        Over the square of the step: how far places are displaced along the forces, for those of the next row.
    """

    kick: float = 0.0
    drift: float = 0.0
    shift: float = 0.0
    before: float = 0.0
    after: float = 0.0


#: A row in which nothing happens but that virtual sites are made.
REST = Row()
_ORDER = ("before", "kick", "after", "drift", "shift")


@dataclass(frozen=True)
class Table:
    """The rows of a scheme: what prepares a run, a step, and what finishes a run.

    Attributes
    ----------
    rows : tuple of Row
        A rest stands behind the step and at the end.
    enter, step, leave : int
        How many rows there are of each, without rests.
    """

    rows: tuple[Row, ...]
    enter: int
    step: int
    leave: int

    @classmethod
    def of(cls, scheme: Scheme) -> Table:
        """Return the rows of a scheme."""
        strengths = dict(scheme.gradients)
        enter, step, leave = (_rows(word, strengths) for word in (scheme.processor, scheme.word, scheme.postprocessor))
        last = (*leave, REST) if leave else ()
        return cls((*enter, *step, REST, *last), len(enter), len(step), len(leave))

    def span(self, turns: int, sites: bool, enters: bool, leaves: bool) -> tuple[int, int]:
        """Return the first and the last turn of a step.

        Parameters
        ----------
        turns : int
            Turns a row.
        sites : bool
            Whether there are virtual sites, which need a turn more.
        enters, leaves : bool
            Whether the state is to be prepared before the step, and finished after it.
        """
        end = len(self.rows) - 1 if leaves and self.leave else self.enter + self.step
        return (0 if enters else self.enter) * turns, end * turns - (not sites)

    def has(self, part: str) -> bool:
        """Tell whether a row has a part that is not zero."""
        return any(getattr(row, part) for row in self.rows)

    @property
    def has_bath(self) -> bool:
        """Whether there is a bath in a row."""
        return self.has("before") or self.has("after")

    def column(self, part: str) -> int:
        """Return which column of the rows a part is."""
        return [field.name for field in fields(Row)].index(part)

    def columns(self) -> list[list[float]]:
        """Return three tables whose sum is the numbers of the rows, column by column; each number fits into 24 bits."""
        exact = np.array([getattr(row, field.name) for field in fields(Row) for row in self.rows])
        tables = []
        for _ in range(3):
            rounded = exact.astype(np.float32).astype(np.float64)
            exact = exact - rounded
            tables.append(rounded.tolist())
        return tables


def foreign(scheme: Scheme, bath: bool) -> list[str]:
    """Return the letters of a scheme that fit into no row; a bath does where the integrator has one."""
    letters = {letter for letter, _ in scheme.word + scheme.processor}
    known = {DRIFT, KICK, *(letter for letter, _ in scheme.gradients)}
    return sorted(letter for letter in letters - known if not (bath and letter.startswith(BATH)))


def _rows(word: Word, strengths: dict[str, float]) -> list[Row]:
    rows: list[Row] = []
    for letter, part in word:
        if letter.startswith(GRADIENT):
            _append(rows, "shift", strengths[letter] * part * part, unless=("after", "drift", "shift"))
            rows.append(Row(kick=part))
        elif letter.startswith(BATH):
            _append(rows, "after" if rows and rows[-1].kick else "before", part)
        else:
            _append(rows, "drift" if letter == DRIFT else "kick", part)
    return rows


def _append(rows: list[Row], name: str, part: float, unless: tuple[str, ...] | None = None) -> None:
    """Put a part into the last row, or into a new one where that would not be behind all that the row has."""
    later = _ORDER[_ORDER.index(name) :] if unless is None else unless
    if not rows or any(getattr(rows[-1], other) for other in later):
        rows.append(REST)
    rows[-1] = replace(rows[-1], **{name: part})
