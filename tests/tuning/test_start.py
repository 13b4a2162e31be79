"""What a user has at hand is enough, and what does not fit is one clear sentence."""

import math

import numpy as np
import openmm
import pytest
from equilibrium import arrays
from openmm import app, unit

import openmm_exactrb as rb


def test_a_simulation_is_enough():
    topology, system, positions = rb.rigid_water(4, removeCMMotion=True)
    langevin = openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.002)
    simulation = app.Simulation(topology, system, langevin, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    simulation.minimizeEnergy()
    simulation.context.setVelocitiesToTemperature(300.0, 1)
    simulation.step(100)
    before = arrays(simulation.context.getState(positions=True, velocities=True))
    result = rb.tune(simulation, schemes="S2_2", duration=0.2, levels=3)
    assert result.platform == "Reference"
    assert result.chosen is None
    assert any("CMMotionRemover" in note for note in result.notes)
    after = arrays(simulation.context.getState(positions=True, velocities=True))
    np.testing.assert_array_equal(after, before)
    assert result.cheapest(0.1).method == "S2_2"
    with pytest.raises(ValueError, match="tune\\(\\) was called without one"):
        result.best()


def test_positions_with_a_temperature_and_bodies_by_hand_are_enough():
    _, system, positions = rb.rigid_water(4)
    while system.getNumConstraints():
        system.removeConstraint(0)
    bodies = [[3 * i, 3 * i + 1, 3 * i + 2] for i in range(4)]
    options = {"schemes": ["S2_2"], "duration": 0.2, "levels": 3, "bodies": bodies, "platform": "Reference"}
    result = rb.tune(system, positions, temperature=100.0 * unit.kelvin, **options)
    assert list(result.seconds) == ["S2_2"]  # Verlet would move flexible molecules
    assert any("brought to 100 K" in note for note in result.notes)
    context = openmm.Context(system, result.cheapest(0.1).integrator(), openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    context.getIntegrator().step(1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": None}, "there is no start"),
        ({"start": np.zeros((3, 3))}, r"shape \(3, 3\), but the System has 24"),
        ({"start": np.full((24, 3), np.nan)}, "positions are not finite"),
        ({"start": "water.pdb"}, "positions must be numbers"),
        ({"velocities": np.zeros((24, 3))}, "all velocities of the start are zero"),
        ({"velocities": np.ones((24, 3)) * unit.nanometer}, "velocities have the unit"),
        ({"target": 0.0}, "target must be a positive number"),
        ({"target": "small"}, "target must be a positive number"),
        ({"duration": -1.0}, "duration must be a positive number"),
        ({"horizon": 0.0}, "horizon must be a positive number"),
        ({"horizon": 30.0 * unit.kelvin}, "horizon must be a positive number"),
        ({"temperature": math.inf}, "temperature must be a positive number"),
        ({"levels": 0}, "levels must be a whole number"),
        ({"schemes": []}, "schemes is empty"),
        ({"schemes": ["RK4"]}, "unknown scheme 'RK4'"),
        ({"platform": "Abacus"}, "there is no platform 'Abacus'"),
        ({"system": "system.xml"}, "must be an openmm.System or a Simulation"),
    ],
)
def test_a_wrong_value_is_one_clear_error(droplet, options, message):
    system, state = droplet
    with pytest.raises(ValueError, match=message):
        rb.tune(**({"system": system, "start": state, "platform": "Reference"} | options))


def test_a_state_without_positions_is_refused(droplet):
    system, state = droplet
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(state.getPositions())
    with pytest.raises(ValueError, match="the State has no positions"):
        rb.tune(system, context.getState(energy=True))
    with pytest.raises(ValueError, match="all velocities of the start are zero"):
        rb.tune(system, context.getState(positions=True), platform="Reference")
