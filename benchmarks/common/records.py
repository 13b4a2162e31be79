"""Where measurements are kept: tables in docs/ that the pages are made from, and raw data in out/benchmarks/."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from openmm_exactrb.support.files import written_whole

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
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
