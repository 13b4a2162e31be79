"""The examples run, leave what they promise, and say what is wrong in one line."""

import subprocess
import sys
from pathlib import Path

import mdtraj
import numpy as np
import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(*arguments, example="dipole_fluid.py"):
    return subprocess.run([sys.executable, str(EXAMPLES / example), *arguments], capture_output=True, text=True)


def test_a_run_leaves_trajectory_energies_and_picture(tmp_path):
    done = run("-n", "8", "--duration", "0.4", "--frames", "10", "--compare", "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    for name in ("SRKN4_6b + exact", "V2 + mclachlan_reich"):
        assert name in done.stdout
    for out in (tmp_path / "out", tmp_path / "out" / "compare"):
        trajectory = mdtraj.load(str(out / "trajectory.dcd"), top=str(out / "topology.pdb"))
        table = np.loadtxt(out / "energies.csv", delimiter=",", skiprows=1)
        assert len(trajectory) == len(table)
        np.testing.assert_allclose(table[:, 6], table[:, 2] + table[:, 3] + table[:, 5], rtol=1e-15)
        assert np.abs(table[:, 6] / table[0, 6] - 1.0).max() < 1e-3
    assert (tmp_path / "out" / "energy_error.png").stat().st_size > 10_000


def test_the_papers_start_has_the_wanted_energy(tmp_path):
    done = run("-n", "8", "--duration", "0.1", "--paper", "--energy", "300", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "flies apart" in done.stdout
    table = np.loadtxt(tmp_path / "energies.csv", delimiter=",", skiprows=1)
    assert table[0, 6] == pytest.approx(300.0, rel=1e-14)


def test_files_of_an_earlier_run_are_not_replaced(tmp_path):
    (tmp_path / "energies.csv").write_text("precious")
    done = run("-n", "2", "--duration", "0.1", "--out", str(tmp_path))
    assert done.returncode == 1
    assert "add --overwrite" in done.stderr
    assert (tmp_path / "energies.csv").read_text() == "precious"


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
def test_a_wrong_value_is_one_clear_line(tmp_path, arguments, message):
    done = run(*arguments, "--out", str(tmp_path / "out"))
    assert done.returncode != 0
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("example", "arguments", "files"),
    [
        ("water_box.py", ["--duration", "0.1"], ["topology.pdb", "trajectory.dcd", "energies.csv", "energy_error.png"]),
        ("ions_in_rigid_water.py", ["--steps", "20"], ["topology.pdb", "trajectory.dcd", "temperatures.png"]),
        ("solvated_peptide.py", ["--steps", "20"], ["topology.pdb", "trajectory.dcd", "energy.png"]),
        ("rigid_benzene.py", ["-n", "8", "--steps", "20"], ["topology.pdb", "trajectory.dcd", "cluster.png"]),
        (
            "dielectric_constant.py",
            ["-n", "8", "--equilibration", "0.5", "--duration", "1"],
            ["moments.csv", "energies.csv", "dielectric_constant.png"],
        ),
    ],
)
def test_the_other_examples_leave_their_files(tmp_path, example, arguments, files):
    done = run(*arguments, "--out", str(tmp_path), example=example)
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / file).stat().st_size > 0 for file in files)
    again = run(*arguments, "--platform", "Abacus", "--out", str(tmp_path / "again"), example=example)
    assert again.returncode == 1
    assert not (tmp_path / "again").exists()
    assert "Abacus" in again.stderr
    assert "Traceback" not in again.stderr


def test_the_dielectric_constant_goes_on_where_it_stopped(tmp_path):
    """In the bytes of a run without a break, with momenta drawn at the break and after it."""
    once, twice = tmp_path / "once", tmp_path / "twice"
    common = "-n", "8", "--equilibration", "0.5"
    for folder, durations in ((once, ["2"]), (twice, ["1", "2"])):
        for duration in durations:
            options = "--duration", duration, "--resume", "--out", str(folder)
            done = run(*common, *options, example="dielectric_constant.py")
            assert done.returncode == 0, done.stderr
            assert "dielectric constant" in done.stdout
    for name in ("moments.csv", "energies.csv"):
        assert (once / name).read_bytes() == (twice / name).read_bytes()


def test_rigid_benzene_keeps_its_inner_energy(tmp_path):
    done = run("-n", "8", "--steps", "20", "--out", str(tmp_path), example="rigid_benzene.py")
    before, after = (float(word) for word in done.stdout.split() if word.replace(".", "").isdigit() and "." in word)
    assert before == after > 1.0
