"""What does not fit is refused in one sentence, and nothing is changed."""

import os

import mdtraj
import openmm
import pytest
from openmm import app
from small_droplets import droplet, go_on, make, same_bytes

import openmm_exactrb as rb
from openmm_exactrb.runs import checkpoint
from openmm_exactrb.support.lock import only_process
from starts import simulation_of


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


@pytest.mark.parametrize("every", [-1.0, float("nan")])
def test_wrong_intervals_are_refused(tmp_path, every):
    with pytest.raises(ValueError, match="number of seconds"):
        rb.Run(tmp_path, every=every)


def half_of(folder, simulation):
    """Run 20 steps in a folder."""
    run = rb.Run(folder, resume=True)
    run.add_reporter(app.DCDReporter, "trajectory.dcd", 10)
    run.advance(simulation, 20)


def with_integrator(integrator):
    topology, system, positions = rb.dipole_fluid(4, seed=1, trap=0.5)
    return simulation_of(topology, system, integrator, positions)


def own_scheme(weight):
    """Return a scheme whose name does not tell the weight of its outer drifts."""
    return rb.schemes.symmetric("mine", order=2, stages=2, first="drift", a=(weight,))


@pytest.mark.parametrize(
    ("make_integrator", "values"),
    [
        (lambda T: openmm.LangevinMiddleIntegrator(T, 1.0, 0.005), (30, 60)),
        (lambda T: openmm.MTSLangevinIntegrator(T, 1.0, 0.005, [(0, 1)]), (30, 60)),
        (lambda w: rb.ExactRigidBodyIntegrator(0.005, scheme=own_scheme(w)), (0.19, 0.3)),
    ],
)
def test_a_run_of_other_settings_that_a_name_does_not_tell_is_refused(tmp_path, make_integrator, values):
    half_of(tmp_path, with_integrator(make_integrator(values[0])))
    half_of(tmp_path, with_integrator(make_integrator(values[0])))  # the same goes on
    with pytest.raises(ValueError, match="another run, in which integrator"):
        half_of(tmp_path, with_integrator(make_integrator(values[1])))


def test_a_run_of_other_canonical_momenta_is_refused(tmp_path):
    def of(temperature):
        simulation = with_integrator(rb.ExactRigidBodyIntegrator(0.005, scheme="V2"))
        simulation.reporters.append(rb.CanonicalMomenta(temperature, 5, 1))
        return simulation

    half_of(tmp_path, of(30.0))
    half_of(tmp_path, of(30.0))
    with pytest.raises(ValueError, match=r"another run, in which CanonicalMomenta was 30\.0 K every 5 steps"):
        half_of(tmp_path, of(60.0))
