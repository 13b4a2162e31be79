"""``exactrb info`` and ``exactrb tune``, and what entries of the catalogues say of themselves."""

import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.command.main import main


def test_info_names_what_there_is(capsys):
    assert main(["info"]) == 0
    said = capsys.readouterr().out
    for name in ("Reference", openmm.__version__, rb.__version__, *map(repr, rb.SCHEMES), *map(repr, rb.ROTORS)):
        assert name in said


def test_tune_is_that_of_the_module(serialised, capsys):
    options = ["--schemes", "V2", "--platform", "Reference", "--duration", "0.05", "--target", "1e-12", "--quiet"]
    assert main(["tune", *map(str, serialised), *options]) == 1
    out, errors = capsys.readouterr()
    assert "was not reached" in " ".join(out.split())
    assert errors == ""
    assert main(["tune", *map(str, serialised[::-1])]) == 2
    assert "holds a State, not a System" in capsys.readouterr().err


@pytest.mark.parametrize("entry", [*rb.SCHEMES.values(), *rb.ROTORS.values()], ids=lambda entry: entry.name)
def test_an_entry_is_one_line(entry):
    line = repr(entry)
    assert f"({entry.name!r}, " in line
    assert "\n" not in line
    assert len(line) <= 120


def test_an_integrator_tells_what_decides_its_steps():
    integrator = rb.ExactRigidBodyIntegrator(4 * openmm.unit.femtoseconds, scheme="S2_2", rotor="dmv6")
    assert repr(integrator) == "ExactRigidBodyIntegrator(0.004 ps, scheme='S2_2', rotor='dmv6')"


def test_the_version_is_that_of_the_distribution():
    from importlib import metadata

    assert rb.__version__ == metadata.version("openmm-exactrb")
