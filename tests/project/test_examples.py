"""The examples run, leave what they promise, and say what is wrong in one line."""

import contextlib
import io
import runpy
import subprocess
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import mdtraj
import numpy as np
import pytest

from places import errors_of

EXAMPLES = Path(__file__).parents[2] / "examples"


class Done(NamedTuple):
    """What a script ended with: its status is 1 where it ends with a message, as Python has it."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def run(monkeypatch):
    """Return a function that runs an example as a command does, within this process."""

    def runs(*arguments, example="dipole_fluid.py"):
        script = str(EXAMPLES / example)
        monkeypatch.setattr(sys, "argv", [script, *arguments])
        out, err, code = io.StringIO(), io.StringIO(), 0
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # a script ends, and reporters with open files with it
            try:
                runpy.run_path(script, run_name="__main__")
            except SystemExit as end:
                code = end.code
        plt.close("all")
        if isinstance(code, str):
            return Done(1, out.getvalue(), f"{err.getvalue()}{code}\n")
        return Done(code or 0, out.getvalue(), err.getvalue())

    return runs


def test_a_run_leaves_trajectory_energies_and_picture(run, tmp_path):
    done = run("-n", "8", "--duration", "0.4", "--frames", "10", "--compare", "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    for name in ("SRKN4_6b + exact", "V2 + mclachlan_reich"):
        assert name in done.stdout
    for out in (tmp_path / "out", tmp_path / "out" / "compare"):
        trajectory = mdtraj.load(str(out / "trajectory.dcd"), top=str(out / "topology.pdb"))
        table = np.loadtxt(out / "energies.csv", delimiter=",", skiprows=1)
        assert len(trajectory) == len(table)
        total = table[:, -1]
        np.testing.assert_allclose(total, table[:, 2] + table[:, 3] + table[:, -2], rtol=1e-15)
        assert np.abs(total / total[0] - 1.0).max() < 1e-3
    assert (tmp_path / "out" / "energy_error.png").stat().st_size > 10_000


def test_the_papers_start_has_the_wanted_energy(run, tmp_path):
    done = run("-n", "8", "--duration", "0.1", "--paper", "--energy", "300", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "flies apart" in done.stdout
    table = np.loadtxt(tmp_path / "energies.csv", delimiter=",", skiprows=1)
    assert table[0, -1] == pytest.approx(300.0, rel=1e-14)


def test_files_of_an_earlier_run_are_not_replaced(run, tmp_path):
    (tmp_path / "energies.csv").write_text("precious")
    done = run("-n", "2", "--duration", "0.1", "--out", str(tmp_path))
    assert done.returncode == 1
    assert "(overwrite=True or --overwrite)" in done.stderr
    assert (tmp_path / "energies.csv").read_text(encoding="utf-8") == "precious"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scheme", "RK4"], "invalid choice: 'RK4' (choose from"),
        (["-n", "0"], "'0' is not a whole number of at least 1"),
        (["--step", "nan"], "'nan' is not a positive number"),
        (["--platform", "Abacus"], "there is no platform 'Abacus' here: choose one of Reference"),
        (["-n", "8", "--energy=-1e9"], "is not above the potential energy of the start"),
    ],
)
def test_a_wrong_value_is_one_clear_line(run, tmp_path, arguments, message):
    done = run(*arguments, "--out", str(tmp_path / "out"))
    assert done.returncode != 0
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


def test_a_command_ends_with_a_status_and_its_line(tmp_path):
    """The one test here that starts a process: the others call the script within this one."""
    command = [sys.executable, str(EXAMPLES / "dipole_fluid.py"), "--platform", "Abacus", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    errors = errors_of(done.stderr)
    assert errors.startswith("dipole_fluid.py: there is no platform 'Abacus' here")
    assert errors.count("\n") == 1


LARGE = pytest.mark.validate  # seconds, and `make docs` runs it too


@pytest.mark.parametrize(
    ("example", "arguments", "files"),
    [
        pytest.param("water_box.py", ["--duration", "0.1"], ["energies.csv", "energy_error.png"], marks=LARGE),
        pytest.param("ions_in_rigid_water.py", ["--steps", "20"], ["temperatures.png"], marks=LARGE),
        pytest.param("solvated_peptide.py", ["--steps", "20"], ["energy.png"], marks=LARGE),
        ("rigid_benzene.py", ["-n", "8", "--steps", "20"], ["cluster.png"]),
        pytest.param("rigid_domains.py", ["--steps", "50"], ["energies.csv", "protein.png"], marks=LARGE),
        pytest.param(
            "stockmayer_fluid.py",
            ["-n", "27", "--equilibration", "0.6", "--duration", "1.8"],
            ["moments.csv", "stockmayer_fluid.png"],
            marks=LARGE,
        ),
        pytest.param("ferrofluid.py", ["-n", "27", "--duration", "1"], ["ferrofluid.png"], marks=LARGE),
        pytest.param(
            "ellipsoids.py",
            ["--pressures", "2", "5", "--duration", "3"],
            ["ellipsoids.csv", "ellipsoids.png"],
            marks=LARGE,
        ),
    ],
)
def test_the_other_examples_leave_their_files(run, tmp_path, example, arguments, files):
    done = run(*arguments, "--out", str(tmp_path), example=example)
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / file).stat().st_size > 0 for file in ["topology.pdb", "trajectory.dcd", *files])
    if example == "rigid_benzene.py":  # keeps its inner energy
        before, after = (float(word) for word in done.stdout.split() if word.replace(".", "").isdigit() and "." in word)
        assert before == after > 1.0


@pytest.mark.parametrize(
    ("example", "arguments"),
    [
        ("water_box.py", []),
        ("ions_in_rigid_water.py", []),
        ("solvated_peptide.py", []),
        ("rigid_benzene.py", ["-n", "8"]),
        ("rigid_domains.py", []),
        ("dielectric_constant.py", ["-n", "8"]),
    ],
)
def test_a_platform_that_is_not_there_is_reported_and_nothing_is_left(run, tmp_path, example, arguments):
    """Up to there a script has parsed its command line, made its molecules and its System."""
    done = run(*arguments, "--platform", "Abacus", "--out", str(tmp_path / "out"), example=example)
    assert done.returncode == 1
    assert not (tmp_path / "out").exists()
    assert "Abacus" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_dielectric_constant_continues_where_it_stopped(run, tmp_path):
    """In the bytes of a run without a break, with momenta drawn at the break and after it."""
    once, twice = tmp_path / "once", tmp_path / "twice"
    common = "-n", "8", "--equilibration", "0.5"
    for folder, durations in ((once, ["2"]), (twice, ["1", "2"])):
        for duration in durations:
            options = "--duration", duration, "--resume", "--out", str(folder)
            done = run(*common, *options, example="dielectric_constant.py")
            assert done.returncode == 0, done.stderr
            assert "dielectric constant" in done.stdout
    assert (once / "dielectric_constant.png").stat().st_size > 0
    for name in ("moments.csv", "energies.csv"):
        assert (once / name).read_bytes() == (twice / name).read_bytes()
