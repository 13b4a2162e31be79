"""Every stock reporter writes what the Context holds, and its file is read back."""

import io

import mdtraj
import numpy as np
import openmm
import pytest
from boxes import coordinates, energy, quietly, water
from openmm import app, unit


def frames_of(kind, folder):
    """Run with a reporter of coordinates; return what it wrote and what the Context held, in nm."""
    simulation = water()
    file = folder / "run"
    simulation.reporters.append(kind(str(file), 2, enforcePeriodicBox=False))
    held = []
    for _ in range(3):
        quietly(simulation.step, 2)
        held.append(coordinates(simulation))
    simulation.reporters.clear()
    return simulation.topology, file, np.array(held)


def of_mdtraj(file, interval, enforcePeriodicBox):
    return mdtraj.reporters.DCDReporter(file, interval)


@pytest.mark.filterwarnings("ignore:Casting xyz")  # mdtraj's reporter warns of its own conversion to float32
@pytest.mark.parametrize(("kind", "suffix"), [(app.DCDReporter, "dcd"), (app.XTCReporter, "xtc"), (of_mdtraj, "dcd")])
def test_trajectories(kind, suffix, tmp_path):
    topology, file, held = frames_of(kind, tmp_path)
    read = mdtraj.load(str(file.rename(f"{file}.{suffix}")), top=mdtraj.Topology.from_openmm(topology))
    apart = read.xyz - held
    apart -= np.round(apart) * (kind is of_mdtraj)  # which brings molecules into the box, whose sides are 1 nm
    assert np.abs(apart).max() < (1e-3 if suffix == "xtc" else 1e-5)


@pytest.mark.parametrize(("kind", "read"), [(app.PDBReporter, app.PDBFile), (app.PDBxReporter, app.PDBxFile)])
def test_structures(kind, read, tmp_path):
    _, file, held = frames_of(kind, tmp_path)
    structure = read(str(file))
    assert structure.getNumFrames() == 3
    for frame, x in enumerate(held):
        written = structure.getPositions(asNumpy=True, frame=frame).value_in_unit(unit.nanometer)
        np.testing.assert_allclose(written, x, atol=1e-4)


def test_state_data():
    simulation, out = water(), io.StringIO()
    simulation.reporters.append(
        app.StateDataReporter(
            out, 2, step=True, time=True, potentialEnergy=True, kineticEnergy=True, totalEnergy=True, temperature=True,
            volume=True, density=True, speed=True, progress=True, remainingTime=True, totalSteps=6, elapsedTime=True,
        )
    )  # fmt: skip
    quietly(simulation.step, 6)
    lines = [line.split(",") for line in out.getvalue().splitlines()]
    assert len(lines) == 4
    last = dict(zip(lines[0], lines[-1], strict=True))
    total = next(float(value) for name, value in last.items() if "Total Energy" in name)
    time = next(float(value) for name, value in last.items() if "Time (ps)" in name)
    assert time == pytest.approx(0.012, rel=1e-12)
    warmth = next(float(value) for name, value in last.items() if "Temperature" in name)
    assert total == pytest.approx(energy(simulation), rel=1e-12)
    kinetic = simulation.context.getState(energy=True).getKineticEnergy()
    freedom = sum(simulation.integrator.degreesOfFreedom())
    expected = 2.0 * kinetic / (freedom * unit.MOLAR_GAS_CONSTANT_R)
    assert warmth == pytest.approx(expected.value_in_unit(unit.kelvin), rel=1e-6)


@pytest.mark.parametrize("whole", [False, True])
def test_checkpoints(whole, tmp_path):
    simulation, twin = water(), water()
    file = tmp_path / "checkpoint"
    simulation.reporters.append(app.CheckpointReporter(str(file), 2, writeState=whole))
    quietly(simulation.step, 2)
    simulation.reporters.clear()
    twin.loadState(str(file)) if whole else twin.loadCheckpoint(str(file))
    for one in (simulation, twin):
        quietly(one.step, 3)
    assert twin.currentStep == 5
    np.testing.assert_array_equal(coordinates(simulation), coordinates(twin))


def test_all_at_once_with_an_odd_interval_each(tmp_path):
    simulation = water()
    kinds = [app.DCDReporter, app.XTCReporter, app.PDBReporter, app.PDBxReporter, app.CheckpointReporter]
    for interval, kind in enumerate(kinds, 2):
        simulation.reporters.append(kind(str(tmp_path / kind.__name__), interval))
    quietly(simulation.step, 13)
    assert simulation.currentStep == simulation.context.getStepCount() == 13
    simulation.reporters.clear()
    assert all(file.stat().st_size for file in tmp_path.iterdir())
    assert isinstance(simulation.context.getState(), openmm.State)
