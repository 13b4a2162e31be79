"""Advice that holds: a run ten times longer than those of the survey stays within a factor 2 of the promised error."""

import json
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import openmm
import pytest
from openmm import app, unit
from openmm_exactrb.workprecision import VERLET, Bench, Series, Start, conservative, expected_error, thermalised

import openmm_exactrb as rb
from openmm_exactrb import tuning
from openmm_exactrb.schemes import FORCE_GRADIENT

FEW = ("V2", "S2_2", "SRKN4_6b")


def equilibrated(system, positions, platform="Reference", temperature=300.0, picoseconds=2.0):
    """Return a State at a temperature."""
    langevin = openmm.LangevinMiddleIntegrator(temperature, 5.0, 0.002)
    langevin.setRandomNumberSeed(1)
    context = openmm.Context(system, langevin, openmm.Platform.getPlatform(platform))
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    context.setVelocitiesToTemperature(temperature, 1)
    langevin.step(round(picoseconds / 0.002))
    return context.getState(positions=True, velocities=True)


def arrays(state):
    return state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value


def long_run(choice, result, system, state, platform):
    """Return the standard deviation of the energy a body over the horizon, from the start of the survey."""
    integrator = choice.integrator()
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform))
    context.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    context.setPositions(state.getPositions())
    context.setVelocities(state.getVelocities())
    every = max(1, round(result.horizon / 2000.0 / choice.step))
    energies = []
    for _ in range(int(result.horizon / (every * choice.step))):
        integrator.step(every)
        kinetic = sum(part._value for part in integrator.kineticEnergies())
        energies.append(context.getState(energy=True).getPotentialEnergy()._value + kinetic)
    return np.std(energies) / result.n_bodies


@pytest.fixture(scope="module")
def droplet():
    """System and State of eight TIP3P molecules without cutoff."""
    _, system, positions = rb.rigid_water(8)
    return system, equilibrated(system, positions)


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def tuned(droplet, lines):
    return rb.tune(*droplet, target=1e-3, schemes=FEW, platform="Reference", report=lines.append)


# -- what an error is -------------------------------------------------------------------------------------------


def test_the_error_of_a_swing_does_not_grow_with_the_run(rng):
    energies = rng.standard_normal(4000)
    assert expected_error(energies, 0.1, 4000.0) == pytest.approx(1.0, rel=0.1)


def test_the_error_of_a_random_walk_grows_with_the_root_of_the_run(rng):
    walks = np.cumsum(rng.standard_normal((200, 4000)), axis=1)
    actual = np.sqrt(walks.var(axis=1).mean())
    guesses = [expected_error(walk[:400], 1.0, 4000.0) for walk in walks]
    assert 0.7 < np.median(guesses) / actual < 1.6
    longer = np.array([expected_error(walk[:2000], 1.0, 4000.0) for walk in walks])
    assert (walks.std(axis=1) > 2.0 * longer).mean() < 0.04


def test_a_drift_counts():
    assert expected_error(np.linspace(0.0, 1.0, 800), 1.0, 800.0) == pytest.approx(1.0 / math.sqrt(12.0), rel=0.6)


def test_an_unstable_run_has_no_error():
    assert math.isinf(Series(np.array([]), 0.1, False).error(1.0))


# -- what is measured -------------------------------------------------------------------------------------------


def test_verlet_starts_with_the_same_energy_and_is_read_at_full_steps(droplet):
    system, state = droplet
    bench = Bench(Start(system, *arrays(state), platform="Reference"))
    ours, theirs = bench.mover(rb.SCHEMES["V2"]), bench.mover(VERLET)
    energies = []
    for mover in (ours, theirs):
        mover.begin(0.001)
        energies.append(mover.energy())
    assert energies[1] == pytest.approx(energies[0], abs=1e-6)
    # Velocity Verlet and SETTLE are of the same order and nearly the same method.
    errors = [bench.run(m, 0.001, 0.5).error(0.5) for m in (rb.SCHEMES["V2"], VERLET)]
    assert errors[1] == pytest.approx(errors[0], rel=0.5)


def test_a_run_that_blows_up_is_unstable(droplet):
    system, state = droplet
    bench = Bench(Start(system, *arrays(state), platform="Reference"))
    for method in (rb.SCHEMES["SRKN4_6b"], VERLET):
        assert not bench.run(method, 0.1, 1.0).stable


def test_what_does_not_conserve_the_energy_is_left_out():
    _, system, _ = rb.rigid_water(2, removeCMMotion=True)
    system.addForce(openmm.AndersenThermostat(300.0, 1.0))
    twin, left_out = conservative(system)
    assert left_out == ["CMMotionRemover", "AndersenThermostat"]
    assert twin.getNumForces() == system.getNumForces() - 2


def test_a_start_is_thermalised():
    _, system, positions = rb.rigid_water(27)
    x = positions._value
    start = thermalised(Start(system, x, np.zeros_like(x), platform="Reference"), 300.0, 1, minimise=True)
    temperature = (
        Bench(start).kinetic / 3.0 / unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
    )
    assert 150.0 < temperature < 600.0


# -- the answers ------------------------------------------------------------------------------------------------


def test_the_advice_holds_for_a_run_ten_times_longer(tuned, droplet):
    choice = tuned.best()
    assert choice.confirmed
    assert choice.error <= 1e-3
    assert tuned.horizon == pytest.approx(10.0 * tuned.duration)
    # An energy that wanders does so differently in every run: one of twelve was beyond twice the promise.
    runs = [replace(choice, step=choice.step * (1.0 + 1e-7 * k)) for k in range(7)]
    assert np.median([long_run(run, tuned, *droplet, "Reference") for run in runs]) < 2.0 * choice.error


def test_a_choice_builds_its_integrator(tuned):
    choice = tuned.best(1e-3)
    integrator = choice.integrator()
    assert isinstance(integrator, rb.ExactRigidBodyIntegrator)
    assert integrator.getScheme().name == choice.method
    assert integrator.getStepSize()._value == choice.step
    assert isinstance(tuned.cheapest(1e-2, VERLET).integrator(), openmm.VerletIntegrator)


def test_smaller_errors_cost_more_and_more_cost_gives_smaller_errors(tuned):
    loose, tight = tuned.cheapest(1e-2), tuned.cheapest(1.5e-3)
    assert loose.cost < tight.cost
    assert loose.error <= 1e-2
    least = tuned.error_at(0.9 * loose.cost), tuned.error_at(tight.cost)
    assert least[0].error > least[1].error
    assert least[1].cost <= tight.cost * (1.0 + 1e-12)
    assert least[1].error <= 1.5e-3 * (1.0 + 1e-9)


def test_the_largest_stable_step_lies_below_an_unstable_one(tuned):
    for name in FEW:
        largest = tuned.largest_stable_step(name)
        unstable = [p.step for p in tuned.points if p.method == name and math.isinf(p.error)]
        assert largest < min(unstable) < 1.2 * largest
    # Rigid water: 7 to 10 fs with Verlet.
    assert 0.004 < tuned.largest_stable_step("V2") < 0.015


def test_it_prints_well(tuned, lines):
    text = str(tuned)
    for part in ("kJ/mol a body", "fs an evaluation", "largest step, fs", "target 0.001:", VERLET, *FEW):
        assert part in text
    assert tuned.best().method in text
    assert max(map(len, text.splitlines())) < 130
    assert len(lines) == len({*lines})
    assert all("fs an evaluation" in line for line in lines)


def test_it_goes_into_json_and_a_picture(tuned, tmp_path):
    content = json.loads(tuned.to_json())
    assert content["chosen"]["method"] == tuned.best().method
    assert content["largest_stable_steps"]["V2"] == tuned.largest_stable_step("V2")
    assert len(content["points"]) == len(tuned.points)
    tuned.draw(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_an_error_out_of_reach_is_said_with_the_smallest_found(tuned):
    smallest = min(p.error for p in tuned.points)
    with pytest.raises(tuning.UnreachableError) as error:
        tuned.best(1e-9)
    assert f"the smallest found is {smallest:.2g}" in str(error.value)
    with pytest.raises(ValueError, match="no stable setting costs"):
        tuned.error_at(1e-9)


def test_the_floor_of_single_precision_is_named(droplet):
    system, state = droplet
    result = rb.tune(system, state, target=1e-9, schemes=("SRKN4_6b", "SRKN6_11b"), platform="CPU", duration=0.4)
    assert result.chosen is None
    assert 1e-7 < result.floor < 1e-3
    assert "comes from the forces (single precision" in " ".join(str(result).split())
    finest = min(p.step / rb.SCHEMES[p.method].stages for p in result.points if p.method in rb.SCHEMES)
    assert finest > 5e-5  # it did not go on to tiny steps
    with pytest.raises(ValueError, match=r"Below .* smaller steps do not lower the error"):
        result.best()


def test_a_loose_target_gets_the_largest_steps(droplet):
    result = rb.tune(*droplet, target=0.5, schemes=["V2", "S2_3"], platform="Reference", duration=0.4)
    choice = result.best()
    assert choice.error <= 0.5
    assert choice.step > 0.7 * result.largest_stable_step(choice.method)


# -- what a user has at hand ------------------------------------------------------------------------------------


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
        ({"temperature": math.inf}, "temperature must be a positive number"),
        ({"levels": 0}, "levels must be a whole number"),
        ({"schemes": []}, "schemes is empty"),
        ({"schemes": ["RK4"]}, "unknown scheme 'RK4'"),
        ({"schemes": list(FORCE_GRADIENT)}, "needs force gradients"),
        ({"schemes": ["V2_C17"]}, "is processed"),
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


def test_the_default_schemes_are_of_the_catalogue():
    assert set(tuning.CANDIDATES) <= set(rb.SCHEMES)


# -- from the shell ---------------------------------------------------------------------------------------------


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "openmm_exactrb.tune", *map(str, arguments)], capture_output=True, text=True
    )


def test_the_command(droplet, tmp_path):
    files = [tmp_path / "system.xml", tmp_path / "state.xml"]
    for file, content in zip(files, droplet, strict=True):
        file.write_text(openmm.XmlSerializer.serialize(content))
    options = ["--schemes", "S2_2", "--platform", "Reference", "--duration", "0.2"]
    done = command(*files, "--target", "1e-2", "--json", "--output", tmp_path / "picture.png", *options)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["chosen"]["method"] == "S2_2"
    assert "S2_2, " in done.stderr
    assert "Warning" not in done.stderr
    assert (tmp_path / "picture.png").exists()
    for arguments, message in (
        ((files[1], files[0]), "holds a State, not a System"),
        ((files[0], tmp_path / "nowhere.xml"), "nowhere.xml"),
        ((tmp_path / "picture.png", files[1]), "tune: "),
        ((*files, "--target=-1"), "target must be a positive number"),
    ):
        done = command(*arguments)
        assert done.returncode == 2
        assert message in done.stderr
        assert "Traceback" not in done.stderr


def test_the_module_of_the_command_can_be_called_too():
    check = "import openmm_exactrb.tune, openmm_exactrb as rb; assert callable(rb.tune)"
    subprocess.run([sys.executable, "-c", check], check=True)


# -- long ones --------------------------------------------------------------------------------------------------


def tip3p_droplet():
    _, system, positions = rb.rigid_water(64)
    return system, equilibrated(system, positions, picoseconds=20.0), "Reference"


def pme_box():
    _, system, positions = rb.rigid_water(
        216, nonbondedMethod=app.PME, nonbondedCutoff=0.8, switchDistance=0.7, ewaldErrorTolerance=1e-5
    )
    return system, equilibrated(system, positions, "CPU", picoseconds=20.0), "CPU"


def dipoles():
    _, system, positions = rb.dipole_fluid(n=125, seed=0, trap=0.5)
    integrator = rb.ExactRigidBodyIntegrator(0.02, scheme="S2_2")
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    for seed in range(10):
        integrator.setVelocitiesToTemperature(120.0, seed)
        integrator.step(50)
    return system, context.getState(positions=True, velocities=True), "Reference"


@pytest.mark.validate
@pytest.mark.parametrize("target", [1e-3, 1e-4])
@pytest.mark.parametrize("make", [tip3p_droplet, pme_box, dipoles])
def test_the_advice_holds(make, target):
    system, state, platform = make()
    result = rb.tune(system, state, target=target, platform=platform)
    choice = result.best()
    assert choice.error <= target
    actual = long_run(choice, result, system, state, platform)
    print(f"\n{result}\npromised {choice.error:.2e}, ten times longer {actual:.2e}")
    assert actual < 2.0 * choice.error


def test_bodies_named_in_a_simulation_are_those_that_are_measured():
    topology, system, positions = rb.rigid_water(2)
    while system.getNumConstraints():
        system.removeConstraint(0)
    named = [[0, 1, 2], [3, 4, 5]]
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=named)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    begin, _ = tuning._start(simulation, None, None, None, None, None)
    assert begin.bodies == named
    begin.bodies[0][0] = 7
    assert integrator.getNamedBodies() == named
