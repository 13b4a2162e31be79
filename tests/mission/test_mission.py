"""Where there is neither a library nor a compiler, the package integrates soft dipoles by numpy and OpenMM alone."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import openmm_exactrb as rb
from benchmarks.common.records import RECORDS, read
from openmm_exactrb.steps.substeps import DRIFT

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def figure(steps):
    """Return the energy error after a number of steps on the page about guarantees."""
    rows = read(RECORDS / "roundoff.csv")
    (row,) = (
        row
        for row in rows
        if (row["system"], row["variant"], row["quantity"], row["step"]) == ("dipoles", "sums", "energy", str(steps))
    )
    return float(row["rms"])


@pytest.mark.parametrize(
    ("scheme", "h", "steps"),
    [
        pytest.param(*method, steps, marks=[pytest.mark.validate] * ((*method, steps) != ("S6_10", 0.00125, 1000)))
        for method in (("S6_10", 0.00125), ("SRKN6_14a", 0.0025))
        for steps in (1000, 10_000, 100_000)
    ],
)
def test_soft_dipoles_keep_their_energy_to_roundoff(scheme, h, steps, tmp_path):
    """The droplet has 8 dipoles instead of 27, and one start instead of eight: three times the root mean square."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("CXX", "EXACTRB_", "XDG_"))}
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "common")])
    home = tmp_path / "home"
    home.mkdir()
    alone = kept | {"HOME": str(home), "PATH": str(home), "PYTHONPATH": paths}
    command = [sys.executable, str(HERE / "soft_dipoles_in_python.py"), scheme, str(h), str(steps), str(tmp_path)]
    done = subprocess.run(command, env=alone, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "no C++ compiler was found" in done.stderr
    record = json.loads((tmp_path / "record.json").read_text(encoding="utf-8"))
    assert record["forces"] == ["CustomCompoundBondForce", "HarmonicBondForce"]
    assert record["custom"]
    assert not record["of the library"]
    assert record["engine"] == "host"
    drifts = sum(substep is DRIFT for substep, _ in rb.SCHEMES[scheme].sequence)
    assert record["rotations"] == steps * drifts
    assert record["moved"] > 0.5
    assert record["apart"] < 1e-6  # nm, of numbers in single precision
    assert max(map(abs, record["errors"])) < 3.0 * figure(steps)
