"""The record of the study of equipartition: what runs gave, kept from machine to machine."""

import itertools
import math

import numpy as np
import pytest

from benchmarks.common.provenance import OF_RUN
from benchmarks.common.records import DOCS, ROOT
from benchmarks.water.equipartition import gist
from benchmarks.water.equipartition_record import (
    LFM,
    MEASURED,
    RECORD,
    Run,
    denser,
    less,
    merge,
    over_steps,
    points,
    read,
    whole,
    with_error,
)
from benchmarks.water.tables import equal_costs


def record_of(*values):
    """Return a record of runs with seeds 1, 2, ... that have these potential energies."""
    runs = [Run("spce", "NVT", "W2_3m", 6.0, 216, 5.0, 298.15, 50.0, seed) for seed in range(1, 1 + len(values))]
    return {
        run: dict.fromkeys(MEASURED, 1.0) | {"U": U, "acceptance": math.nan} | dict.fromkeys(OF_RUN, "known")
        for run, U in zip(runs, values, strict=True)
    }


def test_a_record_is_read_as_it_was_written(tmp_path):
    record = record_of(-46.5, -46.75)
    for key, means in reversed(record.items()):  # as two commands beside each other would
        merge({key: means}, tmp_path / "record.csv")
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
    assert "| W2_3m, at the next kick | −46.50 ± 0.07 |" in over_steps(whole, "U", "spce", "NVT")
    assert "−46" not in over_steps(part, "U", "spce", "NVT")
    harder = {run._replace(friction=20.0): means for run, means in whole.items()}
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
    assert len(record) == len(RECORD.read_text(encoding="utf-8").splitlines()) - 1
    found = points(record)
    assert all(point.ps >= 1000.0 for point in found)
    whole = {point[:5] for point in found}
    methods = ("W2_3m", "BAOAB", LFM)
    assert whole >= {("spce", "NVT", method, interval, 5.0) for method in methods for interval in (4.0, 6.0)}


EXAMPLE = "examples/equipartition.py"
STUDY = "docs/explanation/temperature.md"
WHICH = "docs/which.md"
FIGURES = [
    (WHICH, "T_rot − T_tr = {} K after projection on the constraints", ("NVT", LFM, 4.0), 5.0),
    (WHICH, "on the constraints ({} K as reported)", ("NVT", LFM, 4.0), 5.0),
    (WHICH, "and as reported T_rot − T_tr = {} K.", ("NVT", "W2_4g", 4.0), 5.0),
    ("docs/appendix/joss.md", "translation differ by {} K with `W2_4g`", ("NVT", "W2_4g", 4.0), 5.0),
    ("docs/appendix/joss.md", "and by {} K after projection of the velocities", ("NVT", LFM, 4.0), 5.0),
    ("docs/appendix/joss.md", "that `LangevinMiddleIntegrator` reports differ by {} K", ("NVT", LFM, 4.0), 5.0),
    (EXAMPLE, "of SPC/E is {} K hotter than translation after this projection", ("NVT", LFM, 4.0), 5.0),
    (EXAMPLE, "and {} K with the scheme ``W2_4g``", ("NVT", "W2_4g", 4.0), 5.0),
    (STUDY, "With `BAOA` rotation is {} K hotter than translation at 20/ps", ("NVT", "BAOA", 6.0), 20.0),
    (STUDY, "hotter than translation at 20/ps and {} K at 30/ps", ("NVT", "BAOA", 6.0), 30.0),
    (STUDY, "the rotation that it reports is {} K hotter", ("NVT", LFM, 6.0), 20.0),
    (
        STUDY,
        "after projection are at least as accurate as with `BAOA`, the same splitting: T_rot − T_tr is {} K",
        ("NVT", LFM, 6.0),
        20.0,
    ),
    (STUDY, "K and {} K. Without projection", ("NVT", LFM, 6.0), 30.0),
]


@pytest.mark.parametrize(("page", "words", "point", "friction"), FIGURES)
def test_figures_in_prose_are_those_of_the_record(page, words, point, friction):
    projected = "other " * ("projection" in words)
    mean = whole(read(RECORD))["spce", *point, friction][f"{projected}T_rot - T_tr"]
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    assert words.format(with_error(*mean, 1)) in text


def test_energies_and_densities_at_equal_cost_are_those_of_the_record():
    """OpenMM's are as good within their errors, which is why the pages advise to stay with it."""
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in equal_costs().splitlines()[2:]]
    cells = {(model, name): (energy, density) for model, name, _, _, energy, density in table}
    which = " ".join((DOCS / "which.md").read_text(encoding="utf-8").split())
    for name, words in (
        ("`LangevinMiddleIntegrator`, 4 fs", "U = {} kJ/mol, a density of {} kg/m³"),
        ("`LangevinMiddleIntegrator`, 0.5 fs", "U = {} kJ/mol and the density is {} kg/m³"),
        ("`W2_4g`, 4 fs", "[U = {} kJ/mol, {} kg/m³"),
    ):
        assert words.format(*cells["SPC/E", name]) in which
    found, errors = whole(read(RECORD)), {"U": [], "density": []}
    for model, (name, ensemble, scale) in itertools.product(
        ("spce", "tip4p2005"), (("U", "NVT", None), ("density", "NPT", 100.0))
    ):
        coarse, fine = (found[model, ensemble, LFM, step, 5.0][name] for step in (4.0, 0.5))
        difference, error = less(coarse, fine, scale)
        assert abs(difference) < error
        errors[name].append(error)
    words = "within their errors of {:.2f} kJ/mol per molecule and {:.2f} %"
    assert words.format(*(max(errors[name]) for name in ("U", "density"))) in which


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("spce", "At 2 fs it is {} kJ/mol above the reference with SPC/E"),
        ("tip4p2005", "above the reference with SPC/E, and {} with TIP4P/2005"),
    ],
)
def test_the_potential_energy_of_the_default_is_what_the_page_says(model, words):
    found = whole(read(RECORD))
    energies = (found[model, "NVT", method, step, 5.0]["U"] for method, step in (("W2_3m", 2.0), (LFM, 0.5)))
    text = " ".join((ROOT / STUDY).read_text(encoding="utf-8").split())
    assert words.format(with_error(*less(*energies), 2)) in text


@pytest.mark.parametrize(("interval", "percent"), [(4.0, "0.6"), (6.0, "1.4")])
def test_w2_3_is_as_dense_as_the_pages_say(interval, percent):
    found = whole(read(RECORD))
    densities = (
        found["spce", "NPT", method, step, 5.0]["density"] for method, step in (("W2_3", interval), (LFM, 0.5))
    )
    assert with_error(*less(*densities, 100.0), 1).startswith(percent)
    assert f"{percent} %" in (ROOT / STUDY).read_text(encoding="utf-8")


def test_densities_of_four_models_at_4_fs_are_as_the_pages_say():
    differences = denser(read(RECORD))
    assert [*differences] == ["SPC/E", "TIP4P/2005", "TIP3P", "TIP4P-Ew"]
    values, errors = np.array([difference for difference, _ in differences.values()]).T
    assert np.abs(values).max() < 0.1
    page = " ".join((DOCS / "how-to/barostat.md").read_text(encoding="utf-8").split())
    assert f"within 0.1 %, and errors of {errors.min():.2f} to {errors.max():.2f} %" in page
    study = " ".join((ROOT / STUDY).read_text(encoding="utf-8").split())
    spce, tip4p2005, tip3p, tip4pew = (with_error(*difference, 2) for difference, _ in differences.values())
    assert [step for _, step in differences.values()] == [0.5, 0.5, 1.0, 1.0]
    assert f"at 0.5 fs by {spce} % (SPC/E) and {tip4p2005} % (TIP4P/2005), and from that at 1 fs by" in study
    assert f"by {tip3p} % (TIP3P) and {tip4pew} % (TIP4P-Ew)" in study
