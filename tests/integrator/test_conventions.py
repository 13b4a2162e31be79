"""OpenMM's conventions for integrators, which those of this package and LangevinMiddleIntegrator follow alike."""

import copy
import io

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from every_integrator import WAYS
from openmm_exactrb.library.library import of_library
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin, NoseHooverChain, StochasticRescaling
from places import platform_for
from products import spread, spread_over
from starts import held, positions_of, velocities_of

H, T = 0.001, 300.0
THEIRS = {
    "LangevinMiddle": lambda **_: openmm.LangevinMiddleIntegrator(T, 1.0, H),
    "Verlet": lambda **_: openmm.VerletIntegrator(H),
}
OURS = {
    "default": lambda **engine: rb.ExactRigidBodyIntegrator(H, **engine),
    "S2_2": lambda **engine: rb.ExactRigidBodyIntegrator(H, "S2_2", **engine),
    "SRKN4_6b": lambda **engine: rb.ExactRigidBodyIntegrator(H, "SRKN4_6b", **engine),
    "BAOA": lambda **engine: rb.ExactRigidBodyLangevinIntegrator(T, 1.0, H, **engine),
    "W2_3m": lambda **engine: rb.ExactRigidBodyIntegrator(H, "W2_3m", thermostat=Langevin(T, 1.0), **engine),
    "rescaling": lambda **engine: rb.ExactRigidBodyIntegrator(H, thermostat=StochasticRescaling(T, 0.5), **engine),
    "chains": lambda **engine: rb.ExactRigidBodyIntegrator(H, thermostat=NoseHooverChain(T, 20.0), **engine),
    "hybrid": lambda **_: rb.ExactRigidBodyIntegrator(H, thermostat=HybridMonteCarlo(T, 1.0)),
}
PROCESSORS = [pytest.param(*place) for place in (("Reference", "host"), ("Reference", "auto"), ("CPU", "auto"))]
KINDS = [*THEIRS, *OURS]
ON_DEVICES = [name for name in OURS if name != "hybrid"]  # which runs on the host


def _water():
    """Return a System with forces in groups 0 and 3 and a parameter, and positions, in a periodic box."""
    topology, system, positions = rb.rigid_water(64, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.5)
    pull = openmm.CustomExternalForce("pull*x")
    pull.addGlobalParameter("pull", 0.0)
    for i in range(system.getNumParticles()):
        pull.addParticle(i, [])
    pull.setForceGroup(3)
    system.addForce(pull)
    return topology, system, positions


TOPOLOGY, SYSTEM, POSITIONS = _water()


class Run:
    """An integrator in a Simulation, made again with the same arguments as often as needed."""

    def __init__(self, kind, place):
        self.kind, (self.place, self.engine) = kind, place

    def integrator(self, seed=5):
        integrator = (THEIRS | OURS)[self.kind](engine=self.engine)
        if hasattr(integrator, "setRandomNumberSeed"):
            integrator.setRandomNumberSeed(seed)
        return integrator

    def simulation(self, integrator=None, system=SYSTEM):
        if self.place == "OpenCL":
            platform, properties = platform_for("native")
        else:
            platform = openmm.Platform.getPlatform(self.place)
            properties = {"Threads": "1"} if self.place == "CPU" else {}
        simulation = app.Simulation(TOPOLOGY, system, integrator or self.integrator(), platform, properties)
        simulation.context.setPositions(POSITIONS)
        simulation.context.setVelocitiesToTemperature(T, 3)
        return simulation

    @property
    def close(self):
        """How far two runs of the same integrator may be apart (nm), because forces are summed in any order."""
        return 0.0 if self.place == "Reference" else 1e-5


@pytest.fixture(params=KINDS)
def anything(request):
    """An integrator of each kind on Reference."""
    return Run(request.param, ("Reference", "auto"))


def pytest_generate_tests(metafunc):
    """Run each kind on a processor, and one on a device, where Contexts take long; they change from test to test."""
    if "run" in metafunc.fixturenames:
        number = list(vars(metafunc.module)).index(metafunc.function.__name__)
        device = pytest.param("OpenCL", "native", marks=pytest.mark.opencl)
        one = [ON_DEVICES[number % len(ON_DEVICES)]]
        rows = [*spread(KINDS, PROCESSORS, offset=number), *spread(one, [device])]
        metafunc.parametrize(("kind", "where", "engine"), rows)


@pytest.fixture
def run(kind, where, engine):
    return Run(kind, (where, engine))


# -- steps, counts and time -------------------------------------------------------------------------------------------


def test_steps_advance_the_count_and_the_time(run):
    simulation = run.simulation()
    simulation.step(3)
    simulation.integrator.step(2)
    simulation.step(0)
    assert simulation.context.getStepCount() == 5
    assert simulation.context.getTime()._value == pytest.approx(5 * H, rel=1e-12)
    assert simulation.context.getState().getStepCount() == 5
    simulation.context.setStepCount(1000)
    simulation.context.setTime(2.0)
    simulation.step(4)
    assert simulation.context.getStepCount() == 1004
    assert simulation.context.getTime()._value == pytest.approx(2.0 + 4 * H, rel=1e-12)


def test_step_sizes_have_units_and_take_effect_at_once(run):
    simulation = run.simulation()
    integrator = simulation.integrator
    assert integrator.getStepSize() == H * unit.picosecond
    simulation.step(1)
    for size in (0.5 * unit.femtosecond, 0.0005):
        integrator.setStepSize(size)
        assert integrator.getStepSize()._value == pytest.approx(0.0005, rel=1e-14)
    simulation.step(2)
    assert simulation.context.getTime()._value == pytest.approx(2 * H, rel=1e-12)


def test_equal_seeds_give_equal_runs(run):
    ends = []
    for calls in ([6], [2, 1, 3]):
        simulation = run.simulation()
        for n in calls:
            simulation.step(n)
        ends.append(held(simulation))
    tolerance = 1e-13 if run.place == "Reference" else 1e-5
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.0, atol=tolerance)


# -- constraints, velocities and energies -----------------------------------------------------------------------------


def test_constraints_hold_after_every_call(run):
    simulation = run.simulation()
    simulation.step(5)
    x, v = held(simulation)
    for k in range(SYSTEM.getNumConstraints()):
        i, j, length = SYSTEM.getConstraintParameters(k)
        apart = x[i] - x[j]
        assert np.linalg.norm(apart) == pytest.approx(length._value, rel=2e-5)
        # The velocities of OpenMM's leapfrog integrators are those of half a step earlier.
        assert abs(apart @ (v[i] - v[j])) < (0.1 if run.kind in THEIRS else 1e-4)


def test_energies_are_those_of_the_positions_and_velocities(run):
    simulation = run.simulation()
    simulation.step(3)
    state = simulation.context.getState(energy=True)
    masses = np.array([SYSTEM.getParticleMass(i)._value for i in range(SYSTEM.getNumParticles())])
    kinetic = 0.5 * float((masses[:, None] * velocities_of(simulation.context) ** 2).sum())
    if run.kind in OURS:
        assert state.getKineticEnergy()._value == pytest.approx(kinetic, rel=1e-5)
    other = openmm.Context(SYSTEM, openmm.VerletIntegrator(H), simulation.context.getPlatform())
    other.setPositions(positions_of(simulation.context))
    theirs = other.getState(energy=True)
    assert state.getPotentialEnergy()._value == pytest.approx(theirs.getPotentialEnergy()._value, rel=1e-4, abs=0.05)


def test_velocities_are_drawn_at_a_temperature(run):
    """The mean of three draws of 64 molecules with six degrees of freedom each, within four standard errors."""
    simulation, found = run.simulation(), []
    for seed in (1, 2, 3):
        simulation.context.setVelocitiesToTemperature(T * unit.kelvin, seed)
        found.append(simulation.context.getState(energy=True).getKineticEnergy()._value)
    expected = 0.5 * 6 * 64 * 8.31446e-3 * T
    # VerletIntegrator and LangevinMiddleIntegrator report the kinetic energy half a step later.
    assert np.mean(found) == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / (3 * 6 * 64)) + 0.02)
    simulation.context.setVelocitiesToTemperature(0.0)
    assert np.abs(velocities_of(simulation.context)).max() < (0.5 if run.kind in THEIRS else 1e-6)
    simulation.step(1)


# -- forces and parameters --------------------------------------------------------------------------------------------


def test_force_groups_choose_what_acts(run):
    simulation = run.simulation()
    integrator = simulation.integrator
    assert integrator.getIntegrationForceGroups() in (-1, 2**32 - 1)
    simulation.context.setParameter("pull", 1e4)
    integrator.setIntegrationForceGroups(1 << 0)
    assert integrator.getIntegrationForceGroups() == 1
    before = positions_of(simulation.context)[:, 0].mean()
    simulation.step(3)
    without = positions_of(simulation.context)[:, 0].mean() - before
    integrator.setIntegrationForceGroups({0, 3})
    simulation.step(3)
    assert positions_of(simulation.context)[:, 0].mean() - before < without - 0.01


def test_parameters_and_positions_that_are_set_take_effect(run):
    simulation = run.simulation()
    simulation.step(2)
    simulation.context.setParameter("pull", 1e4)
    simulation.step(2)
    assert velocities_of(simulation.context)[:, 0].mean() < -1.0
    simulation.context.setParameter("pull", 0.0)
    simulation.context.setPositions(POSITIONS)
    simulation.context.setVelocitiesToTemperature(T, 4)
    simulation.step(1)
    assert np.abs(positions_of(simulation.context) - POSITIONS._value).max() < 0.02


def test_reinitialize_preserves_the_state_or_forgets_it(run):
    simulation = run.simulation(system=copy.deepcopy(SYSTEM))
    simulation.step(2)
    before = held(simulation)
    simulation.context.reinitialize(preserveState=True)
    np.testing.assert_allclose(held(simulation), before, rtol=0.0, atol=run.close)
    assert simulation.context.getStepCount() == 2
    simulation.step(1)
    assert simulation.context.getStepCount() == 3
    simulation.context.reinitialize()
    with pytest.raises((openmm.OpenMMException, ValueError), match="positions"):
        simulation.step(1)
    simulation.context.setPositions(POSITIONS)
    simulation.step(1)
    assert np.isfinite(positions_of(simulation.context)).all()


# -- checkpoints, States and copies -----------------------------------------------------------------------------------


def test_checkpoints_continue_a_run(run):
    simulation = run.simulation()
    simulation.step(3)
    kept = io.BytesIO()
    simulation.saveCheckpoint(kept)
    simulation.step(4)
    expected = held(simulation)
    simulation.loadCheckpoint(io.BytesIO(kept.getvalue()))
    assert (simulation.currentStep, simulation.context.getStepCount()) == (3, 3)
    simulation.step(4)
    np.testing.assert_allclose(held(simulation), expected, rtol=0.0, atol=run.close)


def test_states_are_saved_and_loaded(run, tmp_path):
    simulation = run.simulation()
    simulation.step(3)
    simulation.saveState(str(tmp_path / "state.xml"))
    saved = held(simulation)
    other = run.simulation(run.integrator(seed=6))
    other.loadState(str(tmp_path / "state.xml"))
    np.testing.assert_allclose(held(other), saved, rtol=0.0, atol=1e-6)
    assert other.currentStep == 3
    other.step(1)
    assert other.context.getTime()._value == pytest.approx(4 * H, rel=1e-12)


@spread_over({"anything": KINDS, "way": WAYS}, times=2, indirect=["anything"])
def test_copies_are_of_the_same_class_and_move_alike(anything, way):
    integrator = anything.integrator()
    simulation = anything.simulation(integrator)
    simulation.step(4)
    for original in (anything.integrator(), integrator):  # before and after a Context exists
        copied = WAYS[way](original)
        assert type(copied) is type(integrator)
        if of_library(integrator) or anything.kind in THEIRS:  # without the library, with the values of variables
            assert openmm.XmlSerializer.serialize(copied) == openmm.XmlSerializer.serialize(original)
        other = anything.simulation(copied)
        other.step(4)
        np.testing.assert_array_equal(held(other), held(simulation))


# -- exceptions -------------------------------------------------------------------------------------------------------


def test_an_integrator_without_a_context_cannot_step(anything):
    with pytest.raises((openmm.OpenMMException, ValueError), match=r"[Cc]ontext"):
        anything.integrator().step(1)


def test_an_integrator_belongs_to_one_context(anything):
    simulation = anything.simulation()
    with pytest.raises(openmm.OpenMMException, match="already bound to a context"):
        openmm.Context(SYSTEM, simulation.integrator, openmm.Platform.getPlatform("Reference"))
    simulation.step(1)


def test_positions_that_are_missing_are_named(anything):
    simulation = app.Simulation(TOPOLOGY, SYSTEM, anything.integrator(), openmm.Platform.getPlatform("Reference"))
    with pytest.raises((openmm.OpenMMException, ValueError), match="positions"):
        simulation.step(1)


def test_errors_of_forces_leave_a_context_that_can_go_on(run):
    system, broken = copy.deepcopy(SYSTEM), []

    def fails(state):
        if broken:
            raise RuntimeError("no answer")
        return 0.0, np.zeros((SYSTEM.getNumParticles(), 3))

    system.addForce(openmm.PythonForce(fails))
    simulation = run.simulation(system=system)
    simulation.step(1)
    broken.append(True)
    with pytest.raises(openmm.OpenMMException, match="no answer"):
        simulation.integrator.step(1)
    broken.clear()
    simulation.integrator.step(1)
    assert np.isfinite(held(simulation)).all()


def test_a_compound_steps_it(run):
    if run.kind in OURS and not of_library(run.integrator()):
        pytest.skip("needs the package's library")
    alone = run.simulation()
    drawn = alone.context.getState(velocities=True).getVelocities()
    alone.step(3)  # before another Context exists, which on Reference would share OpenMM's random numbers
    compound = openmm.CompoundIntegrator()
    compound.addIntegrator(run.integrator())
    simulation = run.simulation(compound)
    simulation.context.setVelocities(drawn)
    simulation.step(3)
    np.testing.assert_allclose(held(simulation), held(alone), rtol=0.0, atol=run.close)
