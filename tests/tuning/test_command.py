"""The command gives the same advice from files, and says what is wrong in one line."""

import json
import subprocess
import sys

import openmm
import pytest

from openmm_exactrb.tuning.__main__ import main


@pytest.fixture
def files(droplet, tmp_path):
    """The droplet in files."""
    files = [tmp_path / "system.xml", tmp_path / "state.xml"]
    for file, content in zip(files, droplet, strict=True):
        file.write_text(openmm.XmlSerializer.serialize(content))
    return files


def test_the_command(files, tmp_path):
    options = ["--schemes", "S2_2", "--platform", "Reference", "--duration", "0.2", "--target", "1e-2", "--json"]
    command = [sys.executable, "-m", "openmm_exactrb.tuning", *files, *options, "--output", tmp_path / "picture.png"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["chosen"]["method"] == "S2_2"
    assert "S2_2, " in done.stderr
    assert "Warning" not in done.stderr
    assert (tmp_path / "picture.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["state.xml", "system.xml"], "holds a State, not a System"),
        (["system.xml", "nowhere.xml"], "nowhere.xml"),
        (["picture.png", "state.xml"], "was not written by openmm.XmlSerializer"),
        (["system.xml", "state.xml", "--target=-1"], "target must be a positive number"),
    ],
)
def test_a_wrong_call_is_one_line(files, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "picture.png").write_text("a picture")
    assert main(arguments) == 2
    out, errors = capsys.readouterr()
    assert errors.startswith("tune: ")
    assert message in errors
    assert errors.count("\n") == 1
    assert out == ""


def test_a_target_out_of_reach_has_a_status_of_its_own(files, capsys):
    options = ["--schemes", "V2", "--platform", "Reference", "--duration", "0.05", "--target", "1e-12", "--quiet"]
    assert main([*map(str, files), *options]) == 1
    out, errors = capsys.readouterr()
    assert "was not reached" in " ".join(out.split())
    assert errors == ""
