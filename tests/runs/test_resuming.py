"""A run that goes on writes what it would have written without a break."""

import signal
from pathlib import Path

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit
from small_droplets import droplet, go_on, make, same_bytes

import openmm_exactrb as rb
from openmm_exactrb.runs import checkpoint
from peptides import in_water
from starts import simulation_of


def test_bodies_named_by_hand_take_their_shape_from_the_start_not_from_the_checkpoint(tmp_path):
    topology, system, positions = rb.rigid_water(8)
    while system.getNumConstraints():
        system.removeConstraint(0)
    for folder, stops in (("whole", [200]), ("parts", [90, 200])):
        for until in stops:
            integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=np.arange(24).reshape(8, 3).tolist())
            simulation = simulation_of(topology, system, integrator, positions)
            make(tmp_path / folder, resume=True).advance(simulation, until)
    same_bytes(tmp_path / "parts", tmp_path / "whole")


def test_a_flexible_molecule_in_water_continues_with_the_same_bits(tmp_path):
    """With bonded forces nested by default, at 2 fs a force, in a Context of their own that no checkpoint holds."""
    topology, system, positions = in_water()
    for folder, stops in (("whole", [60]), ("parts", [25, 60])):
        for until in stops:
            integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_2")
            simulation = simulation_of(topology, system, integrator, positions)
            integrator.setVelocitiesToTemperature(300.0, 1)
            make(tmp_path / folder, resume=True).advance(simulation, until)
            assert integrator.timings.fast_evaluations > 0
    same_bytes(tmp_path / "parts", tmp_path / "whole")


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
    lines = (half / "energies.csv").read_text(encoding="utf-8").splitlines()
    assert (
        lines[0:1] + lines[2:] == (plain / "energies.csv").read_text(encoding="utf-8").splitlines()
    )  # but for the start
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


def test_a_checkpoint_before_the_first_file_starts_over(half, monkeypatch):
    """As a kill between the first checkpoint and the first frame leaves it."""
    folder = half.parent / "early"
    monkeypatch.setattr(app.PDBFile, "writeFile", lambda *arguments: signal.default_int_handler(2, None))
    with pytest.raises(KeyboardInterrupt):
        make(folder).advance(droplet(), 60)
    monkeypatch.undo()
    assert checkpoint.read(folder / "checkpoint").step == 0
    (folder / "trajectory.dcd").write_bytes(b"half a head")
    go_on(folder)


def test_resume_where_there_is_nothing_begins(tmp_path):
    run = make(tmp_path / "new", resume=True)
    assert not run.resuming
    run.advance(droplet(), 7)
    assert len((tmp_path / "new" / "energies.csv").read_text(encoding="utf-8").splitlines()) == 3


def test_a_run_may_be_made_longer_and_continue_in_the_same_process(half):
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
    assert checkpoint.read(half / "checkpoint").step == 33
    assert not (half / "checkpoint.part").exists()
    run.advance(simulation, 60)  # the same process may try again
    same_bytes(half, half.parent / "whole")


def test_other_reporters_and_integrators_can_be_used(tmp_path):
    topology, system, positions = rb.rigid_water(8)
    for name, stops in (("whole", [20]), ("parts", [9, 20])):
        for until in stops:
            simulation = simulation_of(topology, system, openmm.VerletIntegrator(0.001), positions)
            run = rb.Run(tmp_path / name, resume=True)
            run.add_reporter(app.StateDataReporter, "log.csv", 5, step=True, potentialEnergy=True)
            run.advance(simulation, until)
    assert (tmp_path / "parts" / "log.csv").read_text(encoding="utf-8") == (tmp_path / "whole" / "log.csv").read_text(
        encoding="utf-8"
    )
    assert len((tmp_path / "whole" / "log.csv").read_text(encoding="utf-8").splitlines()) == 6


def test_costs_are_carried_over(half):
    run = make(half, resume=True)
    wall = run.wall
    simulation = droplet()
    run.advance(simulation, 60)
    assert simulation.integrator.timings.evaluations > 60
    assert run.wall > wall > 0.0


def test_dipoles_that_overlap_are_named_at_the_first_step(tmp_path):
    simulation = droplet()
    x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value.copy()
    x[5:10] += x[3] - x[8]  # the centre of body 1 on that of body 0
    simulation.context.setPositions(x * unit.nanometer)
    with pytest.raises(
        rb.NonFiniteError, match=r"step 1, .*body 0 .* nm apart.* All output up to this error is in .*trajectory.dcd"
    ):
        make(tmp_path).advance(simulation, 60)
    assert len(mdtraj.load(str(tmp_path / "trajectory.dcd"), top=str(tmp_path / "topology.pdb"))) == 1
    assert checkpoint.read(tmp_path / "checkpoint").step == 0
    assert simulation.reporters == []
