"""Reporters."""

import openmm
import pytest
from openmm import app

import openmm_exactrb as rb


def simulation_of_two_dipoles():
    topology, system, positions = rb.dipole_fluid(2)
    platform = openmm.Platform.getPlatform("Reference")
    simulation = app.Simulation(topology, system, rb.ExactRigidBodyIntegrator(0.005), platform)
    simulation.context.setPositions(positions)
    return simulation


@pytest.mark.parametrize("make", [lambda n: rb.EnergyReporter("x", n), lambda n: rb.MomentReporter("x", n, [])])
@pytest.mark.parametrize("interval", [0, -1, 2.5, None])
def test_intervals_are_at_least_one_step(make, interval, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="reportInterval must be"):
        make(interval)
    assert not list(tmp_path.iterdir())


def test_energy_reporter_appends(tmp_path):
    simulation = simulation_of_two_dipoles()
    for append in (False, True):
        reporter = rb.EnergyReporter(tmp_path / "energies.csv", 1, append=append)
        simulation.reporters = [reporter]
        simulation.step(2)
        reporter.close()
    lines = (tmp_path / "energies.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines] == ["step", "1", "2", "3", "4"]


def reported(file, steps, append):
    """Append the energies of steps to a file."""
    simulation = simulation_of_two_dipoles()
    reporter = rb.EnergyReporter(file, 1, append=append)
    simulation.reporters.append(reporter)
    simulation.step(steps)
    reporter.close()
    return file.read_text().splitlines()


@pytest.mark.parametrize("left", ["3,0.015", "3,0.015,0,0,0,0,1", "3," + "1" * 200_000])
def test_energy_reporter_appends_behind_the_last_whole_line(tmp_path, left):
    whole = reported(tmp_path / "energies.csv", 2, append=False)
    with (tmp_path / "energies.csv").open("a") as file:
        file.write(left)
    lines = reported(tmp_path / "energies.csv", 2, append=True)
    assert lines == [*whole, *whole[1:]]  # a new simulation begins with its own step 1


@pytest.mark.parametrize("left", ["", "st", "step,time (ps),translational,rotational,kinetic,potential,total (kJ/mol)"])
def test_energy_reporter_finishes_the_names_of_the_columns(tmp_path, left):
    (tmp_path / "energies.csv").write_text(left)
    assert reported(tmp_path / "energies.csv", 1, append=True) == reported(tmp_path / "new.csv", 1, append=False)


@pytest.mark.parametrize("text", ["<System>", "step,time (ps),Mx,My,Mz\n1,0.1,0.0,0.0", "\n1,2"])
def test_a_file_that_is_another_is_not_cut(tmp_path, text):
    (tmp_path / "precious").write_text(text)
    with pytest.raises(ValueError, match="ends within a line"):
        rb.EnergyReporter(tmp_path / "precious", 1, append=True)
    assert (tmp_path / "precious").read_text() == text
