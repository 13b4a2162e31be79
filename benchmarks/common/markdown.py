"""Markdown tables for the documentation, generated from the records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.common import records
from benchmarks.common.records import Row


def rows(name: str) -> list[Row]:
    """Return the lines of a table that a benchmark has written; none if it has not run."""
    return records.read(records.RECORDS / f"{name}.csv")


def table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    return markdown([[*head], ["---"] * len(head), *map(list, body)])


def distinct(found: Iterable[Row], *names: str) -> list[tuple[str, ...]]:
    """Return the values of columns, in the order in which they come."""
    return list(dict.fromkeys(tuple(row[name] for name in names) for row in found))


def markdown(lines: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def with_error(mean: float, error: float, digits: int) -> str:
    """Return a mean and its error with so many digits after the point."""
    mean, error = (round(value, digits) + 0.0 for value in (mean, error))  # + 0.0: no minus before a zero
    return f"{mean:.{digits}f} ± {error:.{digits}f}".replace("-", "−")
