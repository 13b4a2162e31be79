"""Runs end in the same bytes after any accident, and nothing half-written is ever read."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import mdtraj
import numpy as np
import pytest
from processes import finish, launch
from small_droplets import ENDLESS, beyond, check_joined, command, one_line

from openmm_exactrb.runs import checkpoint


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The droplet without an accident."""
    folder = tmp_path_factory.mktemp("whole")
    finished(folder / "errors", *command(), "--out", folder / "out")
    return folder / "out"


def finished(errors_file, *arguments):
    """Run a script to its end."""
    status, errors = finish(errors_file, *arguments)
    assert status == 0, errors


def check_resumed(folder):
    """Resume a run of the droplet that was cut short, and compare it with one that was not."""
    end, whole = beyond(folder), folder.with_name("uninterrupted")
    finished(folder.with_name("errors"), *command(end), "--out", folder, "--resume")
    finished(folder.with_name("errors"), *command(end), "--out", whole)
    check_joined(folder, whole, end)


def wait_until_running(process, folder):
    """Wait until a process has changed its folder."""

    def look():
        with contextlib.suppress(FileNotFoundError):
            return [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in sorted(folder.iterdir())]

    before = look()
    while look() == before and process.running:
        time.sleep(0.002)


def wait_until_stepping(process, folder):
    """Wait until a process has written some frames beside the first: it loads libraries before its first step."""
    wait_until_running(process, folder)
    trajectory = folder / "trajectory.dcd"

    def size():
        return trajectory.stat().st_size if trajectory.exists() else 0

    before = size()
    while size() < before + 1500 and process.running:
        time.sleep(0.002)


def test_a_run_killed_at_random_moments_joins_to_the_bit(tmp_path, pytestconfig):
    folder, kills = tmp_path / "out", 0
    dice = random.Random(os.environ.get("KILL_SEED", 8))
    wanted = 40 if pytestconfig.getoption("--validate") else 6
    places = set()
    while kills < wanted:
        often = dice.choice((0.0, 0.01, 60.0))
        process = launch(tmp_path / "errors", *ENDLESS, "--out", folder, "--resume", "--checkpoint", often)
        if dice.random() < 0.8:  # else while it starts
            wait_until_stepping(process, folder)
            time.sleep(dice.uniform(0.0, 0.4 / wanted))
        else:
            time.sleep(dice.uniform(0.0, 0.4))
        process.send(signal.SIGKILL)
        assert process.status() == -signal.SIGKILL, process.errors
        kills += 1
        if (folder / "energies.csv").exists():
            places.add((folder / "energies.csv").stat().st_size)
    assert len(places) > 3  # they did not all hit the same place
    check_resumed(folder)


def test_a_signal_ends_the_run_with_a_checkpoint_and_says_how_to_resume(tmp_path):
    out = tmp_path / "out"
    process = launch(tmp_path / "errors", *ENDLESS, "--out", out)
    wait_until_stepping(process, out)
    process.send(signal.SIGINT)
    assert process.status(600) == 130
    assert "Traceback" not in process.errors
    message = process.errors.strip().splitlines()[-1]
    assert "SIGINT: stopped at step " in message
    assert "--resume" in message
    step = int(message.split("stopped at step ")[1].split()[0])
    assert step > 0
    assert checkpoint.read(out / "checkpoint").step == step
    check_resumed(out)


# In a mount namespace of its own, which goes with the process.
FULL = """
import subprocess, sys
folder, *sys.path[:0] = sys.argv[1:]
from processes import finish
from small_droplets import command

def run(name, *options):
    return finish(f"{folder}/{name}", *command(), "--out", f"{folder}/disk/out", "--checkpoint", 0.02, *options)[0]

if __name__ == "__main__":
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=20k", "tmpfs", f"{folder}/disk"], check=True)
    print(run("full"), run("again", "--resume"))
    subprocess.run(["mount", "-o", "remount,size=10m", f"{folder}/disk"], check=True)
    print(run("errors", "--resume", "--checkpoint", 60))
    subprocess.run(["cp", "-r", f"{folder}/disk/out", f"{folder}/out"], check=True)
"""


def test_a_full_disk_is_one_line_and_the_run_resumes_when_there_is_room(tmp_path, whole):
    """On a file system that is really full."""
    if not shutil.which("unshare") or subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("no rights to mount a small file system")
    (tmp_path / "disk").mkdir()
    script = tmp_path / "full_disk.py"
    script.write_text(FULL)
    process = ["unshare", "-rm", sys.executable, str(script), str(tmp_path), *sys.path]
    done = subprocess.run(process, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "1 1\n0\n"), done.stderr
    assert "No space left on device" in one_line((tmp_path / "full").read_text(encoding="utf-8"))
    assert "No space left on device" in one_line((tmp_path / "again").read_text(encoding="utf-8"))
    check_joined(tmp_path / "out", whole)


def limit_size_of_files():
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (30_001, 30_001))


def test_a_file_size_limit_is_one_line_and_the_run_continues(tmp_path, whole):
    options = "--out", tmp_path / "out", "--checkpoint", 0.05
    status, errors = finish(tmp_path / "errors", *command(), *options, before=limit_size_of_files)
    assert status == 1
    assert "File too large" in one_line(errors)
    assert f"safe up to step {checkpoint.read(tmp_path / 'out' / 'checkpoint').step}: " in errors
    assert "--resume" in errors
    finished(tmp_path / "errors", *command(), "--out", tmp_path / "out", "--resume")
    check_joined(tmp_path / "out", whole)


@pytest.mark.usefixtures("whole")  # kernels are compiled by then
def test_a_run_that_blows_up_has_all_before_it_on_disk(tmp_path):
    """A step too large: after some of them spheres overlap and fly apart."""
    options = "-n", 8, "--step", 0.3, "--duration", 300, "--frames", 500, "--out", tmp_path / "out"
    status, errors = finish(tmp_path / "errors", "dipole_fluid.py", *options)
    assert status == 1
    error = one_line(errors)
    assert "the total energy by" in error
    assert "nm apart" in error
    assert "All output up to this error is in" in error
    bad = int(error.split("step ")[1].split(",")[0])
    assert 2 < bad < 1000
    out = tmp_path / "out"
    steps = np.loadtxt(out / "energies.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_array_equal(steps, np.arange(0, bad, 2))
    assert len(mdtraj.load(str(out / "trajectory.dcd"), top=str(out / "topology.pdb"))) == len(steps)
    assert checkpoint.read(out / "checkpoint").step == bad - 1
