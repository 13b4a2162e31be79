"""Between calls the device keeps the inner state of a processed scheme, and shows an output that costs little."""

import copy

import numpy as np
import openmm
import pytest
from devices import REFERENCE, context_of, gpu_platform, pair, shown, stepped
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.engines.custom_program import names

INTERVAL = 0.001  # ps between forces


@pytest.fixture(scope="module")
def water():
    topology, system, positions = rb.rigid_water(2)
    return topology, system, positions


def step_of(scheme):
    return INTERVAL * rb.SCHEMES[scheme].forces


def inner_of(context):
    values = map(context.getIntegrator().getPerDofVariableByName, names.INNER)
    return np.array([np.array(value) for value in values])


def simulation_of(topology, system, positions, scheme, platform=REFERENCE, properties=None):
    integrator = rb.ExactRigidBodyIntegrator(step_of(scheme), scheme=scheme, engine="device")
    simulation = app.Simulation(topology, copy.deepcopy(system), integrator, platform, properties)
    simulation.context.setPositions(positions)
    integrator.setVelocitiesToTemperature(300.0, 1)
    return simulation


def forces_per_step(simulation):
    """Return the evaluations of a step behind the first ten, which enter the inner coordinates."""
    simulation.integrator.checkDivergence = False  # so few molecules heat, and their energy would be looked at
    simulation.integrator.timings.reset()
    simulation.step(20)
    return simulation.integrator.timings.evaluations / 20


@pytest.mark.parametrize(
    ("scheme", "most", "remover"), [("W2_1", 1.02, False), ("W2_1", 1.02, True), ("W4_4", 4.25, True)]
)
def test_a_simulation_costs_what_the_name_of_the_scheme_says(scheme, most, remover):
    topology, system, positions = rb.rigid_water(2, removeCMMotion=remover)
    simulation = simulation_of(topology, system, positions, scheme)
    simulation.step(10)
    assert forces_per_step(simulation) <= most


@pytest.mark.opencl
def test_a_device_costs_the_same_and_shows_what_the_host_shows(water):
    platform, (_, system, positions), scheme = gpu_platform(), water, "W2_1"
    simulation = simulation_of(*water, scheme, platform, {"Precision": "double"})
    host = context_of(system, positions, "host", scheme=scheme, h=step_of(scheme))
    simulation.step(10)
    np.testing.assert_allclose(shown(simulation.context), stepped(host, 10), rtol=0.0, atol=1e-5)
    assert forces_per_step(simulation) <= 1.02


@pytest.mark.parametrize("scheme", ["W2_1", pytest.param("W4_4", marks=pytest.mark.validate)])
def test_calls_of_ten_steps_are_one_call_of_the_inner_state(water, scheme):
    """Bit by bit where a drift is one rotation at all times: how many it is depends on where a call begins."""
    _, system, positions = water
    h = min(step_of(scheme), 0.004)
    one, ten = (context_of(system, positions, "device", scheme=scheme, h=h) for _ in range(2))
    stepped(one, 30)
    for _ in range(3):
        stepped(ten, 10)
    np.testing.assert_array_equal(inner_of(one), inner_of(ten))
    assert (one.getStepCount(), one.getTime()) == (ten.getStepCount(), ten.getTime())


@pytest.mark.parametrize("scheme", ["W2_1", "W4_4"])
def test_the_host_shows_the_same_however_long_calls_are(water, scheme):
    _, system, positions = water
    host, device = pair(system, positions, scheme=scheme, h=step_of(scheme))
    for n in (1, 1, 1, 2, 10, 3):
        np.testing.assert_allclose(stepped(device, n), stepped(host, n), rtol=0.0, atol=1e-11)


def test_what_a_user_sets_is_seen(water):
    """The host and the device then continue from what was shown."""
    _, system, positions = water
    contexts = pair(system, positions, scheme="W2_1", h=0.002)
    begin = contexts[0].getState(positions=True, velocities=True)
    for change in (
        lambda context: context.setVelocities(1.1 * shown(context)[1]),
        lambda context: context.setPositions(shown(context)[0] + 1e-3),
        lambda context: context.getIntegrator().setStepSize(0.001),
    ):
        ends = []
        for context in contexts:
            context.setState(begin)
            stepped(context, 12)
            change(context)
            ends.append(stepped(context, 12))
        np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("scheme", ["W2_1", "W4_4"])
@pytest.mark.parametrize("steps", [0, 20])
def test_steps_go_on_behind_a_call_that_failed(scheme, steps, water):
    """With an inner state before it and without one; no number that is not finite is left."""
    _, system, positions = water
    one, other = (context_of(system, positions, "device", scheme=scheme, h=0.001) for _ in range(2))
    for context in (one, other):
        stepped(context, steps)
    x, v = shown(one)
    overlapping = x.copy()
    overlapping[3:6] += x[0] - x[3] + [1e-5, 0.0, 0.0]
    one.setPositions(overlapping)
    with pytest.raises(rb.NonFiniteError):
        one.getIntegrator().step(20)
    for context in (one, other):
        context.setPositions(x + 1e-3)
        context.setVelocities(v)
    np.testing.assert_allclose(stepped(one, 20), stepped(other, 20), rtol=0.0, atol=1e-12)


def test_steps_are_made_again_from_the_inner_state_where_bodies_come_to_turn_fast():
    _, system, positions = rb.rigid_water(4)
    both = pair(system, positions, scheme="W2_1", h=0.008, kelvin=0.01)
    for n in (1, 20):
        one, other = (stepped(context, n) for context in both)
    assert both[1].getIntegrator().getGlobalVariableByName("exactrb_turns") >= 4.0  # that of the second attempt
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9)


def test_a_checkpoint_keeps_the_inner_state(water):
    _, system, positions = water
    context = context_of(system, positions, "device", scheme="W2_1", h=0.001)
    stepped(context, 20)
    checkpoint = context.createCheckpoint()
    stepped(context, 10)
    other = context_of(system, positions, "device", scheme="W2_1", h=0.001)
    other.getIntegrator().step(0)
    other.loadCheckpoint(checkpoint)
    stepped(other, 10)
    np.testing.assert_array_equal(inner_of(context), inner_of(other))
    np.testing.assert_array_equal(shown(context), shown(other))


@pytest.mark.parametrize("scheme", ["V2", "W2_1", "W4_4"])
def test_evaluations_are_those_that_openmm_is_asked_for(water, scheme):
    _, system, positions = water
    calls = []

    def compute(state):
        calls.append(state)
        return 0.0, np.zeros((system.getNumParticles(), 3))

    counted = copy.deepcopy(system)
    counted.addForce(openmm.PythonForce(compute))
    integrator = rb.ExactRigidBodyIntegrator(step_of(scheme), scheme=scheme, engine="device")
    context = openmm.Context(counted, integrator, REFERENCE)
    context.setPositions(positions)
    calls.clear()
    for n in (1, 3, 10, 0):
        integrator.step(n)
        assert integrator.timings.evaluations == len(calls)
