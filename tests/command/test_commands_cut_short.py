"""Commands that end or meet each other before their first step."""

import signal
import time

import pytest
from processes_of_command import launch

from openmm_exactrb.command.main import main
from openmm_exactrb.support.lock import only_process
from places import errors_of

# Status of a command after Ctrl-C. A shell shows 130 for both: CPython ends itself by the signal if it came in exec.
STOPPED = 130, -signal.SIGINT
SHORT = "--forcefield", "tip3p.xml", "--step", "2fs", "--interval", "4fs", "--duration", "20fs"
PLAIN = "--platform", "Reference", "--quiet", "--no-picture"
LONG, BRIEF = ("--equilibrate", "100"), ("--equilibrate", "0.01")


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
        if file.name != "start.xml":
            file.unlink()


@pytest.mark.parametrize("options", [(), ("--temperature", "200")])
def test_a_start_without_a_first_step_is_prepared_again(run, tmp_path, capsys, options):
    """Also by another command, which does not take what the first one left."""
    assert carry_out(capsys, *run, *BRIEF)[0] == 0
    out, alone = tmp_path / "out", tmp_path / "alone"
    killed_before_the_first_step(out)
    assert carry_out(capsys, *run, *BRIEF, *options)[0] == 2
    assert carry_out(capsys, *run, *BRIEF, *options, "--resume")[::2] == (0, "")
    assert carry_out(capsys, *run, *BRIEF, *options, "--out", alone)[0] == 0
    assert (out / "energies.csv").read_bytes() == (alone / "energies.csv").read_bytes()


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
    busy = f"another process is running in {out}: wait until it ends, or use another folder"
    with only_process(out):
        for options in ((), ("--resume",), ("--overwrite",)):
            status, said, errors = carry_out(capsys, *run, *LONG, *options)
            assert (status, said, errors) == (2, "", f"exactrb run: {busy}\n")
    assert list(out.iterdir()) == []


def test_ctrl_c_in_the_equilibration_is_one_line(run, tmp_path, heard, capsys):
    process = launch(*run, *LONG)
    wait(process, (tmp_path / "out").exists)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate()
    assert process.returncode in STOPPED, errors
    assert said == ""
    assert errors_of(errors) == "exactrb run: SIGINT: stopped; to resume the run, repeat the command with --resume\n"
    assert carry_out(capsys, *run, *BRIEF, "--resume")[0] == 0


def test_ctrl_c_in_a_tuning_is_one_line(serialised, heard):
    process = launch("tune", *serialised, "--platform", "Reference", "--horizon", "1000")
    told = next(line for line in process.stderr if errors_of(line))
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate()
    assert process.returncode in STOPPED, errors
    assert said == ""
    assert "errors hold for 1e+03 ps" in told
    assert errors.splitlines()[-1] == "exactrb tune: SIGINT: stopped"
    assert "Traceback" not in errors
