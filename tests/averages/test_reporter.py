"""How an AverageReporter continues a file, and what it notices in a run."""

import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.averages.record import read
from starts import topology_of


def simulation_of(integrator, k=50.0, barostat=False):
    """Return a Simulation of three atoms in a well."""
    system, well = openmm.System(), openmm.CustomExternalForce(f"{k}*(x^2+y^2+z^2)+0*periodicdistance(x,y,z,0,0,0)")
    for _ in range(3):
        well.addParticle(system.addParticle(20.0))
    system.addForce(well)
    system.setDefaultPeriodicBoxVectors([3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 3.0])
    if barostat:
        system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, 0))
    simulation = app.Simulation(topology_of(system), system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    simulation.context.setVelocitiesToTemperature(300.0, 2)
    return simulation


def ours():
    return rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002)


def theirs():
    return openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.002)


def first(x):
    return float(x[0, 0])


def reported(simulation, file, steps, interval=2, **options):
    """Return the reporter of a run."""
    reporter = rb.AverageReporter(file, interval, **options)
    simulation.reporters.append(reporter)
    try:
        simulation.step(steps)
    finally:
        reporter.close()
        simulation.reporters.clear()
    return reporter


@pytest.mark.parametrize("make", [ours, theirs])
def test_a_reporter_notices_a_new_system_and_another_simulation(make, tmp_path):
    simulation = simulation_of(make())
    reporter = reported(simulation, tmp_path / "frames.csv", 2)
    simulation.system.setParticleMass(0, 30.0)
    simulation.context.reinitialize(preserveState=True)
    state = simulation.context.getState(positions=True, energy=True, forces=True)
    with pytest.raises(ValueError, match=r"or \(by reinitialize\) the System has changed since the first frame"):
        reporter.report(simulation, state)
    with pytest.raises(ValueError, match="from another Simulation: use a separate AverageReporter for each Simulation"):
        reporter.report(simulation_of(make()), state)


def test_frames_after_the_step_at_which_a_run_continues_are_removed(tmp_path):
    """As those after the last checkpoint of a killed run."""
    file, simulation = tmp_path / "frames.csv", simulation_of(ours())
    reported(simulation, file, 6)
    checkpoint = simulation.context.createCheckpoint()
    reported(simulation, file, 6, append=True)
    assert read(file)[1]["step"].tolist() == [2, 4, 6, 8, 10, 12]
    simulation.context.loadCheckpoint(checkpoint)
    reported(simulation, file, 2, append=True)
    assert read(file)[1]["step"].tolist() == [2, 4, 6, 8]
    before = file.read_text(encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"all frames in .* are after step 0, at which this run begins: load the State"
    ):
        reported(simulation_of(ours()), file, 2, append=True)
    assert file.read_text(encoding="utf-8") == before


@pytest.mark.parametrize(
    ("k", "options"),
    [(60.0, {}), (50.0, {"interval": 1}), (50.0, {"around": ([1], 0.5)}), (50.0, {"observables": {"first": first}})],
)
def test_a_file_of_another_system_or_reporter_is_not_continued(k, options, tmp_path):
    file, simulation = tmp_path / "frames.csv", simulation_of(ours())
    reported(simulation, file, 4, around=([0], 0.5))
    other = simulation_of(ours(), k)
    other.loadState(saved(simulation, tmp_path))
    with pytest.raises(ValueError, match="belongs to a run with other settings"):
        reported(other, file, 2, append=True, **({"around": ([0], 0.5)} | options))
    again = simulation_of(ours())
    again.loadState(saved(simulation, tmp_path))
    reported(again, file, 2, append=True, around=([0], 0.5))


def saved(simulation, folder):
    """Return the file with the State of a Simulation."""
    file = str(folder / "state.xml")
    simulation.saveState(file)
    return file


def test_an_observable_may_change_the_array_it_gets(tmp_path):
    def centred(x):
        x -= x.mean(axis=0)
        return x[0, 0] > 0.0

    file = tmp_path / "frames.csv"
    reported(simulation_of(ours()), file, 4, observables={"sign": centred, "first": first, "again": first})
    columns = read(file)[1]
    assert columns["first"].tolist() == columns["again"].tolist()
    assert set(columns["sign"]) <= {0.0, 1.0}


def test_a_barostat_that_never_acts_leaves_the_volume_constant(tmp_path):
    file = tmp_path / "frames.csv"
    reported(simulation_of(ours(), barostat=True), file, 2)
    assert read(file)[0].barostat == ""
