"""Long runs: the drift of an energy, settings of PME, and what is recorded of a protein."""

import math

import numpy as np
import openmm
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.common.records import DOCS, RECORDS, read
from benchmarks.proteins import survival
from benchmarks.water import energy_drift

#: Pages with the gain over 300 ps, the deciding one first.
PAGES = ("which.md", "explanation/benchmarks.md", "appendix/joss.md")
POINT = {"molecules": 64, "cutoff": 0.6, "width": 0.1, "tolerance": 1e-4, "platform": "Reference"}


@pytest.mark.parametrize("slope", [2e-5, -3e-3])  # per ps
def test_a_steady_drift_is_found_with_its_sign_and_in_every_window(slope):
    energies, interval = -40.0 + slope * 0.1 * np.arange(1000), 0.1
    found = {name: float(value) for name, value in energy_drift.measured(energies, interval).items()}
    assert found["drift_a_ns"] == pytest.approx(1000.0 * slope, rel=1e-3)
    for window in (2, 10, 100):
        assert found[f"std_{window}_ps"] == pytest.approx(abs(slope) * window / math.sqrt(12.0), rel=2e-3)
    assert math.isnan(found["std_300_ps"])


def test_a_run_that_diverged_has_no_drift():
    found = energy_drift.measured(np.full(100, np.inf), 0.1)
    assert (found["std_2_ps"], found["drift_a_ns"]) == ("inf", "nan")


def pme(**settings):
    """Return the splitting parameter (1/nm) and the mesh of a Context."""
    context = energy_drift.water(openmm.VerletIntegrator(0.001), POINT | settings)
    (force,) = (force for force in context.getSystem().getForces() if isinstance(force, openmm.NonbondedForce))
    alpha, *mesh = force.getPMEParametersInContext(context)
    return alpha, mesh


def test_a_direct_sum_of_its_own_tolerance_leaves_the_mesh_as_openmm_chooses_it():
    alpha, mesh = pme(direct=1e-4)
    same, as_chosen = pme(direct=1e-4 * (1.0 + 1e-9))
    assert same == pytest.approx(alpha, rel=1e-6)
    assert as_chosen == mesh
    tight, unchanged = pme(direct=1e-8)
    assert tight == pytest.approx(pme(tolerance=1e-8, direct=1e-8)[0], rel=1e-6)
    assert unchanged == mesh


def test_pages_quote_the_gain_over_300_ps():
    """That of W4_4 over Verlet in the box of 216 molecules, and of W2_1 in the same window."""
    runs = [row for row in read(RECORDS / "energy_drift.csv") if row["molecules"] == "216"]
    std = {(row["method"], row["start"]): float(row["std_300_ps"]) for row in runs}
    gains = sorted(std[energy_drift.VERLET, start] / std["W4_4", start] for start in "123")
    texts = [" ".join((DOCS / name).read_text(encoding="utf-8").split()) for name in PAGES]
    for text in texts:
        assert f"{gains[0]:.1f} to {gains[-1]:.1f} times" in text
    share = [std["W2_1", start] / std[energy_drift.VERLET, start] for start in "123" if ("W2_1", start) in std]
    assert {f"{of:.1f}" for of in share} == {"0.3"}
    assert "`W2_1`, 0.3 of Verlet's, hardly grows" in texts[0]
    growth = [float(row["std_300_ps"]) / float(row["std_10_ps"]) for row in runs if row["method"] != "W4_4"]
    assert min(growth) > 0.9
    assert max(growth) < 1.1
    slopes = [float(row["drift_a_ns"]) for row in runs if row["method"] == "W4_4"]
    assert min(slopes) < 0.0 < max(slopes)  # it walks


@pytest.mark.parametrize("seed", range(3))
def test_rmsd_is_that_after_the_best_rotation(seed):
    random = np.random.default_rng(seed)
    x = random.normal(size=(20, 3))
    moved = Rotation.random(random_state=seed).apply(x) + random.normal(size=3)
    assert survival.rmsd(x, moved) == pytest.approx(0.0, abs=1e-6)
    y = moved + 0.3 * random.normal(size=x.shape)
    _, distance = Rotation.align_vectors(x - x.mean(axis=0), y - y.mean(axis=0))
    assert survival.rmsd(x, y) == pytest.approx(distance / math.sqrt(20), rel=1e-6)
    assert survival.rmsd(x, x * [1, 1, -1]) > 0.1  # a mirror image is no rotation


def test_the_row_of_a_run_is_that_of_its_samples_after_the_first_ps(tmp_path):
    course = survival.Course(tmp_path, None, "BAOA", 3)
    course.folder.mkdir()
    names = [name.replace(" ", "_") for name in survival.FREE]
    lines = [",".join(["ps", *names, "processor"])]
    for k in range(101):
        value = 300.0 + (-1.0) ** k if 0.24 * k > survival.BURN else 1e6
        lines.append(",".join([f"{0.24 * k:g}", *[f"{value:g}"] * len(names), f"{0.5 * k:g}"]))
    (course.folder / "samples.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    row = course.found()
    assert (row["integrator"], row["seed"], row["picoseconds"], row["failed"]) == ("BAOA", 3, "24", "no")
    assert float(row["T_tr"]) == pytest.approx(300.0, abs=0.05)
    assert float(row["ms"]) == pytest.approx(0.5 / 0.24 * 8.0, rel=1e-3)
    course.failure.write_text("NonFiniteError\n", encoding="utf-8")
    assert course.found()["failed"] == "yes"
