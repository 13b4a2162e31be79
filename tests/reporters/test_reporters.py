"""Reporters."""

import openmm
import pytest

import openmm_exactrb as rb
from starts import simulation_of


def simulation_of_two_dipoles():
    topology, system, positions = rb.dipole_fluid(2)
    platform = openmm.Platform.getPlatform("Reference")
    return simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.005), positions, platform=platform)


@pytest.mark.parametrize("make", [lambda n: rb.EnergyReporter("x", n), lambda n: rb.MomentReporter("x", n, [])])
@pytest.mark.parametrize("interval", [0, -1, 2.5, None])
def test_intervals_are_at_least_one_step(make, interval, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="reportInterval must be"):
        make(interval)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("left", ["3", "3,0.015", "<System>"])
def test_a_file_that_ends_within_a_line_is_refused_and_left_alone(tmp_path, left):
    file = tmp_path / "energies.csv"
    file.write_text(left)
    with pytest.raises(ValueError, match="ends with an incomplete line"):
        rb.EnergyReporter(file, 1, append=True)
    assert file.read_text(encoding="utf-8") == left


def test_a_time_has_no_digits_of_the_sum_of_its_steps(tmp_path):
    """A hundred steps of 2 fs add up to 0.20000000000000012 ps."""
    simulation = simulation_of_two_dipoles()
    reporter = rb.EnergyReporter(tmp_path / "energies.csv", 100)
    simulation.reporters.append(reporter)
    simulation.integrator.setStepSize(0.002)
    simulation.step(100)
    reporter.close()
    assert simulation.context.getTime()._value != 0.2
    assert (tmp_path / "energies.csv").read_text(encoding="utf-8").splitlines()[1].startswith("100,0.2,")
