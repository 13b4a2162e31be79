"""What a run writes is what a reporter asked for, at the steps and times that it says."""

import functools

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit
from small_droplets import droplet, make

import openmm_exactrb as rb
from starts import simulation_of


def in_a_box(integrator=None):
    """Return a Simulation of eight molecules in a periodic box, some of them across its faces."""
    topology, system, positions = rb.rigid_water(8, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.3)
    return simulation_of(
        topology, system, integrator or openmm.VerletIntegrator(0.001), np.asarray(positions._value) + 5.0
    )


@pytest.mark.parametrize("stops", [[40], [15, 40]])
def test_frames_of_an_xtc_file_are_of_the_times_that_it_says(tmp_path, stops):
    for until in stops:
        run = rb.Run(tmp_path, resume=True)
        run.add_reporter(app.XTCReporter, "trajectory.xtc", 10)
        run.add_reporter(rb.EnergyReporter, "energies.csv", 10)
        run.advance(droplet(), until)
    times = np.loadtxt(tmp_path / "energies.csv", delimiter=",", skiprows=1)[:, 1]
    frames = mdtraj.load(str(tmp_path / "trajectory.xtc"), top=str(tmp_path / "topology.pdb"))
    np.testing.assert_allclose(frames.time, times, rtol=1e-6)


def test_a_dcd_file_begins_with_the_first_step(tmp_path):
    make(tmp_path).advance(droplet(), 14)
    head = np.frombuffer((tmp_path / "trajectory.dcd").read_bytes()[8:24], dtype="<i4")
    np.testing.assert_array_equal(head[:3], [3, 0, 7])  # frames, the step of the first one, steps between them


def test_a_part_of_the_atoms_is_written_from_the_start(tmp_path):
    run = rb.Run(tmp_path)
    run.add_reporter(functools.partial(app.XTCReporter, atomSubset=[0, 5]), "part.xtc", 10)
    run.add_reporter(functools.partial(app.DCDReporter, atomSubset=[0, 5]), "part.dcd", 10)
    run.advance(droplet(), 20)
    top = app.Topology()
    residue = top.addResidue("", top.addChain())
    for name in "AB":
        top.addAtom(name, app.Element.getBySymbol("C"), residue)
    top = mdtraj.Topology.from_openmm(top)
    assert [len(mdtraj.load(str(tmp_path / f"part.{kind}"), top=top)) for kind in ("xtc", "dcd")] == [3, 3]


def test_an_xtc_file_that_a_full_disk_cut_is_not_taken_for_whole(tmp_path):
    """OpenMM does not look whether its frames were written: the run says so, and goes on from before."""
    resource = pytest.importorskip("resource", reason="limits of POSIX")
    run, simulation = rb.Run(tmp_path, every=0.0), droplet(n=30)
    run.add_reporter(app.XTCReporter, "trajectory.xtc", 5)
    run.advance(simulation, 20)
    size = (tmp_path / "trajectory.xtc").stat().st_size
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def told(steps):
        limit = size + 300 if simulation.currentStep < 40 else before[0]  # full for a while
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))

    big = rb.Run(tmp_path, resume=True, every=1e9)
    big.add_reporter(app.XTCReporter, "trajectory.xtc", 5)
    try:
        with pytest.raises(OSError, match=r"trajectory.xtc does not contain all .* safe up to step 20"):
            big.advance(simulation, 80, told)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    big.advance(simulation, 80)
    assert len(mdtraj.load(str(tmp_path / "trajectory.xtc"), top=str(tmp_path / "topology.pdb"))) == 17


def test_the_start_is_wrapped_only_for_those_who_want_it(tmp_path):
    run = rb.Run(tmp_path)
    for name, wrapped in (("wrapped", None), ("free", False)):
        run.add_reporter(functools.partial(app.DCDReporter, enforcePeriodicBox=wrapped), f"{name}.dcd", 5)
    simulation = in_a_box()
    x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value
    run.advance(simulation, 5)
    top = mdtraj.Topology.from_openmm(simulation.topology)
    free, wrapped = (mdtraj.load(str(tmp_path / f"{name}.dcd"), top=top).xyz for name in ("free", "wrapped"))
    np.testing.assert_allclose(free[0], x, atol=1e-6)
    assert np.abs(free[1] - free[0]).max() < 0.1
    assert wrapped[0].max() < 2.0


class OfForces:
    """A reporter as in OpenMM's manual: a tuple says what it needs, and its file has a name of its own."""

    def __init__(self, file, interval, append=False):
        self.file, self.interval = open(file, "a" if append else "w"), interval  # noqa: SIM115, PTH123

    def describeNextReport(self, simulation):
        return self.interval - simulation.currentStep % self.interval, False, False, True, False, None

    def report(self, simulation, state):
        largest = np.abs(state.getForces(asNumpy=True)._value).max()
        self.file.write(f"{simulation.currentStep} {largest}\n")


def test_a_reporter_of_ones_own_gets_what_it_asks_for_and_loses_no_line(tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    for folder, stops in ((whole, [20]), (parts, [11, 20])):
        for until in stops:
            run = rb.Run(folder, resume=True)
            run.add_reporter(OfForces, "forces.txt", 2)
            run.advance(droplet(), until)
    assert (whole / "forces.txt").read_text(encoding="utf-8") == (parts / "forces.txt").read_text(encoding="utf-8")
    assert len((whole / "forces.txt").read_text(encoding="utf-8").splitlines()) == 11


def test_lines_that_a_reporter_holds_back_are_in_every_checkpoint(tmp_path):
    """The process may be killed at any time after it."""
    run, simulation = rb.Run(tmp_path, every=0.0), droplet()
    run.add_reporter(OfForces, "forces.txt", 2)
    lengths = []
    run.advance(
        simulation, 30, lambda steps: lengths.append((tmp_path / "forces.txt").read_text(encoding="utf-8").count("\n"))
    )
    assert lengths == [0, 0, 6, 11]  # of the checkpoint before


def test_a_system_without_its_topology_runs(tmp_path):
    system = openmm.System()
    system.addParticle(1.0)
    simulation = simulation_of(app.Topology(), system, rb.ExactRigidBodyIntegrator(0.001), [[0.0, 0.0, 0.0]])
    run = rb.Run(tmp_path)
    run.add_reporter(rb.EnergyReporter, "energies.csv", 5)
    run.advance(simulation, 10)
    assert not (tmp_path / "topology.pdb").exists()


def test_the_start_stays_the_start(tmp_path):
    """Also without a file that grows."""
    run, simulation = rb.Run(tmp_path), droplet()
    run.advance(simulation, 20)
    before = (tmp_path / "topology.pdb").read_bytes()
    simulation.context.setVelocitiesToTemperature(300 * unit.kelvin, 1)
    run.advance(simulation, 400)
    assert (tmp_path / "topology.pdb").read_bytes() == before


def test_a_file_in_a_folder_of_the_folder_continues(tmp_path):
    for until in (10, 20):
        run = rb.Run(tmp_path, resume=True)
        run.add_reporter(rb.EnergyReporter, "tables/energies.csv", 5)
        run.advance(droplet(), until)
    steps = np.loadtxt(tmp_path / "tables" / "energies.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_array_equal(steps, np.arange(0, 21, 5))
