"""Which engine engine="auto" takes, and how a run keeps it."""

import copy
import re

import numpy as np
import openmm
import pytest
from devices import REFERENCE, opencl, shown, stepped
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.context.letters import LETTERS
from openmm_exactrb.device import trial
from peptides import peptide


@pytest.fixture(scope="module")
def platform():
    return opencl()


@pytest.fixture(scope="module")
def water():
    return rb.rigid_water(4)


@pytest.fixture
def times(monkeypatch):
    """Return a function that says how long steps of the device and of the host take."""

    def say(device, host):
        monkeypatch.setattr(trial, "timed", lambda context, integrator: (device, host))
        monkeypatch.setattr(trial, "known", {})

    return say


def auto(water, platform, bath=False, precision="double", engine="auto"):
    """Return a Simulation whose engine is chosen."""
    topology, system, positions = water
    if bath:
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, "S2_2", engine=engine)
        integrator.setRandomNumberSeed(7)
    else:
        integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine=engine)
    properties = {"Precision": precision}
    simulation = app.Simulation(topology, copy.deepcopy(system), integrator, platform, properties)
    simulation.context.setPositions(positions)
    return simulation


def test_it_takes_the_device_unless_the_host_is_far_quicker(platform, water):
    simulation = auto(water, platform, precision="mixed")
    integrator = simulation.integrator
    chosen, note = integrator.getEngine(), integrator.engineNote()
    device, host = map(
        float, re.fullmatch(r"OpenCL needs (\S+) ms for a step, the host with it (\S+) ms", note).groups()
    )
    assert chosen == ("device" if device <= 1.25 * host else "host")
    same = auto(water, platform, precision="mixed", engine=chosen)
    np.testing.assert_array_equal(stepped(simulation.context, 3), stepped(same.context, 3))
    assert simulation.context.getSystem().getNumForces() == water[1].getNumForces() + (chosen == "device")
    assert auto(water, platform, precision="mixed").integrator.engineNote() == note  # measured once


@pytest.mark.parametrize(("device", "host", "engine"), [(1.0, 1.0, "device"), (1.2, 1.0, "device"), (1.3, 1.0, "host")])
def test_times_decide_with_a_margin(device, host, engine, times, platform, water):
    times(device, host)
    assert auto(water, platform).integrator.getEngine() == engine


def test_the_program_comes_behind_the_same_objects(times, platform, water):
    times(1.0, 2.0)
    simulation = auto(water, platform, True)
    context, integrator = simulation.context, simulation.integrator
    context.setTime(3.0)
    context.setStepCount(10)
    simulation.step(5)
    assert integrator.getEngine() == "device"
    assert simulation.context is context
    assert context.getIntegrator() is integrator
    assert (context.getStepCount(), simulation.currentStep) == (15, 15)
    assert context.getTime()._value == pytest.approx(3.005)
    other = auto(water, platform, True, engine="device")
    other.context.setStepCount(10)
    np.testing.assert_array_equal(stepped(other.context, 5), shown(context))
    np.testing.assert_array_equal(stepped(other.context, 4), stepped(context, 4))
    context.reinitialize(preserveState=True)
    np.testing.assert_allclose(stepped(context, 4), stepped(other.context, 4), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(("bath", "settled"), [(False, False), (True, True)])
@pytest.mark.parametrize(("first", "second"), [((1.0, 2.0), (2.0, 1.0)), ((2.0, 1.0), (1.0, 2.0))])
def test_a_checkpoint_goes_on_with_its_engine(bath, first, second, settled, times, platform, water):
    times(*first)
    simulation = auto(water, platform, bath)
    simulation.step(3)
    engine, checkpoint = simulation.integrator.getEngine(), simulation.context.createCheckpoint()
    after = stepped(simulation.context, 1 if bath else 5)
    times(*second)
    again = auto(water, platform, bath)
    if settled:
        again.step(1)
        assert again.integrator.getEngine() != engine
    again.context.loadCheckpoint(checkpoint)
    x = stepped(again.context, 1 if bath else 5)
    assert again.integrator.getEngine() == engine
    assert f"the run began with engine='{engine}'" in again.integrator.engineNote()
    if engine == "host" and not settled:
        np.testing.assert_array_equal(x, after)
    else:
        np.testing.assert_allclose(x, after, rtol=0.0, atol=1e-8)  # of OpenCL's forces
    if bath:
        assert again.integrator.getSeedInUse() == 7


@pytest.mark.parametrize(("first", "second"), [((1.0, 2.0), (2.0, 1.0)), ((2.0, 1.0), (1.0, 2.0))])
def test_a_run_in_a_folder_goes_on_with_its_engine_and_its_bits(first, second, times, platform, water, tmp_path):
    times(*first)
    whole = auto(water, platform, True)
    rb.Run(tmp_path / "whole").advance(whole, 8)
    begun = auto(water, platform, True)
    rb.Run(tmp_path / "parts").advance(begun, 3)
    times(*second)
    simulation = auto(water, platform, True)
    rb.Run(tmp_path / "parts", resume=True).advance(simulation, 8)
    assert simulation.integrator.getEngine() == whole.integrator.getEngine()
    # A call evaluates the forces of its first positions anew, on the device in sums of another order.
    np.testing.assert_allclose(shown(simulation.context), shown(whole.context), rtol=0.0, atol=1e-12)
    explicit = auto(water, platform, True, engine="host" if simulation.integrator.getEngine() == "device" else "device")
    with pytest.raises(ValueError, match="engine is"):
        rb.Run(tmp_path / "parts", resume=True).advance(explicit, 10)


def test_checkpoints_of_the_other_engine_are_refused_where_one_was_asked_for(water):
    _, system, positions = water
    contexts = {}
    for engine in ("host", "device"):
        integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine=engine)
        contexts[engine] = openmm.Context(copy.deepcopy(system), integrator, REFERENCE)
        contexts[engine].setPositions(positions)
        integrator.step(1)
    checkpoints = {engine: context.createCheckpoint() for engine, context in contexts.items()}
    for engine, other in (("host", "device"), ("device", "host")):
        contexts[engine].loadCheckpoint(checkpoints[other])
        with pytest.raises(ValueError, match=f'of a run with engine="{other}"'):
            contexts[engine].getIntegrator().step(1)


def test_single_precision_is_the_hosts(platform, water):
    simulation = auto(water, platform, precision="single")
    integrator = simulation.integrator
    assert integrator.getEngine() == "host"
    assert "set Precision to mixed or double" in integrator.engineNote()


@pytest.mark.parametrize("name", ["c", "exactrb_turns", "v"])
def test_parameters_with_the_names_of_the_program_are_the_hosts(name, times, platform, water):
    times(1.0, 2.0)
    topology, system, positions = copy.deepcopy(water)
    force = openmm.CustomExternalForce(f"{name}*x")
    force.addGlobalParameter(name, 1.0)
    force.addParticle(0)
    system.addForce(force)
    simulation = auto((topology, system, positions), platform)
    assert simulation.integrator.getEngine() == "host"
    assert f"the parameter '{name}' of a force has the name of a variable" in simulation.integrator.engineNote()
    simulation.step(1)


def test_letters_of_ones_own_are_the_hosts(times, platform, water):
    times(1.0, 2.0)
    simulation = auto(water, platform)
    integrator, asked = simulation.integrator, []

    def kicks(parts, letters):
        asked.extend(letters)
        return LETTERS["B"](parts, letters)

    assert integrator.getEngine() == "device"
    integrator.addLetter("B", kicks)
    assert integrator.getEngine() == "host"
    assert "the letter 'B' of your own" in integrator.engineNote()
    simulation.step(1)
    assert asked == ["B"]


def test_copies_choose_anew(times, platform, water):
    times(1.0, 2.0)
    simulation = auto(water, platform)
    simulation.step(1)
    twin = copy.copy(simulation.integrator)
    assert twin.getSettings() == simulation.integrator.getSettings()
    assert twin.getSettings()["arguments"]["engine"] == "auto"


def test_the_host_makes_steps_that_are_nested(platform, times):
    """A flexible molecule on the device, until steps get so long that bonded forces need steps of their own."""
    times(1.0, 2.0)
    topology, system, positions = peptide("None")
    simulation = auto((topology, system, positions), platform)
    integrator = simulation.integrator
    integrator.setStepSize(0.0005)
    integrator.setVelocitiesToTemperature(300.0, 1)
    simulation.step(20)
    assert integrator.getEngine() == "device"
    energy = integrator.totalEnergy()._value
    integrator.setStepSize(0.004)
    assert integrator.getEngine() == "host"
    assert integrator.engineNote().startswith("bonded forces are nested at this step")
    assert integrator.totalEnergy()._value == pytest.approx(energy, abs=1e-4)
    simulation.step(20)
    assert integrator.timings.fast_evaluations > 0
    assert integrator.totalEnergy()._value == pytest.approx(energy, abs=2.0)
