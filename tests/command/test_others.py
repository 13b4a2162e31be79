"""``exactrb info`` and ``exactrb tune``, and what entries of the catalogues say of themselves."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.command import info
from openmm_exactrb.command.main import main

INTEGRATORS = [name for name in rb.__all__ if name.endswith("Integrator")]
FULL = Path("/dev/full")
BRIEF = ["--schemes", "V2", "--platform", "Reference", "--duration", "0.05", "--target", "1e-12"]


def test_info_names_what_there_is(capsys):
    assert main(["info"]) == 0
    said = capsys.readouterr().out
    for name in ("Reference", openmm.__version__, rb.__version__, *INTEGRATORS):
        assert name in said
    assert said.count("Scheme(") == 5
    assert len(said.splitlines()) < 27


@pytest.mark.parametrize("options", [[], ["-u"]], ids=["at the end", "line by line"])
def test_who_reads_no_further_sees_no_error(options):
    """As head does not. The pipe is closed before the first line, so that it is none of time."""
    read, write = os.pipe()
    os.close(read)
    done = said_by(options, write)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.skipif(not FULL.exists(), reason="a device of Linux")
@pytest.mark.parametrize("options", [[], ["-u"]], ids=["at the end", "line by line"])
def test_output_that_cannot_be_written_is_one_line(options):
    with FULL.open("w", encoding="utf-8") as full:
        done = said_by(options, full)
    assert done.returncode == 2
    assert done.stderr == "exactrb info: [Errno 28] No space left on device\n"


def said_by(options, out):
    """Let a process write what is installed, and return its status and its errors."""
    command = [sys.executable, *options, "-m", "openmm_exactrb.command.main", "info"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(command, stdout=out, stderr=subprocess.PIPE, text=True, env=environment, check=False)


def test_a_target_out_of_reach_has_a_status_of_its_own(serialised, capsys):
    assert main(["tune", *map(str, serialised), *BRIEF, "--quiet"]) == 1
    out, errors = capsys.readouterr()
    assert "was not reached" in " ".join(out.split())
    assert errors == ""
    assert main(["tune", *map(str, serialised[::-1])]) == 2
    assert "contains an object of type State, not System" in capsys.readouterr().err


@pytest.mark.parametrize("entry", [*rb.SCHEMES.values(), *rb.ROTORS.values()], ids=lambda entry: entry.name)
def test_an_entry_is_one_line(entry):
    line = repr(entry)
    assert f"({entry.name!r}, " in line
    assert "\n" not in line
    assert len(line) <= 120


def test_an_integrator_shows_what_decides_its_steps():
    integrator = rb.ExactRigidBodyIntegrator(4 * openmm.unit.femtoseconds, scheme="S2_2", rotor="dmv6")
    assert repr(integrator) == (
        "ExactRigidBodyIntegrator(scheme='S2_2', rotor='dmv6'; a step is 4 fs with 2 force evaluations, one every 2 fs)"
    )


def test_the_version_is_that_of_the_distribution():
    from importlib import metadata

    assert rb.__version__ == metadata.version("openmm-exactrb")


def test_a_warning_is_one_line(monkeypatch, capsys):
    def warn(_args):
        warnings.warn("steps are\ntoo long", UserWarning, stacklevel=2)
        return 0

    monkeypatch.setattr(info, "carry_out", warn)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(["info", "some.pdb"]) == 0
    assert capsys.readouterr().err == "exactrb info: warning: steps are too long\n"
