"""Scripts that advance more than once, two processes in one folder, and refusals before anything is lost."""

import numpy as np
import openmm
import pytest
from small_droplets import droplet, make, same_bytes

import openmm_exactrb as rb
from openmm_exactrb.runs import checkpoint
from starts import simulation_of


def test_a_script_that_advances_twice_is_resumed_in_the_second_call(tmp_path):
    def script(folder, until, resume=False):
        run, simulation = make(folder, resume=resume), droplet()
        run.advance(simulation, 20)
        run.advance(simulation, until)

    script(tmp_path / "whole", 60)
    script(tmp_path / "half", 33)
    script(tmp_path / "half", 60, resume=True)
    same_bytes(tmp_path / "half", tmp_path / "whole")


def complain(steps):
    raise RuntimeError("no")


@pytest.mark.parametrize("again", ["the same run", "one that goes on"])
def test_a_finished_run_is_not_deleted_by_one_that_fails_at_once(tmp_path, again):
    run, simulation = make(tmp_path), droplet()
    run.advance(simulation, 33)
    before = {file.name: file.stat().st_size for file in tmp_path.iterdir()}
    if again == "one that goes on":
        run, simulation = make(tmp_path, resume=True), droplet()
    with pytest.raises(RuntimeError):
        run.advance(simulation, 60, complain)
    assert {file.name: file.stat().st_size for file in tmp_path.iterdir()} == before


def test_what_another_process_did_meanwhile_is_seen(half):
    late, fresh = make(half, resume=True), rb.Run(half.parent / "new")
    make(half, resume=True).advance(droplet(), 60)
    late.advance(droplet(), 40)  # which is behind
    same_bytes(half, half.parent / "whole")
    make(half.parent / "new").advance(droplet(), 7)
    with pytest.raises(FileExistsError, match="to an earlier run"):
        fresh.advance(droplet(), 60)


def test_a_run_that_another_process_took_over_is_refused(half):
    run, simulation = make(half, resume=True), droplet()
    run.advance(simulation, 40)
    make(half, resume=True).advance(droplet(), 50)
    with pytest.raises(ValueError, match=r"another process has continued the run in .*resume=True"):
        run.advance(simulation, 60)


def test_a_run_that_is_overwritten_leaves_no_file_of_the_old_one(half):
    run = rb.Run(half, overwrite=True)
    run.add_reporter(rb.EnergyReporter, "other.csv", 5)
    run.advance(droplet(), 10)
    assert {file.name for file in half.iterdir()} == {"checkpoint", "topology.pdb", "other.csv"}


def test_a_first_checkpoint_that_could_not_be_written_is_tried_again(tmp_path, monkeypatch):
    run, simulation = make(tmp_path), droplet()
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", lambda *arguments: (_ for _ in ()).throw(OSError(28, "No space left")))
        with pytest.raises(OSError, match="No space left"):
            run.advance(simulation, 10)
    run.advance(simulation, 10)
    assert len((tmp_path / "energies.csv").read_text(encoding="utf-8").splitlines()) == 3


def numbers(last):
    x = np.zeros(2000)
    x[1500] = last
    return x


@pytest.mark.parametrize(
    ("settings", "others"),
    [
        ({"x": numbers(1.0)}, {"x": numbers(2.0)}),
        ({"x": [1.0, 0.1]}, {"x": [1.0, 0.1 + 1e-12]}),
        ({"call": numbers}, {"call": complain}),
    ],
)
def test_settings_are_compared_to_the_last_digit(tmp_path, settings, others):
    make(tmp_path, settings=settings).advance(droplet(), 10)
    make(tmp_path, settings=settings, resume=True).advance(droplet(), 12)
    with pytest.raises(ValueError, match="another run, in which setting"):
        make(tmp_path, settings=others, resume=True).advance(droplet(), 20)


def test_a_system_that_cannot_be_serialised_is_refused(tmp_path):
    topology, system, positions = rb.dipole_fluid(4, seed=1, trap=0.5)
    system.addForce(openmm.PythonForce(lambda state: (0.0, np.zeros((20, 3)))))
    simulation = simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.005), positions)
    with pytest.raises(ValueError, match="OpenMM cannot serialise the System of this run"):
        make(tmp_path).advance(simulation, 10)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("leave", [lambda s: s.step(7), lambda s: setattr(s, "currentStep", 0)])
def test_a_simulation_that_left_the_last_step_between_two_calls_is_refused(tmp_path, leave):
    """Lines of steps would be lost or repeated."""
    run, simulation = make(tmp_path), droplet()
    run.advance(simulation, 20)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    leave(simulation)
    with pytest.raises(ValueError, match=r"the Simulation is at step \d+, but the run is at step 20: resume the run"):
        run.advance(simulation, 40)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
