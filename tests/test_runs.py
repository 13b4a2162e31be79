"""Runs end in the same bytes after any accident, and nothing half-written is ever read."""

import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb import kernels, runs

EXAMPLES = Path(__file__).parent.parent / "examples"
STEPS, INTERVAL = 4200, 7  # of the droplet below: reports do not fall on the chunks of ten steps
DROPLET = ["dipole_fluid.py", "-n", "4", "--scheme", "V2", "--step", "0.005", "--duration", "21", "--frames", "600"]


@pytest.fixture(scope="module", autouse=True)
def started_quickly():
    """Let processes compute in numpy: some eighty of them start here, and would load numba each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(kernels.SWITCH, "0")
        patch.setenv("TQDM_DISABLE", "1")  # on a busy machine the bar would be a second line of errors
        yield


def command(*arguments, example=DROPLET):
    return [sys.executable, str(EXAMPLES / example[0]), *example[1:], *map(str, arguments)]


def finish(*arguments, example=DROPLET, **options):
    return subprocess.run(command(*arguments, example=example), capture_output=True, text=True, **options)


def launch(*arguments):
    def listen():  # a shell that starts a job in the background has it ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    return subprocess.Popen(command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=listen)


def same_bytes(folder, other):
    """Compare all that a run leaves, but for the dates that OpenMM writes."""
    names = ("energies.csv", "trajectory.dcd", "topology.pdb")
    pairs = [[(place / name).read_bytes() for place in (folder, other)] for name in names]
    assert pairs[0][0] == pairs[0][1]
    dcd = [content[:180] + content[260:] for content in pairs[1]]
    assert dcd[0] == dcd[1]
    pdb = [content.partition(b"\n")[2] for content in pairs[2]]
    assert pdb[0] == pdb[1]


def check_joined(folder, whole):
    """No frame and no line is lost or doubled, and every bit is that of the uninterrupted run."""
    same_bytes(folder, whole)
    steps = np.loadtxt(folder / "energies.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_array_equal(steps, np.arange(0, STEPS + 1, INTERVAL))
    trajectory = mdtraj.load(str(folder / "trajectory.dcd"), top=str(folder / "topology.pdb"))
    assert len(trajectory) == len(steps)
    assert not list(folder.glob("*.part"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The droplet without an accident."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    done = finish("--out", folder)
    assert done.returncode == 0, done.stderr
    return folder


def wait_until_running(process, folder):
    """Wait until a process has changed its folder."""

    def look():
        with contextlib.suppress(FileNotFoundError):
            return [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in sorted(folder.iterdir())]

    before = look()
    while look() == before and process.poll() is None:
        time.sleep(0.002)


def wait_until_stepping(process, folder):
    """Wait until a process has written some frames beside the first: it loads libraries before its first step."""
    wait_until_running(process, folder)
    trajectory = folder / "trajectory.dcd"

    def size():
        return trajectory.stat().st_size if trajectory.exists() else 0

    before = size()
    while size() < before + 1500 and process.poll() is None:
        time.sleep(0.002)


# -- accidents ---------------------------------------------------------------------------------------------------------


def test_a_run_killed_at_random_moments_joins_to_the_bit(tmp_path, whole, pytestconfig):
    folder, kills = tmp_path / "out", 0
    dice = random.Random(os.environ.get("KILL_SEED", 8))
    wanted = 40 if pytestconfig.getoption("--validate") else 20
    places = set()
    while kills < wanted:
        process = launch("--out", folder, "--resume", "--checkpoint", dice.choice((0.0, 0.01, 60.0)))
        if dice.random() < 0.8:  # else while it starts
            wait_until_stepping(process, folder)
            time.sleep(dice.uniform(0.0, 1.5 / wanted))
        else:
            time.sleep(dice.uniform(0.0, 0.8))
        process.kill()
        _, errors = process.communicate()
        assert process.returncode == -signal.SIGKILL, f"the run was over before all kills: {errors}"
        kills += 1
        if (folder / "energies.csv").exists():
            places.add((folder / "energies.csv").stat().st_size)
    assert len(places) > 3  # they did not all hit the same place
    done = finish("--out", folder, "--resume")
    assert done.returncode == 0, done.stderr
    check_joined(folder, whole)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130), (signal.SIGHUP, 129)])
def test_a_signal_ends_the_run_with_a_checkpoint_and_says_how_to_go_on(tmp_path, whole, number, status):
    for attempt in range(5):  # on a busy machine a run may be over before the signal is sent
        out = tmp_path / f"out{attempt}"
        process = launch("--out", out)
        wait_until_stepping(process, out)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
        if process.returncode != 0:
            break
    assert process.returncode == status
    assert b"Traceback" not in errors
    message = errors.decode().strip().splitlines()[-1]
    assert f"{number.name}: stopped at step " in message
    assert "--resume" in message
    step = int(message.split("stopped at step ")[1].split()[0])
    assert 0 < step < STEPS
    assert runs._read(out / "checkpoint").step == step
    done = finish("--out", out, "--resume")
    assert done.returncode == 0, done.stderr
    check_joined(out, whole)


def one_line(errors):
    """Check that errors are one line, beside the progress that a slow machine has time to show."""
    lines = [line for line in errors.splitlines() if line and not line.endswith("step/s]")]
    assert len(lines) == 1, errors
    assert "Traceback" not in errors
    assert "Exception ignored" not in errors
    return errors


@pytest.mark.parametrize("kilobytes", [20, 100])
def test_a_full_disk_is_one_line_and_the_run_goes_on_when_there_is_room(tmp_path, whole, kilobytes):
    """On a file system that is really full, in a mount namespace that goes with the shell."""
    if not shutil.which("unshare") or subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("no rights to mount a small file system")
    disk = tmp_path / "disk"
    disk.mkdir()
    script = f"""
        mount -t tmpfs -o size={kilobytes}k tmpfs {disk}
        "$@" 2> {tmp_path}/full; echo $? > {tmp_path}/status
        "$@" --resume 2>> {tmp_path}/again
        mount -o remount,size=10m {disk}
        "$@" --resume --checkpoint 60 || exit 1
        cp -r {disk}/out {tmp_path}/out
    """
    shell = ["unshare", "-rm", "sh", "-c", script, "sh", *command("--out", disk / "out", "--checkpoint", "0.02")]
    done = subprocess.run(shell, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "status").read_text() == "1\n"
    assert "No space left on device" in one_line((tmp_path / "full").read_text())
    assert "No space left on device" in one_line((tmp_path / "again").read_text())
    check_joined(tmp_path / "out", whole)


def test_a_file_size_limit_is_one_line_and_the_run_goes_on(tmp_path, whole):
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_001, 50_001))

    done = finish("--out", tmp_path / "out", "--checkpoint", "0.05", preexec_fn=limit)
    assert done.returncode == 1
    assert "File too large" in one_line(done.stderr)
    assert f"safe up to step {runs._read(tmp_path / 'out' / 'checkpoint').step}: " in done.stderr
    assert "--resume" in done.stderr
    done = finish("--out", tmp_path / "out", "--resume")
    assert done.returncode == 0, done.stderr
    check_joined(tmp_path / "out", whole)


def test_a_run_that_blows_up_has_all_before_it_on_disk(tmp_path):
    """A step far too large: the error grows until spheres overlap and fly apart."""
    options = ["dipole_fluid.py", "-n", "8", "--step", "7", "--duration", "7000", "--frames", "500"]
    done = finish("--out", tmp_path, example=options)
    assert done.returncode == 1
    error = one_line(done.stderr)
    assert "ps: not finite or faster than light: body" in error
    assert "nm apart" in error
    assert "All before it is on disk" in error
    bad = int(error.split("step ")[1].split(",")[0])
    assert 2 < bad < 1000
    steps = np.loadtxt(tmp_path / "energies.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_array_equal(steps, np.arange(0, bad, 2))
    assert len(mdtraj.load(str(tmp_path / "trajectory.dcd"), top=str(tmp_path / "topology.pdb"))) == len(steps)
    assert runs._read(tmp_path / "checkpoint").step == bad - 1


def test_bodies_named_by_hand_take_their_shape_from_the_start_not_from_the_checkpoint(tmp_path):
    topology, system, positions = rb.rigid_water(8)
    while system.getNumConstraints():
        system.removeConstraint(0)
    for folder, stops in (("whole", [200]), ("parts", [90, 200])):
        for until in stops:
            integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=np.arange(24).reshape(8, 3).tolist())
            simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
            simulation.context.setPositions(positions)
            make(tmp_path / folder, resume=True).advance(simulation, until)
    same_bytes(tmp_path / "parts", tmp_path / "whole")


def test_bodies_named_by_hand_keep_their_shape_to_the_bit(tmp_path):
    benzene = ["rigid_benzene.py", "-n", "4"]
    for arguments in (["--steps", "30"], ["--steps", "13"], ["--steps", "30", "--resume"]):
        folder = tmp_path / ("whole" if arguments == ["--steps", "30"] else "parts")
        done = finish(*arguments, "--out", folder, example=benzene)
        assert done.returncode == 0, done.stderr
    same_bytes(tmp_path / "parts", tmp_path / "whole")


ATOM = "HETATM    1  O   HOH A   1       0.000   0.000   0.000  1.00  0.00           O  "


@pytest.mark.parametrize("content", ["", "END", ATOM, ATOM[:24] + "\nEND\n", "\x88"])
def test_a_wrong_pdb_file_is_one_line_and_leaves_nothing(tmp_path, content):
    (tmp_path / "box.pdb").write_bytes(content.encode("latin1"))
    done = finish("--pdb", tmp_path / "box.pdb", "--out", tmp_path / "out", example=["water_box.py"])
    assert done.returncode == 1
    assert "box.pdb is no PDB file, or a truncated one: " in one_line(done.stderr)
    assert not (tmp_path / "out").exists()


def test_a_pdb_file_without_all_atoms_is_one_line(tmp_path):
    (tmp_path / "box.pdb").write_text(
        f"CRYST1   20.000   20.000   20.000  90.00  90.00  90.00 P 1           1\n{ATOM}\nEND\n"
    )
    done = finish("--pdb", tmp_path / "box.pdb", "--out", tmp_path / "out", example=["water_box.py"])
    assert done.returncode == 1
    assert "HOH" in one_line(done.stderr)
    assert not (tmp_path / "out").exists()


# -- in one process ----------------------------------------------------------------------------------------------------


def droplet(n=4, scheme="V2", h=0.005, trap=0.5, rotor="exact", platform="Reference", groups=None):
    topology, system, positions = rb.dipole_fluid(n, seed=1, trap=trap)
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, rotor=rotor)
    if groups is not None:
        integrator.setIntegrationForceGroups(groups)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform(platform))
    simulation.context.setPositions(positions)
    simulation.context.setVelocitiesToTemperature(30.0, 2)
    return simulation


def make(folder, interval=7, **options):
    run = rb.Run(folder, **options)
    run.add_reporter(app.DCDReporter, "trajectory.dcd", interval)
    run.add_reporter(rb.EnergyReporter, "energies.csv", interval)
    return run


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.fixture
def half(tmp_path):
    """A run stopped at step 33 of 60, and one that was not."""
    make(tmp_path / "half").advance(droplet(), 33)
    make(tmp_path / "whole").advance(droplet(), 60)
    return tmp_path / "half"


def go_on(folder):
    make(folder, resume=True).advance(droplet(), 60)
    same_bytes(folder, folder.parent / "whole")


def test_a_run_writes_what_a_simulation_with_the_same_reporters_does(half):
    plain = half.parent / "plain"
    plain.mkdir()
    simulation = droplet()
    simulation.reporters.append(app.DCDReporter(str(plain / "trajectory.dcd"), 7))
    simulation.reporters.append(rb.EnergyReporter(plain / "energies.csv", 7))
    simulation.step(60)
    simulation.reporters.pop().close()
    simulation.reporters.clear()
    go_on(half)
    lines = (half / "energies.csv").read_text().splitlines()
    assert lines[0:1] + lines[2:] == (plain / "energies.csv").read_text().splitlines()  # but for the start
    frames = [mdtraj.load(str(f / "trajectory.dcd"), top=str(half / "topology.pdb")).xyz for f in (half, plain)]
    np.testing.assert_array_equal(frames[0][1:], frames[1])


def test_half_written_frames_lines_and_checkpoints_are_not_read(half):
    with (half / "trajectory.dcd").open("r+b") as dcd:
        frame = dcd.read()[-264:]
        dcd.write(frame + frame[:100])
        dcd.seek(8)
        dcd.write((99).to_bytes(4, "little"))
    with (half / "energies.csv").open("a") as table:
        table.write("35,0.175,1.2345")
    (half / "checkpoint.part").write_bytes((half / "checkpoint").read_bytes()[:500])
    go_on(half)


def test_a_checkpoint_before_the_first_file_begins_anew(half):
    """As a kill between the first checkpoint and the first frame leaves it."""
    folder = half.parent / "early"
    run = make(folder)
    run._report_start = lambda simulation: (_ for _ in ()).throw(KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        run.advance(droplet(), 60)
    assert runs._read(folder / "checkpoint").step == 0
    (folder / "trajectory.dcd").write_bytes(b"half a head")
    go_on(folder)


def test_resume_where_there_is_nothing_begins(tmp_path):
    run = make(tmp_path / "new", resume=True)
    assert not run.resuming
    run.advance(droplet(), 7)
    assert len((tmp_path / "new" / "energies.csv").read_text().splitlines()) == 3


def test_a_run_may_be_made_longer_and_go_on_in_the_same_process(half):
    run = make(half, resume=True)
    simulation = droplet()
    for until in (40, 41, 60):
        run.advance(simulation, until)
    same_bytes(half, half.parent / "whole")
    assert simulation.reporters == []


def test_a_checkpoint_that_could_not_be_written_leaves_the_one_before(half, monkeypatch):
    run, simulation = make(half, resume=True), droplet()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", lambda part, file: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(OSError, match=r"No space left on device .* safe up to step 33:"):
            run.advance(simulation, 60)
    assert runs._read(half / "checkpoint").step == 33
    assert not (half / "checkpoint.part").exists()
    run.advance(simulation, 60)  # the same process may try again
    same_bytes(half, half.parent / "whole")


def test_other_reporters_and_integrators_can_be_used(tmp_path):
    topology, system, positions = rb.rigid_water(8)
    table = partial(app.StateDataReporter, step=True, potentialEnergy=True)
    for name, stops in (("whole", [20]), ("parts", [9, 20])):
        for until in stops:
            simulation = app.Simulation(
                topology, system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference")
            )
            simulation.context.setPositions(positions)
            run = rb.Run(tmp_path / name, resume=True)
            run.add_reporter(table, "log.csv", 5)
            run.advance(simulation, until)
    assert (tmp_path / "parts" / "log.csv").read_text() == (tmp_path / "whole" / "log.csv").read_text()
    assert len((tmp_path / "whole" / "log.csv").read_text().splitlines()) == 6


def test_costs_are_carried_over(half):
    run = make(half, resume=True)
    wall = run.wall
    simulation = droplet()
    run.advance(simulation, 60)
    assert simulation.integrator.timings.evaluations > 60
    assert run.wall > wall > 0.0


# -- what is refused ---------------------------------------------------------------------------------------------------


def refused(half, message, error=ValueError, options=None, **settings):
    before = contents(half)
    with pytest.raises(error, match=message) as caught:
        make(half, **({"resume": True} | (options or {}))).advance(droplet(**settings), 60)
    assert "\n" not in str(caught.value)
    assert contents(half) == before


def test_a_damaged_checkpoint_is_refused(half):
    file = half / "checkpoint"
    content = file.read_bytes()
    for length in [*range(0, 200, 7), *range(200, len(content), 97), len(content) - 1]:
        file.write_bytes(content[:length])
        refused(half, "no checkpoint|truncated")
    for place in range(0, len(content), 101):
        file.write_bytes(content[:place] + bytes([content[place] ^ 16]) + content[place + 1 :])
        refused(half, "no checkpoint|truncated|another version")
    file.write_bytes(content)
    go_on(half)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n": 5}, "another run: System is 20 particles"),
        ({"trap": 0.6}, "another run: System is 20 particles"),
        ({"scheme": "S2_2"}, "integrator is .* V2, exact in it, but .* S2_2, exact now"),
        ({"rotor": "mclachlan_reich"}, "V2, exact in it, but .* V2, mclachlan_reich now"),
        ({"groups": {0, 2}}, r"V2, exact in it, but .* force groups 0b101, V2, exact now"),
        ({"h": 0.006}, r"step 0.005 ps, .* step 0.006 ps"),
        ({"platform": "CPU"}, "platform is Reference in it, but CPU now"),
        ({"options": {"interval": 5}}, "DCDReporter every 7 steps in it, but DCDReporter every 5 steps now"),
        ({"options": {"settings": {"seed": 1}}}, "setting seed is not there in it, but 1 now"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused_and_nothing_is_done(half, settings, message):
    refused(half, message, **settings)


def test_a_checkpoint_of_another_version_is_refused(half, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(openmm, "__version__", "7.0")
        refused(half, "openmm is .* in it, but 7.0 now")
    with monkeypatch.context() as patch:
        patch.setattr(runs, "_FORMAT", b"99")
        refused(half, "another version of openmm-exactrb, in format 2")
    go_on(half)


def test_a_file_that_was_cut_since_is_refused(half):
    os.truncate(half / "trajectory.dcd", 400)
    refused(half, "trajectory.dcd has 400 bytes, but had")
    (half / "trajectory.dcd").unlink()
    refused(half, "trajectory.dcd has 0 bytes, but had")


@pytest.mark.parametrize("name", ["checkpoint", "trajectory.dcd", "energies.csv", "topology.pdb"])
@pytest.mark.parametrize("resume", [False, True])
def test_files_are_not_replaced_unasked(tmp_path, name, resume):
    (tmp_path / name).write_text("precious")
    error = ValueError if resume and name == "checkpoint" else FileExistsError
    refused(tmp_path, "precious|earlier run|no checkpoint", error, {"resume": resume})


def test_overwrite_replaces_and_resume_comes_first(half):
    make(half, overwrite=True, resume=True).advance(droplet(), 60)
    same_bytes(half, half.parent / "whole")
    make(half, overwrite=True).advance(droplet(), 7)
    assert len((half / "energies.csv").read_text().splitlines()) == 3
    assert len(mdtraj.load(str(half / "trajectory.dcd"), top=str(half / "topology.pdb"))) == 2


def test_two_processes_do_not_work_in_one_folder(half):
    with runs._only_process(half):
        refused(half, "another process is at work", BlockingIOError)
    go_on(half)


@pytest.mark.parametrize("every", [-1.0, float("nan")])
def test_wrong_intervals_are_refused(tmp_path, every):
    with pytest.raises(ValueError, match="number of seconds"):
        rb.Run(tmp_path, every=every)


# -- within a step -----------------------------------------------------------------------------------------------------


def test_signal_handlers_are_there_only_while_it_steps(tmp_path):
    before = [signal.getsignal(number) for number in runs._SIGNALS]
    with pytest.raises(SystemExit) as left:
        make(tmp_path).advance(droplet(), 1000, lambda steps: os.kill(os.getpid(), signal.SIGTERM) if steps else None)
    assert left.value.code == 143
    assert [signal.getsignal(number) for number in runs._SIGNALS] == before
    assert runs._read(tmp_path / "checkpoint").step == 10


def test_a_second_ctrl_c_ends_at_once_and_loses_only_what_came_after_the_checkpoint(half):
    def impatient(steps):
        for _ in range(2 if steps == 10 else 0):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        make(half, resume=True).advance(droplet(), 60, impatient)
    assert runs._read(half / "checkpoint").step == 33
    go_on(half)


def test_dipoles_that_overlap_are_named_at_the_first_step(tmp_path):
    simulation = droplet()
    x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value.copy()
    x[5:10] += x[3] - x[8]  # the centre of body 1 on that of body 0
    simulation.context.setPositions(x * unit.nanometer)
    with pytest.raises(rb.NonFiniteError, match=r"step 1, .*body 0 .* nm apart.* on disk: .*trajectory.dcd"):
        make(tmp_path).advance(simulation, 60)
    assert len(mdtraj.load(str(tmp_path / "trajectory.dcd"), top=str(tmp_path / "topology.pdb"))) == 1
    assert runs._read(tmp_path / "checkpoint").step == 0
    assert simulation.reporters == []


def test_a_file_written_whole_is_there_only_when_it_is_complete(tmp_path):
    file = tmp_path / "file"
    for old in (None, "old"):
        with contextlib.suppress(ZeroDivisionError), rb.written_whole(file) as out:
            out.write("new")
            raise ZeroDivisionError
        assert [f.name for f in tmp_path.iterdir()] == ([] if old is None else ["file"])
        with rb.written_whole(file) as out:
            out.write("old")
        assert file.read_text() == "old"


def test_energy_reporter_appends(tmp_path):
    simulation = droplet()
    for append in (False, True):
        reporter = rb.EnergyReporter(tmp_path / "energies.csv", 1, append=append)
        simulation.reporters = [reporter]
        simulation.step(2)
        reporter.close()
    lines = (tmp_path / "energies.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines] == ["step", "1", "2", "3", "4"]
