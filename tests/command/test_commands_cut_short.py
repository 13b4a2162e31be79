"""Commands that end or meet each other before their first step."""

import signal
import time

import pytest
from openmm import app
from processes_of_command import launch

from openmm_exactrb.command.main import main
from openmm_exactrb.runs.lock import only_process

SHORT = "--forcefield", "tip3p.xml", "--step", "2fs", "--interval", "4fs", "--duration", "20fs"
PLAIN = "--platform", "Reference", "--quiet", "--no-picture"
LONG, BRIEF = ("--equilibration", "100"), ("--equilibration", "0.01")


def carry_out(capsys, *arguments):
    """Carry out the command in this process; return its exit status, output and errors."""
    return main(list(map(str, arguments))), *capsys.readouterr()


def wait(process, happened):
    """Wait until something happened, or the process is over."""
    while process.poll() is None and not happened():
        time.sleep(0.02)


@pytest.fixture
def run(droplet, tmp_path):
    """A command in a folder, but for the equilibration."""
    return "run", droplet, *SHORT, *PLAIN, "--out", tmp_path / "out"


@pytest.fixture
def heard():
    """Have processes that are started hear Ctrl-C, also if what started the tests had it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def killed_before_the_first_step(folder):
    """Leave in a folder what a kill between preparation and run leaves."""
    for file in folder.iterdir():
        if file.name not in ("command.json", "start.xml"):
            file.unlink()


def test_what_was_prepared_is_gone_on_with(run, tmp_path, capsys):
    assert carry_out(capsys, *run, *BRIEF)[0] == 0
    out = tmp_path / "out"
    energies, start = (out / "energies.csv").read_bytes(), (out / "start.xml").stat()
    killed_before_the_first_step(out)
    assert carry_out(capsys, *run, *BRIEF)[0] == 2
    status, _, errors = carry_out(capsys, *run, *BRIEF, "--resume")
    assert (status, errors) == (0, "")
    assert (out / "start.xml").stat().st_mtime_ns == start.st_mtime_ns
    assert (out / "energies.csv").read_bytes() == energies


def test_a_step_may_change_until_it_was_measured(run, tmp_path, capsys):
    """After a target that nothing reaches the start need not be prepared again."""
    assert carry_out(capsys, *run, *BRIEF)[0] == 0
    out = tmp_path / "out"
    start = (out / "start.xml").stat()
    killed_before_the_first_step(out)
    assert carry_out(capsys, *run, *BRIEF, "--step", "0.5fs", "--resume")[0] == 0
    assert (out / "start.xml").stat().st_mtime_ns == start.st_mtime_ns
    killed_before_the_first_step(out)
    (out / "step.json").write_text('{"scheme": "S2_2", "fast": null, "step": 0.0005}')
    _, _, errors = carry_out(capsys, *run, *BRIEF, "--resume")
    assert "command.json is of another run: setting step is 0.0005 in it, but " in errors


@pytest.mark.parametrize("other", ["setting temperature", "setting seed", "System", "start"])
def test_what_another_command_prepared_is_refused(run, droplet, tmp_path, capsys, other):
    assert carry_out(capsys, *run, *BRIEF)[0] == 0
    killed_before_the_first_step(tmp_path / "out")
    before = (tmp_path / "out" / "start.xml").read_bytes()
    options = {"setting temperature": ("--temperature", "200"), "setting seed": ("--seed", "2")}.get(other, ())
    if other == "System":
        run = [word if word != "tip3p.xml" else "spce.xml" for word in run]
    if other == "start":
        content = app.PDBFile(str(droplet))
        with droplet.open("w") as out:
            app.PDBFile.writeFile(content.topology, 1.01 * content.positions, out)
    status, said, errors = carry_out(capsys, *run, *BRIEF, *options, "--resume")
    assert (status, said, errors.count("\n")) == (2, "", 1)
    assert f"command.json is of another run: {other} is " in errors
    assert (tmp_path / "out" / "start.xml").read_bytes() == before


def test_a_description_that_is_damaged_is_refused(run, tmp_path, capsys):
    assert carry_out(capsys, *run, *BRIEF)[0] == 0
    killed_before_the_first_step(tmp_path / "out")
    (tmp_path / "out" / "command.json").write_text("[1")
    status, _, errors = carry_out(capsys, *run, *BRIEF, "--resume")
    assert (status, errors.count("\n")) == (2, 1)
    assert "command.json is damaged:" in errors


def test_a_run_that_was_to_be_overwritten_does_not_come_back(run, tmp_path, capsys):
    """Killed before its first step, the new run is begun again, and not the old one gone on with."""
    out = tmp_path / "out"
    assert carry_out(capsys, *run, *BRIEF, "--ensemble", "nvt")[0] == 0
    (out / "picture.png").write_text("of the old run")
    process = launch(*run, *LONG, "--overwrite")
    wait(process, lambda: not (out / "picture.png").exists())
    process.kill()
    process.communicate()
    assert list(out.iterdir()) == []
    assert carry_out(capsys, *run, *BRIEF, "--resume")[0] == 0
    alone = tmp_path / "alone"
    assert carry_out(capsys, *run, *BRIEF, "--out", alone)[0] == 0
    assert (out / "energies.csv").read_bytes() == (alone / "energies.csv").read_bytes()


def test_a_second_command_in_a_folder_prepares_nothing(run, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    with only_process(out):
        for options in ((), ("--resume",), ("--overwrite",)):
            status, said, errors = carry_out(capsys, *run, *LONG, *options)
            assert (status, said, errors) == (2, "", f"exactrb run: another process is running in {out}\n")
    assert list(out.iterdir()) == []


def test_ctrl_c_in_the_equilibration_is_one_line(run, tmp_path, heard, capsys):
    process = launch(*run, *LONG)
    wait(process, (tmp_path / "out").exists)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate()
    assert (process.returncode, said) == (130, "")
    assert errors == "exactrb run: SIGINT: stopped; resume it by the same command and --resume\n"
    assert carry_out(capsys, *run, *BRIEF, "--resume")[0] == 0


def test_ctrl_c_in_a_tuning_is_one_line(serialised, heard):
    process = launch("tune", *serialised, "--platform", "Reference", "--horizon", "1000")
    told = process.stderr.readline()
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate()
    assert (process.returncode, said) == (130, "")
    assert "V2" in told
    assert errors.splitlines()[-1] == "exactrb tune: SIGINT: stopped"
    assert "Traceback" not in errors
