"""The page on averages has the numbers of its records."""

import math

import numpy as np
import pytest

from benchmarks.common.markdown import rows, with_error
from benchmarks.common.records import DOCS
from benchmarks.water.tables import averages


def deviation(model, held, average):
    """Return by how much a corrected average at 8 fs deviates from the reference, its error, and the reference."""
    (row,) = (
        [cell.strip() for cell in line.split("|")]
        for line in averages().splitlines()
        if line.startswith(f"| {model}, heavy hydrogens | 8 fs, {held}") and f"| {average} (" in line
    )
    (mean, error), (known, of_known) = (map(float, cell.replace("−", "-").split(" ± ")) for cell in row[6:8])
    return mean - known, math.hypot(error, of_known), known


@pytest.mark.parametrize("model", ["SPC/E", "TIP4P/2005"])
def test_densities_with_heavy_hydrogens_deviate_as_the_page_says(model):
    page = " ".join((DOCS / "explanation/averages.md").read_text(encoding="utf-8").split())
    less, error, known = deviation(model, "1 bar", "density")
    assert f"{with_error(100.0 * less / known, 100.0 * error / known, 2)} % with {model}" in page


@pytest.mark.parametrize(("held", "average"), [("constant volume", "potential energy"), ("1 bar", "enthalpy")])
def test_energies_with_heavy_hydrogens_deviate_as_the_page_says(held, average):
    page = " ".join((DOCS / "explanation/averages.md").read_text(encoding="utf-8").split())
    spce, tip4p2005 = (with_error(*deviation(model, held, average)[:2], 3) for model in ("SPC/E", "TIP4P/2005"))
    assert f"{held} are {spce} (SPC/E) and {tip4p2005} kJ/mol (TIP4P/2005) too high" in page


def test_energies_with_heavy_hydrogens_are_near_the_references():
    for model in ("SPC/E", "TIP4P/2005"):
        for kind in (("constant volume", "potential energy"), ("1 bar", "enthalpy")):
            assert abs(deviation(model, *kind)[0]) < 0.045


def test_at_the_next_kick_the_error_of_the_pressure_is_less_than_half_of_that_at_the_end_of_a_step():
    found = [row for row in rows("averages") if row["scheme"] == "W2_3m" and row["ensemble"] == "NVT"]
    assert len(found) >= 8
    offset, measured, corrected = (
        np.array([float(row[name]) for row in found]) for name in ("pressure offset", "pressure", "pressure corrected")
    )
    errors = np.array([float(row["pressure offset error"]) for row in found])
    assert np.average(offset / (measured - corrected), weights=errors**-2) < 0.5
