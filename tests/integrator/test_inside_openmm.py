"""Steps that OpenMM's C++ starts: parts of a CompoundIntegrator, copies of them, and objects of OpenMM's classes."""

import _thread
import gc
import os
import subprocess
import sys
import threading
import weakref
from dataclasses import replace

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from every_integrator import MOVING, made
from lifetimes import assert_freed_without_the_garbage_collector
from openmm_exactrb.library.library import Machine
from openmm_exactrb.openmm_access.handed_out import FUNCTIONS
from places import platform_for
from products import spread_over
from starts import context_of, held, velocities_of

pytestmark = pytest.mark.library

PLACES = [
    ("Reference", "host"),
    ("Reference", "native"),
    ("CPU", "native"),
    pytest.param("OpenCL", "native", marks=pytest.mark.opencl),
    pytest.param("OpenCL", "host", marks=pytest.mark.opencl),
]
EVERYWHERE = pytest.mark.parametrize(("platform", "engine"), PLACES)
WATER = rb.rigid_water(27)[1:]
H = 0.002


def atoms():
    """Return a System of atoms without constraints in a trap, and their positions."""
    system, trap = openmm.System(), openmm.CustomExternalForce("1000*(x^2+2*y^2+3*z^2)")
    for _ in range(3):
        trap.addParticle(system.addParticle(12.0))
    system.addForce(trap)
    return system, np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])


def langevin(engine="auto", seed=5, **arguments):
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, H, engine=engine, **arguments)
    integrator.setRandomNumberSeed(seed)
    return integrator


def openmms(kind=openmm.LangevinMiddleIntegrator, seed=5):
    integrator = kind(300.0, 1.0, H)
    integrator.setRandomNumberSeed(seed)
    return integrator


def compound_of(*integrators):
    compound = openmm.CompoundIntegrator()
    for integrator in integrators:
        compound.addIntegrator(integrator)
    return compound


def moving(integrator, platform="Reference", system=WATER[0], positions=WATER[1]):
    """Return the Context of molecules in motion."""
    if platform == "OpenCL":
        place, properties = platform_for("native")
        context = openmm.Context(system, integrator, place, properties)
    elif platform == "CPU":
        context = openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"), {"Threads": "1"})
    else:
        context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    context.setVelocities(drawn(system, positions))
    return context


def drawn(system, positions):
    """Return velocities, which OpenMM's LangevinMiddleIntegrator would shift by half a step."""
    context = context_of(system, openmm.VerletIntegrator(H), positions, kelvin=300.0, seed=7)
    return velocities_of(context)


def without_python(integrator):
    """Return an object of OpenMM's class, without a Python part, for a copy of an integrator."""
    text = openmm.XmlSerializer.serialize(integrator)
    return openmm._openmm.XmlSerializer__deserializeIntegrator(text)  # noqa: SLF001


def cloned(compound):
    return openmm.XmlSerializer.clone(compound)


def read(compound):
    return openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(compound))


HOLDERS = {
    "bare": without_python,
    "part": compound_of,
    "second part": lambda one: compound_of(openmms(), one),
    "clone": lambda one: cloned(compound_of(one)),
    "XML": lambda one: read(compound_of(one)),
}


# -- the same bits ----------------------------------------------------------------------------------------------------


@spread_over({"holder": HOLDERS, "platform, engine": PLACES}, times=2)
def test_steps_are_those_of_the_integrator_alone(platform, engine, holder):
    alone = moving(langevin(engine), platform)
    alone.getIntegrator().step(7)
    holding = HOLDERS[holder](langevin(engine))
    if holder == "second part":
        holding.setCurrentIntegrator(1)
    context = moving(holding, platform)
    for n in (3, 0, 4):
        holding.step(n)
    np.testing.assert_array_equal(held(context), held(alone))
    assert (context.getStepCount(), context.getTime()) == (7, alone.getTime())


@pytest.mark.parametrize("name", MOVING)
def test_every_kind_of_dynamics_is_performed(name):
    integrator, (system, positions) = MOVING[name]
    contexts = []
    for hold in (lambda one: one, compound_of, without_python):
        one = openmm.XmlSerializer.clone(integrator)
        one.setRandomNumberSeed(3)
        holding = hold(one)
        contexts.append(moving(holding, "Reference", system, positions))
        holding.step(5)
    for context in contexts[1:]:
        np.testing.assert_array_equal(held(context), held(contexts[0]))


@EVERYWHERE
def test_a_part_at_constant_energy_continues_where_another_integrator_stopped(platform, engine):
    for scheme, start in (("S2_2", atoms()), ("W2_1", WATER)):
        compound = compound_of(rb.ExactRigidBodyIntegrator(H, scheme, engine=engine), openmm.VerletIntegrator(H))
        context = moving(compound, platform, *start)
        compound.step(3)
        compound.setCurrentIntegrator(1)
        compound.step(4)
        middle = context.getState(positions=True, velocities=True)
        compound.setCurrentIntegrator(0)
        compound.step(3)
        fresh = rb.ExactRigidBodyIntegrator(H, scheme, engine=engine)
        other = moving(fresh, platform, *start)
        other.setPositions(middle.getPositions())
        other.setVelocities(middle.getVelocities())
        fresh.step(3)
        assert np.abs(held(context) - held(other))[0].max() < (1e-6 if platform == "CPU" else 1e-9)


@EVERYWHERE
def test_checkpoints_and_states_of_a_compound_continue_it(platform, engine):
    def run(n, loaded=None):
        compound = compound_of(langevin(engine, scheme="W2_3m"), openmms())
        context = moving(compound, platform)
        if loaded is not None:
            loaded(context)
        compound.step(n)
        return context

    whole = run(4)
    kept = whole.createCheckpoint()
    state = whole.getState(positions=True, velocities=True, parameters=True, integratorParameters=True)
    whole.getIntegrator().step(5)
    tolerance = 0.0 if platform != "CPU" else 1e-6
    for loaded in (
        lambda context: context.loadCheckpoint(kept),
        lambda context: context.setState(state),
        lambda context: context.setState(openmm.XmlSerializer.clone(state)),
    ):
        np.testing.assert_allclose(held(run(5, loaded)), held(whole), rtol=0.0, atol=tolerance)


@EVERYWHERE
def test_barostats_act_in_a_compound(platform, engine):
    _, system, positions = rb.rigid_water(64, nonbondedMethod=openmm.app.CutoffPeriodic, nonbondedCutoff=0.5)
    barostat = openmm.MonteCarloBarostat(1.0, 300.0, 2)
    barostat.setRandomNumberSeed(3)
    system.addForce(barostat)
    boxes = []
    for hold in (lambda one: one, compound_of):
        holding = hold(langevin(engine))
        context = moving(holding, platform, system, positions)
        holding.step(12)
        boxes.append(context.getState().getPeriodicBoxVolume()._value)
    assert boxes[0] != moving(langevin(engine), platform, system, positions).getState().getPeriodicBoxVolume()._value
    assert boxes[1] == pytest.approx(boxes[0], rel=1e-6 if platform == "CPU" else 1e-12)


# -- settings ---------------------------------------------------------------------------------------------------------


def test_settings_of_a_part_are_those_of_its_compound():
    compound = compound_of(langevin())
    context = moving(compound)
    part = compound.getIntegrator(0)
    assert (type(part), compound.getIntegrator(0)) == (rb.ExactRigidBodyLangevinIntegrator, part)
    compound.setStepSize(0.001)
    compound.setIntegrationForceGroups(3)
    compound.step(2)
    assert context.getTime()._value == pytest.approx(0.002, rel=1e-14)
    assert (part.getSettings()["arguments"]["stepSize"], part.getIntegrationForceGroups()) == (0.001, 3)
    part.setTemperature(320.0)
    part.setStepSize(0.003)
    compound.step(1)
    assert compound.getStepSize()._value == 0.003
    assert openmm.XmlSerializer.clone(compound).getIntegrator(0).getTemperature()._value == 320.0
    part.step(2)
    assert context.getStepCount() == 5


def test_a_part_of_a_user_is_copied_in_the_process():
    own = replace(rb.SCHEMES["S2_2"], name="own")
    compound = compound_of(rb.ExactRigidBodyIntegrator(H, own))
    alone = moving(rb.ExactRigidBodyIntegrator(H, own))
    copied = openmm.XmlSerializer.clone(compound)
    context = moving(copied)
    for one in (alone.getIntegrator(), copied):
        one.step(3)
    np.testing.assert_array_equal(held(context), held(alone))


# -- errors, interruptions, lifetimes ---------------------------------------------------------------------------------


@EVERYWHERE
def test_errors_have_their_message_and_leave_the_state(platform, engine):
    compound = compound_of(rb.ExactRigidBodyIntegrator(0.5, engine=engine))
    context = moving(compound, platform)
    before = held(context)
    for _ in range(2):
        with pytest.raises(openmm.OpenMMException, match="step 1, after 0 ps"):
            compound.step(5)
    np.testing.assert_allclose(held(context), before, rtol=0.0, atol=1e-6)
    with pytest.raises(openmm.OpenMMException, match="number of steps must be a whole number"):
        compound.step(-1)
    with pytest.raises(openmm.OpenMMException, match="not bound to a context"):
        compound_of(made()).step(1)


def test_an_integrator_at_work_in_another_thread_is_refused():
    system, positions = WATER
    system, inside, over = openmm.XmlSerializer.clone(system), threading.Event(), threading.Event()

    def waits(state):
        inside.set()
        over.wait(30)
        return 0.0, np.zeros((system.getNumParticles(), 3))

    system.addForce(openmm.PythonForce(waits))
    compound = compound_of(rb.ExactRigidBodyIntegrator(H))
    context = openmm.Context(system, compound, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    thread = threading.Thread(target=compound.step, args=(1,))
    thread.start()
    assert inside.wait(30)
    with pytest.raises(openmm.OpenMMException, match="already performing a step"):
        compound.step(1)
    over.set()
    thread.join()
    assert context.getStepCount() == 1


def test_threads_step_compounds_at_the_same_time():
    def run(seed, ends):
        compound = compound_of(langevin(seed=seed), openmms())
        context = moving(compound)
        for _ in range(10):
            compound.step(2)
        ends[seed] = held(context)

    alone, together = {}, {}
    for seed in (1, 2, 3):
        run(seed, alone)
    threads = [threading.Thread(target=run, args=(seed, together)) for seed in (1, 2, 3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed in alone:
        np.testing.assert_array_equal(together[seed], alone[seed])


@pytest.mark.parametrize("engine", ["host", "native"])
def test_ctrl_c_reaches_the_script(engine):
    compound = compound_of(rb.ExactRigidBodyIntegrator(H, engine=engine))
    context = moving(compound)
    compound.step(1)
    timer = threading.Timer(0.5, _thread.interrupt_main)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        compound.step(10**9)
    assert 1 <= context.getStepCount() < 10**9  # the host returns to the state before the call
    compound.step(1)


def test_nothing_is_left_of_a_compound():
    def dropped():
        compound = compound_of(langevin(), openmms())
        context = moving(compound)
        compound.step(2)
        part = compound.getIntegrator(0)
        assert compound.getIntegrator(0) is part
        return [weakref.ref(one) for one in (context, compound, part)]

    assert_freed_without_the_garbage_collector(dropped)


@pytest.mark.parametrize("order", ["context compound part", "part compound context", "compound part context"])
def test_a_compound_can_be_deleted_in_any_order(order):
    context = moving(compound_of(langevin()))
    compound = context.getIntegrator()
    names = {"context": context, "compound": compound, "part": compound.getIntegrator(0)}
    compound.step(1)
    del context, compound
    for name in order.split():
        del names[name]
    gc.collect()


def test_a_process_ends_with_everything_alive():
    script = """
import openmm, openmm_exactrb as rb
system, positions = rb.rigid_water(8)[1:]
compound = openmm.CompoundIntegrator()
compound.addIntegrator(rb.ExactRigidBodyLangevinIntegrator(300, 1, 0.002))
copied = openmm.XmlSerializer.clone(compound)
kept = []
for one in (compound, copied, rb.ExactRigidBodyIntegrator(0.002)):
    context = openmm.Context(system, one, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    one.step(2)
    kept += [context, one]
print("done")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=300)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_steps_its_compound():
    script = """
import os, openmm, openmm_exactrb as rb
system, positions = rb.rigid_water(8)[1:]
rb.ExactRigidBodyIntegrator(0.002)
if os.fork() == 0:
    compound = openmm.CompoundIntegrator()
    compound.addIntegrator(rb.ExactRigidBodyIntegrator(0.002))
    context = openmm.Context(system, compound, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    compound.step(2)
    os._exit(context.getStepCount())
print(os.waitstatus_to_exitcode(os.wait()[1]))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=300)
    assert done.stdout == "2\n", done.stderr


# -- OpenMM remains as it was -----------------------------------------------------------------------------------------


def test_a_run_makes_one_context_and_compiles_one_program(monkeypatch):
    made_contexts, calls, programs = [], [], []
    original, load = openmm.Context.__init__, Machine.load
    monkeypatch.setattr(Machine, "load", lambda self, text: (programs.append(1), load(self, text))[1])
    monkeypatch.setattr(openmm.Context, "__init__", lambda self, *a: (made_contexts.append(1), original(self, *a))[1])
    system, positions = WATER
    system = openmm.XmlSerializer.clone(system)

    def counts(state):
        calls.append(1)
        return 0.0, np.zeros((system.getNumParticles(), 3))

    system.addForce(openmm.PythonForce(counts))
    integrator = rb.ExactRigidBodyIntegrator(H, "S2_2")
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    address = int(integrator.this)
    integrator.step(10)
    evaluations = 10 * integrator.forceEvaluationsPerStep
    assert evaluations <= len(calls) <= evaluations + 2  # at the ends of a call, to notice what the function reads
    integrator.step(2)
    assert (len(made_contexts), len(programs), int(integrator.this)) == (1, 1, address)
    assert integrator.getEngine() == "native"


def test_openmms_classes_are_what_they_were():
    """An import, a run and its deletion replace nothing but the functions that return integrators."""
    script = """
import openmm
classes = [kind for kind in vars(openmm.openmm).values() if isinstance(kind, type)]
before = {kind: dict(vars(kind)) for kind in classes}
import openmm_exactrb as rb
from openmm_exactrb.openmm_access.handed_out import FUNCTIONS
def run():
    system, positions = rb.rigid_water(8)[1:]
    for integrator in (rb.ExactRigidBodyIntegrator(0.002), rb.ExactRigidBodyLangevinIntegrator(300, 1, 0.002)):
        context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
        context.setPositions(positions)
        context.setVelocitiesToTemperature(300)
        openmm.LocalEnergyMinimizer.minimize(context, 10.0, 2)
        integrator.step(3)
        context.setState(context.getState(positions=True, velocities=True, integratorParameters=True))
run()
changed = [(kind, name) for kind in classes for name in {**before[kind], **vars(kind)}
           if name != "__slotnames__" and before[kind].get(name) is not vars(kind).get(name)]
print(sorted(changed, key=str) == sorted(FUNCTIONS, key=str), changed)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=300)
    assert done.stdout.startswith("True"), done.stdout + done.stderr
    assert len(FUNCTIONS) == 3


def test_contexts_of_openmms_integrators_are_openmms():
    assert type(moving(openmms())) is openmm.Context
    assert type(moving(compound_of(openmms()))) is openmm.Context
    ours = moving(langevin())
    assert (isinstance(ours, openmm.Context), type(ours).__name__) == (True, "Context")
