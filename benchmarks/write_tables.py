"""Write the tables of the pages, from the records in records/*.csv and from the catalogue of schemes.

A table follows a comment with its name, such as `<!-- table: one_line -->`. The name is that of a function in one of
the files `tables.py`, of a table of the study of equipartition, or of a record that is copied unchanged.

    python benchmarks/write_tables.py
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from benchmarks import tables
from benchmarks.common.markdown import rows, table
from benchmarks.common.provenance import OF_RUN, PROVENANCE
from benchmarks.common.records import DOCS
from benchmarks.constraints.martini_rings import martini_rings
from benchmarks.constraints.small_molecules import small_molecules
from benchmarks.cost import tables as of_cost
from benchmarks.device import tables as of_device
from benchmarks.dipoles import tables as of_dipoles
from benchmarks.proteins import tables as of_proteins
from benchmarks.proteins.corrected_steps import corrected_steps
from benchmarks.schemes import tables as of_schemes
from benchmarks.water import tables as of_water
from benchmarks.water.corrected_water import corrected_water, corrected_water_agreement
from benchmarks.water.droplet_averages import droplet_averages
from benchmarks.water.equipartition_record import (
    RECORD,
    over_frictions,
    over_models,
    over_steps,
    read,
)
from benchmarks.water.tip4p2005 import tip4p2005

#: Records that are shown as they are, without the columns of provenance.
AS_THEY_ARE = [
    "acceptance",
    "cholesterol",
    "device_drift",
    "device_drift_peptide",
    "device_precision",
    "dipole_bonds",
    "dipole_rods",
    "dppc",
    "ellipsoids",
    "large_bodies",
    "rigid_domains",
    "rigid_domains_cost",
]
_WRITTEN = re.compile(r"(?<=<!-- table: )(\w+)( -->\n)((?:\|.*\n)*)")


def all_tables() -> dict[str, str]:
    """Return the tables in Markdown by their names."""
    functions = (
        *(tables.default_energies, tables.default_stability, tables.default_temperatures),
        *(of_cost.one_line, of_cost.small_systems, of_cost.alchemical_systems),
        *(tables.protein_steps, tables.protein_limits, tables.villin_steps, tables.heating, tables.populations),
        tables.equal_protein_costs,
        *(tables.outputs, tables.validation, tables.ensembles, tables.earlier_schemes, tables.scheme_table),
        *(tables.protein_energies, of_water.box_energies, of_water.droplet_energies),
        *(of_water.energy_balances, of_water.reading_points, of_water.equal_costs, of_water.shadow_predictions),
        *(of_water.energy_drifts, of_water.settings_of_forces, of_proteins.peptide_errors, of_proteins.inner_steps),
        *(of_schemes.roundoff_errors, of_schemes.heat_exchanges, of_schemes.small_potentials, small_molecules),
        martini_rings,
        *(of_schemes.droplets_of_models, of_schemes.droplet_growth, of_schemes.oscillator_errors),
        *(of_water.averages, corrected_steps, corrected_water, corrected_water_agreement, droplet_averages, tip4p2005),
        *(of_schemes.rotors_compared, of_dipoles.dipole_costs),
        *(of_dipoles.dipole_errors, of_dipoles.dipole_energies, of_dipoles.stockmayer_constants),
        *(of_dipoles.ferrofluid_constants, of_dipoles.dipole_droplets),
        *(of_device.device_costs, of_device.device_proteins),
    )
    shown = {name: _as_it_is(name) for name in AS_THEY_ARE}
    return shown | {function.__name__: function() for function in functions} | dict(_equipartition())


def _as_it_is(name: str) -> str:
    found = rows(name)
    hidden = OF_RUN if set(OF_RUN) <= found[0].keys() else PROVENANCE
    columns = [column for column in found[0] if column not in hidden]
    return table([name.replace("_", " ") for name in columns], [[row[name] for name in columns] for row in found])


def _equipartition() -> Iterator[tuple[str, str]]:
    record = read(RECORD)
    for model in ("spce", "tip4p2005"):
        yield f"{model}_temperatures", over_steps(record, "T_rot - T_tr", model, "NVT")
        yield f"{model}_temperatures_at_pressure", over_steps(record, "T_rot - T_tr", model, "NPT")
        yield f"{model}_energies", over_steps(record, "U", model, "NVT")
        yield f"{model}_densities", over_steps(record, "density", model, "NPT")
        yield f"{model}_frictions", over_frictions(record, model, 6.0)
    yield "equipartition_models", over_models(record)


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
