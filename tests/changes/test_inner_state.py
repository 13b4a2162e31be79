"""Processed schemes keep the state of their steps from call to call: what the Context shows is a copy of it."""

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
import starts
from few_dipoles import KT, simulation_of, snapshot
from openmm_exactrb.library.library import of_library
from openmm_exactrb.schemes import Scheme

pytestmark = pytest.mark.usefixtures("host_is_advised")

#: With an output of no force, with one of two forces, and with none, which goes back by the inverse processor.
PROCESSED = ["W2_1", "W4_4", "V2_C17"]
OTHERS = ["V2_gradient_C17"]

# Each call looks whether the forces are those of the last call: by an evaluation, unless OpenMM informs the library.
LOOK = int(not of_library(rb.ExactRigidBodyIntegrator(0.001)))


def inner(simulation):
    """Return the state from which steps continue."""
    return simulation.integrator._propagator.sync.inner.state  # noqa: SLF001


def shown(simulation):
    """Return the state as it is shown."""
    return simulation.integrator.fullState()[1]


def true_of(simulation):
    """Return what the exact inverse of the processor makes of the inner state, as a step of its own."""
    integrator = simulation.integrator
    back = Scheme("back", 2, integrator.getScheme().postprocessor)
    other = simulation_of(4, integrator.getStepSize(), back)
    other.integrator.setBodyState(inner(simulation))
    other.integrator.step(1)
    return shown(other)


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def distance(one, other):
    """Return the largest difference of two states."""
    return max(np.abs(a[0] - b[0]).max() for a, b in zip(one, other, strict=True))


def moved(scheme, calls, h=0.02, **options):
    """Return a Simulation of dipoles after calls of so many steps each."""
    simulation = simulation_of(4, h, scheme, **options)
    for n in calls:
        simulation.integrator.step(n)
    return simulation


# -- many calls are one -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", PROCESSED + OTHERS)
def test_ten_calls_of_ten_steps_end_in_the_bits_of_one_of_a_hundred(scheme):
    whole = moved(scheme, [100])
    for calls in ([10] * 10, [1, 2, 3, 94]):
        split = moved(scheme, calls)
        assert_same(inner(split), inner(whole))
        assert_same(shown(split), shown(whole))
        for a, b in zip(snapshot(split), snapshot(whole), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("scheme", PROCESSED + OTHERS)
def test_what_was_shown_on_the_way_changes_nothing(scheme):
    """Energies, temperatures, states and a call of no steps between the others."""
    looked = simulation_of(4, 0.02, scheme)
    for _ in range(5):
        looked.integrator.step(4)
        looked.integrator.totalEnergy()
        looked.integrator.temperatures()
        looked.integrator.bodyState()
        looked.context.getState(positions=True, velocities=True, energy=True, forces=True)
        looked.integrator.step(0)
    assert_same(inner(looked), inner(moved(scheme, [20])))


@pytest.mark.parametrize("scheme", PROCESSED + OTHERS)
def test_what_is_shown_is_no_inner_state_and_near_the_true_one(scheme):
    """The true one is what the exact inverse of the processor makes of the inner state."""
    simulation = moved(scheme, [20])
    ours, true = shown(simulation), true_of(simulation)
    apart = distance(inner(simulation), true)
    assert apart > 1e-5
    assert distance(ours, true) < 0.3 * apart
    if not rb.SCHEMES[scheme].output:
        assert_same(ours, true)


# -- what it costs ----------------------------------------------------------------------------------------------------


def looks(scheme, calls):
    """Return the evaluations of calls of `app.Simulation.step`, with a reporter that looks at the end of each."""
    simulation = simulation_of(4, 0.02, scheme)
    simulation.integrator.timings.reset()
    simulation.integrator.checkDivergence = False  # which asks for energies
    for n in calls:
        simulation.step(n)
        simulation.context.getState(energy=True, positions=True)
    return simulation.integrator.timings.evaluations


@pytest.mark.parametrize(("name", "output"), [("W2_1", 0), ("W4_4", 2), ("V2_C17", 32)])
def test_a_look_costs_the_output_and_the_processor_is_paid_once(name, output):
    """Simulation.step makes calls of ten steps at most, each of which shows its end and looks first for new forces."""
    scheme = rb.SCHEMES[name]
    assert scheme.output_forces == output
    began = scheme.processing // 2
    for calls, shows in (([10], 1), ([100], 10), ([7, 7], 2), ([25], 3)):
        assert looks(name, calls) == began + sum(calls) * scheme.forces + shows * output + (shows - 1) * LOOK


@pytest.mark.parametrize("name", ["W2_1", "W4_4"])
def test_the_output_is_used_from_the_step_on_in_which_enough_forces_are_known(name):
    """However short the calls are: the forces of earlier ones count."""
    scheme = rb.SCHEMES[name]
    simulation, costs = simulation_of(4, 0.02, scheme), []
    simulation.integrator.checkDivergence = False  # which asks for energies
    for _ in range(8):
        before = simulation.integrator.timings.evaluations
        simulation.integrator.step(1)
        costs.append(simulation.integrator.timings.evaluations - before - scheme.forces)
    costs[0] -= scheme.processing // 2
    costs[1:] = [cost - LOOK for cost in costs[1:]]
    needed = {"W2_1": 3, "W4_4": 2}[name]
    assert costs == [scheme.processing // 2] * (needed - 1) + [scheme.output_forces] * (9 - needed)


# -- what a user does between calls -----------------------------------------------------------------------------------


def fresh(simulation, scheme, h, state, n):
    """Return a new run of n steps from a state, in a Context of its own."""
    other = simulation_of(4, h, scheme)
    other.integrator.setBodyState(state)
    for name, value in simulation.context.getParameters().items():
        other.context.setParameter(name, value)
    other.integrator.step(n)
    return other


@pytest.mark.parametrize("scheme", PROCESSED)
@pytest.mark.parametrize("what", ["positions", "velocities", "one velocity", "bodies", "temperature"])
def test_what_a_user_sets_is_where_the_steps_start(scheme, what):
    simulation = moved(scheme, [10])
    x, v = snapshot(simulation)
    if what == "positions":
        simulation.context.setPositions(x + 0.25)
    elif what == "velocities":
        simulation.context.setVelocities(-v)
    elif what == "one velocity":
        v[:5] += [0.01, 0.0, 0.0]
        simulation.context.setVelocities(v)
    elif what == "bodies":
        state = simulation.integrator.bodyState()[1]
        simulation.integrator.setBodyState(state._replace(P=1.1 * state.P))
    else:
        simulation.integrator.setVelocitiesToTemperature(KT, 7)
    start = shown(simulation)
    simulation.integrator.step(10)
    assert_same(inner(simulation), inner(fresh(simulation, scheme, 0.02, start, 10)))
    assert distance(shown(simulation), shown(moved(scheme, [10, 10]))) > 1e-3


@pytest.mark.parametrize("scheme", PROCESSED)
def test_a_changed_step_size_is_honoured_and_starts_from_what_is_shown(scheme):
    """A size that comes and goes changes nothing."""
    simulation = moved(scheme, [10])
    start = shown(simulation)
    simulation.integrator.setStepSize(0.01)
    simulation.integrator.step(10)
    assert simulation.context.getTime()._value == pytest.approx(10 * 0.02 + 10 * 0.01, rel=1e-12)
    assert_same(inner(simulation), inner(fresh(simulation, scheme, 0.01, start, 10)))
    simulation.integrator.setStepSize(0.02)
    simulation.integrator.setStepSize(0.01)
    before = inner(simulation)
    simulation.integrator.step(0)
    assert_same(inner(simulation), before)  # the step is what it was


@pytest.mark.parametrize("scheme", PROCESSED)
@pytest.mark.parametrize("how", ["checkpoint", "state"])
@pytest.mark.parametrize("before", [1, 10])
def test_what_is_saved_has_the_inner_state_and_a_new_context_continues_with_the_same_bits(
    tmp_path, scheme, how, before
):
    whole, first, second = (simulation_of(4, 0.02, scheme) for _ in range(3))
    file = str(tmp_path / "saved")
    whole.integrator.step(before)
    first.integrator.step(before)
    (first.saveCheckpoint if how == "checkpoint" else first.saveState)(file)
    second.context.setPositions(snapshot(second)[0] + 1.0)
    second.integrator.step(3)
    (second.loadCheckpoint if how == "checkpoint" else second.loadState)(file)
    second.integrator.timings.reset()
    second.integrator.checkDivergence = False  # which asks for energies
    assert_same(shown(second), shown(whole))
    assert_same(inner(second), inner(whole))
    for _ in range(3):
        for simulation in (whole, second):
            simulation.integrator.step(1)
        assert_same(inner(second), inner(whole))
        assert_same(shown(second), shown(whole))
    assert second.integrator.timings.evaluations < 3 * (whole.integrator.forceEvaluationsPerStep + 1 + 32)
    assert_same(inner(whole), inner(moved(scheme, [before + 3])))


@pytest.mark.parametrize("scheme", PROCESSED)
def test_another_step_size_behind_a_state_that_was_loaded_is_honoured(tmp_path, scheme):
    """The inner state in the file is in coordinates of another step: what counts is what is shown."""
    first, second = (simulation_of(4, h, scheme) for h in (0.02, 0.01))
    first.integrator.step(10)
    first.saveState(str(tmp_path / "saved"))
    second.loadState(str(tmp_path / "saved"))
    second.integrator.setStepSize(0.01)
    start = shown(second)
    assert_same(start, shown(first))
    second.integrator.step(10)
    assert_same(inner(second), inner(fresh(second, scheme, 0.01, start, 10)))


@pytest.mark.parametrize("scheme", PROCESSED)
def test_a_failed_call_leaves_the_inner_state_of_the_last_one(scheme):
    """A blow-up, and then the run goes on as if there had been none."""
    simulation = moved(scheme, [10])
    x = snapshot(simulation)[0]
    simulation.integrator.setStepSize(1e3)
    with pytest.raises(rb.IntegrationError):
        simulation.integrator.step(5)
    np.testing.assert_allclose(snapshot(simulation)[0], x, rtol=0.0, atol=1e-2)
    assert simulation.context.getStepCount() == 10
    simulation.integrator.setStepSize(0.02)
    simulation.integrator.step(10)
    assert distance(shown(simulation), shown(moved(scheme, [20]))) < 1e-3


# -- what OpenMM does between steps -----------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["W2_1", "W4_4"])
@pytest.mark.parametrize("step", [0.2, 1.0])
def test_a_step_that_is_far_too_long_diverges_in_the_processor_already(scheme, step):
    _topology, system, positions = rb.rigid_water(8)
    integrator = rb.ExactRigidBodyIntegrator(step, scheme)
    _context = starts.context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(300.0, 3)
    with pytest.raises(rb.IntegrationError, match=r"step 1,.* kinetic energy rose from"):
        integrator.step(100)


@pytest.mark.parametrize("scheme", PROCESSED)
@pytest.mark.parametrize("interval", [1, 4])
def test_a_remover_of_motion_costs_at_most_two_percent_more(scheme, interval):
    """It acts on the momenta of the inner state, which are at rest as a whole with those that are shown."""
    evaluations = []
    for remover in (None, openmm.CMMotionRemover(interval)):
        topology, system, positions = rb.dipole_fluid(8, seed=1, trap=0.5)
        if remover:
            system.addForce(remover)
        integrator = rb.ExactRigidBodyIntegrator(0.01, scheme)
        simulation = starts.simulation_of(topology, system, integrator, positions, kelvin=KT, seed=2)
        simulation.step(100)
        evaluations.append(integrator.timings.evaluations)
    assert evaluations[1] <= 1.02 * evaluations[0]
    np.testing.assert_allclose(inner(simulation).P[0].sum(axis=1), 0.0, atol=1e-12)


def water_under_pressure(scheme, frequency, pressure=1.0, h=0.0005, n=27):
    """Return a Simulation of water with a barostat."""
    topology, system, positions = rb.rigid_water(
        n, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4 * unit.nanometer
    )
    if frequency is not None:
        barostat = openmm.MonteCarloBarostat(pressure * unit.bar, 300.0 * unit.kelvin, frequency)
        barostat.setRandomNumberSeed(1)
        system.addForce(barostat)
    integrator = rb.ExactRigidBodyIntegrator(h, scheme, checkDivergence=False)  # which asks for energies
    simulation = starts.simulation_of(topology, system, integrator, positions)
    simulation.minimizeEnergy(tolerance=100.0, maxIterations=50)
    integrator.setVelocitiesToTemperature(300.0, 1)
    return simulation


def volume(simulation):
    return simulation.context.getState().getPeriodicBoxVolume()._value


@pytest.mark.parametrize("name", ["W2_1", "V2_C17"])
def test_a_barostat_processes_at_the_steps_where_it_acts_alone(name):
    """The way out at each of its attempts, and the way back in only where the box has changed."""
    scheme, frequency, attempts = rb.SCHEMES[name], 5, 6
    kicks = scheme.processing // 2
    simulation = water_under_pressure(name, frequency, pressure=1e3)
    integrator, costs, changed = simulation.integrator, [], []
    integrator.step(1)
    for _ in range(attempts * frequency):
        before, box = integrator.timings.evaluations, volume(simulation)
        integrator.step(1)
        changed.append(volume(simulation) != box)
        costs.append(integrator.timings.evaluations - before)
    assert sum(changed) > 0
    plain = scheme.forces + (scheme.output_forces if scheme.output else kicks)
    late = [c for k, c in enumerate(costs) if (k + 2) % frequency]
    assert max(late) <= scheme.forces + kicks + LOOK
    assert late.count(plain + LOOK) >= len(late) - max(0, scheme.memory[0] - 1) * (sum(changed) + 1)
    acted = [c for k, c in enumerate(costs) if not (k + 2) % frequency]
    assert all(changed[k] == 0 for k in range(len(changed)) if (k + 2) % frequency)
    assert max(acted) <= scheme.forces + 3 * kicks + 1 + 2  # energies of a trial volume
    whole = water_under_pressure(name, frequency, pressure=1e3)
    before = whole.integrator.timings.evaluations
    whole.integrator.step(1 + attempts * frequency)
    spent = whole.integrator.timings.evaluations - before
    most = 2 * kicks + 1 + 2  # there and back; with the force behind the change, and two energies
    assert spent <= kicks + (1 + attempts * frequency) * scheme.forces + attempts * most + kicks


@pytest.mark.parametrize("scheme", PROCESSED)
def test_a_barostat_that_never_moves_anything_leaves_the_run_and_what_is_shown_as_they_are(scheme):
    """Its updates look at the true state, which the inner one does not notice: one of no axis is never accepted."""
    ends = []
    for calls, frequency in (([12], None), ([12], 3), ([3] * 4, 3), ([5, 7], 1)):
        topology, system, positions = rb.rigid_water(
            27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4 * unit.nanometer
        )
        if frequency:
            system.addForce(
                openmm.MonteCarloAnisotropicBarostat((1.0, 1.0, 1.0), 300.0, False, False, False, frequency)
            )
        integrator = rb.ExactRigidBodyIntegrator(0.0005, scheme)
        simulation = starts.simulation_of(topology, system, integrator, positions)
        integrator.setVelocitiesToTemperature(300.0, 1)
        for n in calls:
            integrator.step(n)
        ends.append((inner(simulation), shown(simulation)))
    for ours in ends[1:]:
        for a, b in zip(ours, ends[0], strict=True):
            assert_same(a, b)


# -- what a user changes by less than a rounding of the platform -------------------------------------------------------


def test_a_saved_state_is_taken_up_once():
    """What the run makes of it counts from then on, whatever is set in the Context."""
    simulation = moved("S2_2", [10])
    checkpoint = simulation.context.createCheckpoint()
    simulation.integrator.step(10)
    ahead = shown(simulation)
    simulation.context.loadCheckpoint(checkpoint)
    simulation.integrator.step(10)
    assert_same(shown(simulation), ahead)
    simulation.context.setVelocities(snapshot(simulation)[1] + [1e-12, 0.0, 0.0])
    assert distance(shown(simulation), ahead) < 1e-11
