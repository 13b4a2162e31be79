"""What does not fit is refused in one sentence, and nothing is changed."""

import os

import mdtraj
import openmm
import pytest
from small_droplets import droplet, go_on, make, same_bytes

from openmm_exactrb.runs import checkpoint
from openmm_exactrb.support.lock import only_process


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


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
        refused(half, "damaged")
    for place in range(0, len(content), 101):
        file.write_bytes(content[:place] + bytes([content[place] ^ 16]) + content[place + 1 :])
        refused(half, "damaged|another version")
    file.write_bytes(content)
    go_on(half)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n": 5}, "another run, in which System was 20 particles"),
        ({"trap": 0.6}, "another run, in which System was 20 particles"),
        ({"scheme": "S2_2"}, "integrator scheme was V2, .*, but now it is S2_2"),
        ({"rotor": "mclachlan_reich"}, "integrator rotor was .*exact.*, but now it is .*mclachlan_reich"),
        ({"groups": {0, 2}}, "integrator IntegrationForceGroups was -1, but now it is 5"),
        ({"h": 0.006}, "integrator stepSize was 0.005, but now it is 0.006"),
        ({"platform": "CPU"}, "platform was Reference, but now it is CPU"),
        ({"options": {"interval": 5}}, "DCDReporter every 7 steps, but now it is DCDReporter every 5 steps"),
        ({"options": {"settings": {"seed": 1}}}, "setting seed was not there, but now it is 1"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused_and_nothing_is_done(half, settings, message):
    refused(half, message, **settings)


def test_a_checkpoint_of_another_version_is_refused(half, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(openmm, "__version__", "7.0")
        refused(half, "openmm was .*, but now it is 7.0")
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "FORMAT", b"99")
        refused(half, "in format '5' instead of '99': resume the run with that version")
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
    refused(tmp_path, "earlier run|damaged", error, {"resume": resume})


def test_overwrite_replaces_and_resume_comes_first(half):
    make(half, overwrite=True, resume=True).advance(droplet(), 60)
    same_bytes(half, half.parent / "whole")
    make(half, overwrite=True).advance(droplet(), 7)
    assert len((half / "energies.csv").read_text(encoding="utf-8").splitlines()) == 3
    assert len(mdtraj.load(str(half / "trajectory.dcd"), top=str(half / "topology.pdb"))) == 2


def test_two_processes_do_not_work_in_one_folder(half):
    with only_process(half):
        refused(half, "another process is running", BlockingIOError)
    go_on(half)
