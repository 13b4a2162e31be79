"""The record of the study of equipartition: what runs gave, kept from machine to machine."""

import math

import numpy as np
import pytest

from equipartition import gist
from equipartition_record import LFM, MEASURED, RECORD, Run, add, over_frictions, over_steps, points, read


def record_of(*values):
    """Return a record of runs with seeds 1, 2, ... that have these potential energies."""
    runs = [Run("spce", "NVT", "W2_3m", 6.0, 216, 5.0, 50.0, seed) for seed in range(1, 1 + len(values))]
    return {
        run: dict.fromkeys(MEASURED, 1.0) | {"U": U, "acceptance": math.nan}
        for run, U in zip(runs, values, strict=True)
    }


def test_a_record_is_read_as_it_was_written(tmp_path):
    record = record_of(-46.5, -46.75)
    for key, means in reversed(record.items()):  # as two commands beside each other would
        add({key: means}, tmp_path / "record.csv")
    found = read(tmp_path / "record.csv")
    assert [*found] == [*record]
    for key, run in record.items():
        assert found[key] == pytest.approx(run, nan_ok=True)
    assert read(tmp_path / "nothing.csv") == {}


def test_errors_are_those_of_the_mean_of_independent_runs():
    values = [-46.5, -46.75, -46.9, -46.6]
    (point,) = points(record_of(*values))
    assert point[:6] == ("spce", "NVT", "W2_3m", 6.0, 5.0, 200.0)
    assert point.found["U"] == pytest.approx((np.mean(values), np.std(values, ddof=1) / 2.0))
    assert "acceptance" not in point.found


def test_a_table_has_whole_points_only():
    values = np.linspace(-46.0, -47.0, 20)
    whole, part = record_of(*values), record_of(*values[:19])
    assert "| W2_3m, the default | −46.50 ± 0.07 |" in over_steps(whole, "U", "spce", "NVT")
    assert "−46" not in over_steps(part, "U", "spce", "NVT")
    harder = {run._replace(friction=20.0): means for run, means in whole.items()}
    assert over_frictions(whole | harder, "spce", 6.0).count("−46.50 ± 0.07") == 2
    assert over_steps(harder, "U", "spce", "NVT").count("±") == 0


def test_the_gist_of_a_run_compares_rotation_with_its_own_translation():
    """Around the bath where that is looked at; of LangevinMiddleIntegrator there is one translation."""
    samples = {
        "T_tr": [290.0, 300.0],
        "T_rot": [300.0, 304.0],
        "T_tr, other": [291.0, 293.0],
        "T_rot, other": [301.0, 303.0],
    }
    result = {"samples": samples | {"U": [-46.0, -47.0], "density": [1000.0, 1001.0]}}
    assert gist("W2_3m", result)["other T_rot - T_tr"] == pytest.approx(10.0)
    assert gist(LFM, result)["other T_rot - T_tr"] == pytest.approx(7.0)
    assert gist(LFM, result)["T_rot - T_tr"] == pytest.approx(7.0)


def test_the_record_in_the_documentation_has_a_run_once_and_whole_points():
    record = read(RECORD)
    assert len(record) == len(RECORD.read_text().splitlines()) - 1
    found = points(record)
    assert all(point.ps >= 1000.0 for point in found)
    whole = {point[:5] for point in found}
    methods = ("W2_3m", "BAOAB", LFM)
    assert whole >= {("spce", "NVT", method, interval, 5.0) for method in methods for interval in (4.0, 6.0)}
