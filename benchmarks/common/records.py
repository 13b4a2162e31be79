"""Storage of measurements: tables in records/, from which the pages are generated, and raw data in out/benchmarks/."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from openmm_exactrb.support.files import written_whole

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
RECORDS, PICTURES = ROOT / "benchmarks" / "records", DOCS / "pictures"
OUT = Path("out/benchmarks")

Row = dict[str, str]


def read(file: Path) -> list[Row]:
    """Return the rows of a table; none if there is no file."""
    if not file.exists():
        return []
    with file.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def write(file: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any] | Sequence[Any]]) -> None:
    """Write a table as a whole: rows are sequences, or mappings by the names of the columns."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(file) as out:
        table = csv.writer(out, lineterminator="\n")
        table.writerow(columns)
        table.writerows([row[name] for name in columns] if isinstance(row, Mapping) else row for row in rows)


def picture_of(table: Path) -> Path:
    """Return the file of the picture of a table: in `PICTURES` for a record, and otherwise next to the table."""
    folder = PICTURES if table.parent.resolve() == RECORDS else table.parent
    return (folder / table.name).with_suffix(".png")


def keep(name: str, data: Any) -> None:
    """Write raw data as JSON into `OUT`."""
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / name).write_text(json.dumps(data, indent=1), encoding="utf-8")


class Record:
    """A table that grows: the first columns tell which run a row is of, and runs that are there are not made again.

    Several commands may add to one file.

    Parameters
    ----------
    file : Path
    key, others : sequence of str
        The columns.
    order : callable, optional
        What rows are sorted by; new ones come last unless it is given.
    """

    def __init__(
        self, file: Path, key: Sequence[str], others: Sequence[str], order: Callable[[Row], Any] | None = None
    ) -> None:
        self.file, self.key, self.columns, self.order = file, key, (*key, *others), order

    def key_of(self, row: Mapping[str, Any]) -> tuple[str, ...]:
        """Return which run a row is of."""
        return tuple(str(row[name]) for name in self.key)

    def rows(self) -> dict[tuple[str, ...], Row]:
        """Return all rows by their runs."""
        return {self.key_of(row): row for row in read(self.file)}

    def __contains__(self, row: Mapping[str, Any]) -> bool:
        return self.key_of(row) in self.rows()

    def add(self, row: Mapping[str, Any]) -> Row:
        """Add a row, in place of one of the same run, print it, and return it as it is in the file."""
        text = {name: str(row[name]) for name in self.columns}
        rows = list((self.rows() | {self.key_of(text): text}).values())
        write(self.file, self.columns, rows if self.order is None else sorted(rows, key=self.order))
        print(*text.values(), sep="  ", flush=True)
        return text
