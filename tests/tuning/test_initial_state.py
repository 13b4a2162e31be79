"""What a user has at hand is enough, and what does not fit is one clear sentence."""

import numpy as np
import openmm
import pytest
from equilibrium import arrays
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.tuning import Choice
from openmm_exactrb.tuning.benchmark import VERLET, Benchmark, Method
from openmm_exactrb.tuning.budget import Budget
from openmm_exactrb.tuning.initial_state import initial_state
from starts import context_of, simulation_of

PLENTY = Budget(1e6)


def test_a_simulation_is_enough():
    topology, system, positions = rb.rigid_water(4, removeCMMotion=True)
    langevin = openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.002)
    langevin.setRandomNumberSeed(1)
    simulation = simulation_of(topology, system, langevin, positions)
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
    assert result.best(0.1).method == "S2_2"
    with pytest.raises(ValueError, match="tune\\(\\) was called without target="):
        result.best()


def test_positions_with_a_temperature_and_bodies_by_hand_are_enough():
    _, system, positions = rb.rigid_water(4)
    while system.getNumConstraints():
        system.removeConstraint(0)
    bodies = [[3 * i, 3 * i + 1, 3 * i + 2] for i in range(4)]
    options = {"schemes": ["S2_2"], "duration": 0.2, "levels": 3, "bodies": bodies, "platform": "Reference"}
    result = rb.tune(system, positions, temperature=100.0 * unit.kelvin, **options)
    assert list(result.methods) == ["S2_2"]  # Verlet would move flexible molecules
    assert any("brought to 100 K" in note for note in result.notes)
    context = context_of(system, result.best(0.1).integrator(), positions)
    context.getIntegrator().step(1)


@pytest.fixture(scope="module")
def periodic():
    """A Simulation of a periodic box of water, whose Context has another box and parameter than its System."""
    topology, system, positions = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)
    lift = openmm.CustomExternalForce("lift*z")
    lift.addGlobalParameter("lift", 0.0)
    lift.addParticle(0)
    lift.setForceGroup(1)
    system.addForce(lift)
    integrator = openmm.VerletIntegrator(0.001)
    simulation = simulation_of(topology, system, integrator, positions, kelvin=300.0)
    simulation.context.setPeriodicBoxVectors(*(1.1 * np.eye(3)))
    simulation.context.setParameter("lift", 7.0)
    integrator.setIntegrationForceGroups({0})
    return simulation, positions


def test_positions_beside_a_simulation_have_the_box_parameters_and_forces_of_its_context(periodic):
    simulation, positions = periodic
    begin, _ = initial_state(simulation, positions, np.ones((81, 3)))
    bench = Benchmark(begin, PLENTY)
    tested = bench.under_test(Method(rb.SCHEMES["V2"]))
    tested.begin(1e-7, bench.state)
    mine = tested.energy() - bench.characteristics.kinetic * bench.characteristics.n_bodies
    state = simulation.context.getState(energy=True, groups={0})
    assert mine == pytest.approx(state.getPotentialEnergy()._value, abs=1e-6)
    assert dict(begin.state.getParameters()) == {"lift": 7.0}
    verlet = bench.under_test(Method())
    verlet.begin(1e-7, bench.state)
    assert verlet.energy() == pytest.approx(tested.energy(), abs=1e-3)


def test_a_choice_has_the_forces_that_act():
    for method in ("V2", VERLET):
        integrator = Choice(method, 0.001, 1e-3, 1.0, True, groups=1).integrator()
        assert integrator.getIntegrationForceGroups() == 1


def test_molecules_that_the_box_splits_are_made_whole(periodic):
    simulation, _ = periodic
    x, v = arrays(simulation.context.getState(positions=True, velocities=True))
    energies = []
    for wrapped in (x, np.mod(x + 0.3, 1.1) - 0.3):
        begin, _ = initial_state(simulation, wrapped, v)
        bench = Benchmark(begin, PLENTY)
        for method in (Method(rb.SCHEMES["V2"]), Method()):
            tested = bench.under_test(method)
            tested.begin(1e-7, bench.state)
            energies.append(tested.energy())
    assert np.abs(np.mod(x + 0.3, 1.1) - 0.3 - x).max() > 1.0  # some are split
    np.testing.assert_allclose(energies, energies[0], atol=1e-3)


def test_two_molecules_far_apart_get_no_step_in_which_they_turn_round():
    _, system, positions = rb.rigid_water(2)
    x = positions._value.copy()
    x[3:] += [3.0, 0.0, 0.0]
    options = {"schemes": "S2_2", "duration": 1.0, "levels": 3, "platform": "Reference", "report": None}
    result = rb.tune(system, x, temperature=300.0, velocities=np.zeros_like(x) + 1e-9, **options)
    assert result.largest_stable_step("S2_2") / 2.0 < 0.12  # a radian at 300 K takes 0.06 ps
    assert any("bodies hardly interact" in note for note in result.notes)
