"""The page on the density and enthalpy of TIP4P/2005 has the numbers of its records."""

import math

import numpy as np
import pytest

from benchmarks.common.markdown import with_error
from benchmarks.common.records import DOCS
from benchmarks.water.equipartition_record import AGAIN, LFM, RECORD, read
from benchmarks.water.tip4p2005 import KELVIN, corrected, measured


@pytest.fixture(scope="module")
def page():
    return " ".join((DOCS / "explanation/temperature.md").read_text(encoding="utf-8").split())


def of_runs(method, fs, value):
    """Return mean and error of a value over the runs at 298.15 K and 1 bar."""
    kind = "tip4p2005", "NPT", method, fs
    found = np.array([value(m) for run, m in read(RECORD).items() if (run[:4], run.kelvin) == (kind, KELVIN)])
    return found.mean(), found.std(ddof=1) / math.sqrt(len(found))


@pytest.mark.parametrize("method", [LFM, "W2_3m"])
def test_runs_in_the_cold_have_the_length_that_the_page_says(page, method):
    cold = [run.ps for run in read(AGAIN) if (run.method, run.kelvin) == (method, 277.15)]
    assert f"{sum(cold):.0f} ps at 277.15 K" in page


@pytest.mark.parametrize("kelvin", [KELVIN, 277.15])
def test_the_density_of_more_molecules_is_higher(page, kelvin):
    (larger, error), (smaller, other) = (measured()[kelvin, name, 4.0]["density"] for name in ("W2_3m, 512", "W2_3m"))
    assert f"{with_error(larger - smaller, math.hypot(error, other), 1)} kg/m³ ({kelvin:.0f} K)" in page


@pytest.mark.parametrize("fs", [2.0, 4.0])
def test_velocities_at_the_ends_of_steps_are_too_slow(page, fs):
    kelvin, error = of_runs("BAOAB", fs, lambda m: m["T_tr"] + 0.5 * m["T_rot - T_tr"])
    assert f"{with_error(KELVIN - kelvin, error, 1)} K at {fs:g} fs" in page
    enthalpy, error = measured()[KELVIN, "BAOAB", fs]["enthalpy"]
    reference, other = corrected("enthalpy")
    assert with_error(reference - enthalpy, math.hypot(error, other), 2) in page


@pytest.mark.parametrize("fs", [2.0, 4.0])
def test_velocities_of_langevin_middle_are_too_fast(page, fs):
    kelvin, _ = of_runs(LFM, fs, lambda m: m["T_tr"] + 0.5 * m["T_rot - T_tr"])
    assert f"{3.0 * 0.0083144626 * (kelvin - KELVIN):.2f} kJ/mol at {fs:g} fs" in page
