"""The page on averages has the numbers of its records."""

import itertools
import math

import numpy as np
import pytest

from benchmarks.common.markdown import rows, with_error
from benchmarks.common.records import DOCS
from benchmarks.water.corrected_water import agreement, points
from benchmarks.water.droplet_averages import droplet_averages
from benchmarks.water.tables import averages


def deviation(model, held, average):
    """Return by how much a corrected average at 8 fs deviates from the reference, its error, and the reference."""
    (row,) = (
        [cell.strip() for cell in line.split("|")]
        for line in averages().splitlines()
        if line.startswith(f"| {model} | {held}") and f"| {average} (" in line
    )
    (mean, error), (known, of_known) = (map(float, cell.replace("−", "-").split(" ± ")) for cell in row[6:8])
    return mean - known, math.hypot(error, of_known), known


@pytest.mark.parametrize("model", ["SPC/E", "TIP4P/2005"])
def test_densities_with_heavy_hydrogens_deviate_as_the_page_says(model):
    page = " ".join((DOCS / "explanation/temperature.md").read_text(encoding="utf-8").split())
    less, error, known = deviation(model, "1 bar", "density")
    assert f"{with_error(100.0 * less / known, 100.0 * error / known, 2)} % with {model}" in page


@pytest.mark.parametrize(("held", "average"), [("constant volume", "potential energy"), ("1 bar", "enthalpy")])
def test_energies_with_heavy_hydrogens_deviate_as_the_page_says(held, average):
    page = " ".join((DOCS / "explanation/temperature.md").read_text(encoding="utf-8").split())
    spce, tip4p2005 = (with_error(*deviation(model, held, average)[:2], 3) for model in ("SPC/E", "TIP4P/2005"))
    assert f"{held} are {spce} (SPC/E) and {tip4p2005} kJ/mol (TIP4P/2005) too high" in page


def test_energies_with_heavy_hydrogens_are_near_the_references():
    for model in ("SPC/E", "TIP4P/2005"):
        for kind in (("constant volume", "potential energy"), ("1 bar", "enthalpy")):
            assert abs(deviation(model, *kind)[0]) < 0.045


def too_high(fs, ensembles, value):
    """Return by how much energies of W2_3m, read at the next kick, are too high: the mean over sets, and its error."""
    found = []
    for model, ensemble in itertools.product(("spce", "tip4p2005"), ensembles):
        some = points(model, ensemble, "U")
        known, of_known, _ = agreement([point.after for point in some if point.fs <= 4.0])
        ((mean, error),) = (value(point) for point in some if (point.method, point.fs) == ("W2_3m", fs))
        found.append((mean - known, math.hypot(error, of_known)))
    return agreement(found)[:2]


def test_energies_with_plain_hydrogens_deviate_as_the_page_says():
    page = " ".join((DOCS / "explanation/temperature.md").read_text(encoding="utf-8").split())
    before, _ = too_high(4.0, ("NVT", "NPT"), lambda point: (point.mean, point.error))
    after = with_error(*too_high(4.0, ("NVT", "NPT"), lambda point: point.after), 2)
    assert f"is {before:.2f} kJ/mol too high before the correction, and {after} kJ/mol after it" in page
    assert f"energies are {with_error(*too_high(6.0, ('NVT',), lambda point: point.after), 2)} kJ/mol too high" in page


def test_the_correction_of_a_peptide_in_water_is_that_of_its_page():
    page = " ".join((DOCS / "explanation/any-molecule.md").read_text(encoding="utf-8").split())
    volume, pressure = (
        with_error(-float(row["U"]), float(row["U error"]), 2)
        for ensemble in ("NVT", "NPT")
        for row in rows("corrected_steps")
        if (row["integrator"], row["masses"], row["fs"], row["ensemble"]) == ("W2_3m", "all", "8.0", ensemble)
    )
    assert f"by {volume} kJ/mol at constant volume, and by {pressure} kJ/mol at 1 bar" in page


def test_at_the_next_kick_the_error_of_the_pressure_is_less_than_half_of_that_at_the_end_of_a_step():
    found = [row for row in rows("averages") if row["scheme"] == "W2_3m" and row["ensemble"] == "NVT"]
    assert len(found) >= 8
    offset, measured, corrected = (
        np.array([float(row[name]) for row in found]) for name in ("pressure offset", "pressure", "pressure corrected")
    )
    errors = np.array([float(row["pressure offset error"]) for row in found])
    assert np.average(offset / (measured - corrected), weights=errors**-2) < 0.5


def of_droplets(scheme, fs):
    """Return by how much energies of droplets exceed those of hybrid Monte Carlo, before and after the correction."""
    lines = [[cell.strip(" `") for cell in line.split("|")][1:-1] for line in droplet_averages().splitlines()]
    ((known, of_known),) = (numbers(line[3]) for line in lines if line[0] == "hybrid Monte Carlo")
    (cells,) = (line[3:5] for line in lines if (line[0], line[1]) == (scheme, f"{fs:g}"))
    return [(mean - known, math.hypot(error, of_known)) for mean, error in map(numbers, cells)]


def numbers(cell):
    return tuple(map(float, cell.replace("−", "-").split(" ± ")))


def test_energies_of_droplets_deviate_as_the_page_says():
    page = " ".join((DOCS / "explanation/temperature.md").read_text(encoding="utf-8").split())
    before, after = (with_error(*of, 3) for of in of_droplets("W2_3m", 8))
    assert f"is {before} kJ/mol too high before the correction, and {after} kJ/mol after it" in page
    before, after = (with_error(-mean, error, 3) for mean, error in of_droplets("BAOA", 8))
    assert f"is {before} kJ/mol too low before the correction, and {after} kJ/mol after it" in page
    for scheme, fs in (("LangevinMiddle", 2), ("LangevinMiddle", 4), ("BAOA", 4)):
        off, error = of_droplets(scheme, fs)[1]
        assert abs(off) < error < 0.0105
