"""Write the tables of the pages, from the records in records/*.csv and from the catalogue of schemes.

A table follows a comment with its name, such as `<!-- table: one_line -->`. The name is that of a function in one of
the files `tables.py`, of a table of the study of equipartition, or of a record that is copied unchanged.

    python benchmarks/write_tables.py
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from inspect import isfunction
from pathlib import Path
from types import ModuleType

from benchmarks import tables
from benchmarks.common.markdown import rows, table
from benchmarks.common.provenance import OF_RUN, PROVENANCE
from benchmarks.common.records import DOCS
from benchmarks.constraints import small_molecules
from benchmarks.cost import tables as of_cost
from benchmarks.device import tables as of_device
from benchmarks.dipoles import tables as of_dipoles
from benchmarks.free_energies import tables as of_free_energies
from benchmarks.proteins import corrected_steps
from benchmarks.proteins import tables as of_proteins
from benchmarks.schemes import tables as of_schemes
from benchmarks.water import corrected_water, droplet_averages, tip4p2005
from benchmarks.water import tables as of_water
from benchmarks.water.equipartition_record import RECORD, over_steps, read

#: The modules whose functions return tables.
_MODULES: tuple[ModuleType, ...] = (
    *(tables, of_cost, of_device, of_dipoles, of_free_energies, of_proteins, of_schemes, of_water),
    *(small_molecules, corrected_steps, corrected_water, droplet_averages, tip4p2005),
)
_WRITTEN = re.compile(r"(?<=<!-- table: )(\w+)( -->\n)((?:\|.*\n)*)")


def all_tables() -> dict[str, str]:
    """Return the tables of all pages in Markdown by their names."""
    known = dict(_equipartition())
    names = {name for page in pages() for name, *_ in _WRITTEN.findall(page.read_text(encoding="utf-8"))}
    return {name: known[name] if name in known else made(name) for name in sorted(names)}


def made(name: str) -> str:
    """Return the table of a function, or of a record that is shown without the columns of provenance."""
    for module in _MODULES:
        if isfunction(function := getattr(module, name, None)):
            return str(function())
    if not (found := rows(name)):
        raise ValueError(
            f"no script has measured the table {name} of a page: write benchmarks/records/{name}.csv, or a function "
            f"{name}() in one of the files tables.py"
        )
    hidden = OF_RUN if set(OF_RUN) <= found[0].keys() else PROVENANCE
    columns = [column for column in found[0] if column not in hidden]
    return table([name.replace("_", " ") for name in columns], [[row[name] for name in columns] for row in found])


def _equipartition() -> Iterator[tuple[str, str]]:
    record = read(RECORD)
    yield "spce_temperatures", over_steps(record, "T_rot - T_tr", "spce", "NVT", omitted={1.0})
    yield "spce_energies", over_steps(record, "U", "spce", "NVT", omitted={1.0})


def pages() -> list[Path]:
    """Return the pages with tables."""
    return [page for page in sorted(DOCS.rglob("*.md")) if _WRITTEN.search(page.read_text(encoding="utf-8"))]


def written(text: str, known: dict[str, str]) -> str:
    """Return the text of a page with its tables as they are now."""
    return _WRITTEN.sub(lambda found: f"{found[1]}{found[2]}{known[found[1]]}\n", text)


def main() -> None:
    known = all_tables()
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if (new := written(text, known)) != text:
            page.write_text(new, encoding="utf-8")
            print(page.relative_to(DOCS.parent))


if __name__ == "__main__":
    main()
