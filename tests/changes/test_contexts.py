"""The native engine in a Context: what users set, what OpenMM does between steps, what fails, and what is saved."""

import copy
import sys
from functools import partial

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from both_engines import apart, begun, maker, pair
from openmm_exactrb.errors import IntegrationError, NonFiniteError
from openmm_exactrb.library.library import Machine, library
from starts import held
from zoo import water

pytestmark = [pytest.mark.library, pytest.mark.opencl]
LONG = pytest.mark.validate
H = 0.001


@pytest.fixture(scope="module")
def box():
    """A System of 27 molecules of water, and positions."""
    return water()


def make(scheme="W2_1", h=H, **options):
    return rb.ExactRigidBodyIntegrator(h, scheme, engine="native", **options)


def on_device(box, integrator=None, **options):
    return begun(*box, integrator or make(), **options)


def device_of(context):
    return Machine(library(), context.getIntegrator())


EVALUATIONS = 10**9


def pull_that_fails(state, n):
    """Return energy and forces, so many times."""
    global EVALUATIONS
    EVALUATIONS -= 1
    if EVALUATIONS < 0:
        raise RuntimeError("the device is lost")
    return 0.0, np.full((n, 3), 5.0)


def lengths(context):
    x = held(context)[0].reshape(-1, 3, 3)
    return np.array([np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in ((0, 1), (0, 2), (1, 2))])


@pytest.mark.parametrize(
    ("scheme", "forces"), [("S2_2", 2), ("W2_1", 1), pytest.param("S6_10", 10, marks=LONG), ("BAOA", 1)]
)
def test_a_step_launches_one_kernel_a_force_and_a_call_a_few_more(box, scheme, forces):
    thermal = scheme == "BAOA"
    context = on_device(
        box, rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, H, engine="native") if thermal else make(scheme)
    )
    for _ in range(6):  # till no call makes kinetic energy that would be compared, and forces are remembered
        context.getIntegrator().step(20)
    device, steps = device_of(context), 20
    launches, evaluations = device.launches, device.evaluations
    context.getIntegrator().step(steps)
    assert device.evaluations - evaluations == steps * forces
    assert device.launches - launches <= steps * forces + 5


@pytest.mark.parametrize("scheme", [pytest.param("S2_2", marks=LONG), "W2_1"])
def test_what_is_set_between_calls_is_taken_up_as_on_the_host(box, scheme):
    contexts = pair(*box, maker(scheme, H))
    for change in range(6):
        for context in contexts:
            integrator = context.getIntegrator()
            if change == 1:
                x = context.getState(positions=True).getPositions(asNumpy=True)._value
                x[3:6] += 0.01
                context.setPositions(x)
            elif change == 2:
                context.setVelocities(0.5 * held(context)[1])
            elif change == 3:
                integrator.setStepSize(2.0 * H)
            elif change == 4:
                context.setTime(1.0)
                context.setStepCount(7)
            elif change == 5:
                context.reinitialize(preserveState=True)
            integrator.step(4)
        assert apart(*contexts) < 1e-11
    assert contexts[1].getStepCount() == contexts[0].getStepCount()


def test_a_parameter_and_a_box_act_from_the_next_call_on(box):
    system, positions = copy.deepcopy(box[0]), box[1]
    field = openmm.CustomExternalForce("k*x")
    field.addGlobalParameter("k", 0.0)
    for i in range(0, system.getNumParticles(), 3):
        field.addParticle(i)
    system.addForce(field)
    contexts = pair(system, positions, maker("W2_1", H))
    for context in contexts:
        context.getIntegrator().step(4)
        context.setParameter("k", 30.0)
        context.getIntegrator().step(4)
        context.setPeriodicBoxVectors(*(1.05 * np.array(context.getState().getPeriodicBoxVectors()._value)))
        context.getIntegrator().step(4)
    assert apart(*contexts) < 1e-11


@pytest.mark.parametrize(("scheme", "frequency"), [pytest.param("S2_2", 1, marks=LONG), ("W2_1", 1), ("S2_2", 3)])
def test_the_motion_of_the_centre_of_mass_is_removed_as_on_the_host(box, scheme, frequency):
    system = copy.deepcopy(box[0])
    system.addForce(openmm.CMMotionRemover(frequency))
    contexts = pair(system, box[1], maker(scheme, H))
    for context in contexts:
        context.setVelocities(held(context)[1] + [0.3, 0.0, 0.0])
        context.setStepCount(1)  # steps count, and not calls
        context.getIntegrator().step(11)
    assert apart(*contexts) < 1e-9  # OpenMM's sum is in single precision
    masses = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])
    assert np.abs(masses @ held(contexts[1])[1]).max() < 1e-3


def test_an_andersen_thermostat_pushes_whole_bodies(box):
    system = copy.deepcopy(box[0])
    system.addForce(openmm.AndersenThermostat(600.0, 1000.0))
    context = on_device((system, box[1]), make("S2_2"))
    before = lengths(context)
    kinetic = context.getState(energy=True).getKineticEnergy()._value
    context.getIntegrator().step(50)
    assert context.getState(energy=True).getKineticEnergy()._value > 1.1 * kinetic
    np.testing.assert_allclose(lengths(context), before, rtol=0.0, atol=1e-13)


def test_molecules_that_openmm_wraps_and_reorders_move_on(box):
    """Over more steps than OpenMM has between two reorderings."""
    contexts = pair(*box, maker("S2_2", H))
    for context in contexts:
        context.setVelocities(held(context)[1] + [5.0, -3.0, 2.0])
        context.getIntegrator().step(300)
    moved = (held(contexts[1])[0] - box[1]).mean(axis=0)
    np.testing.assert_allclose(moved, 0.3 * np.array([5.0, -3.0, 2.0]), rtol=0.0, atol=0.1)
    assert apart(*contexts) < 1e-3  # chaos has had its time, and no box vector is between them


def test_a_state_that_is_not_finite_names_the_bodies_and_leaves_the_context(box):
    context = on_device(box)
    context.getIntegrator().step(3)
    v = held(context)[1]
    v[6:9] = 1e7
    context.setVelocities(v)
    before = held(context)
    with pytest.raises(NonFiniteError, match=r"body 2 \(particles 6, 7, 8\)"):
        context.getIntegrator().step(2)
    np.testing.assert_allclose(held(context), before, rtol=1e-13, atol=1e-13)  # kept and restored in mixed precision
    assert context.getStepCount() == 3


def test_a_force_that_fails_within_a_call_leaves_the_context_and_its_checkpoints(box, monkeypatch):
    """OpenMM's error arrives; the run continues after the last complete step, or in another Context."""
    system = copy.deepcopy(box[0])
    system.addForce(openmm.PythonForce(partial(pull_that_fails, n=len(box[1]))))
    one, other = (on_device((system, box[1])) for _ in range(2))
    for context in (one, other):
        context.getIntegrator().step(3)
    one.loadCheckpoint(saved := one.createCheckpoint())  # forces are evaluated again after it, as in the other
    monkeypatch.setattr(sys.modules[__name__], "EVALUATIONS", 4)
    with pytest.raises(openmm.OpenMMException, match="the device is lost"):
        one.getIntegrator().step(10)
    done = one.getStepCount() - 3
    assert 0 < done < 4
    monkeypatch.undo()
    one.loadCheckpoint(one.createCheckpoint())
    other.loadCheckpoint(saved)
    other.getIntegrator().step(done)
    for context in (one, other):
        context.getIntegrator().step(5)
    assert apart(one, other) == 0.0


def test_steps_far_too_long_are_an_error_and_leave_the_context(box):
    system = copy.deepcopy(box[0])
    force = openmm.MonteCarloBarostat(1.0, 300.0, 1)
    system.addForce(force)
    context = on_device((system, box[1]), make("S2_2", 0.1))
    before, volume = held(context), context.getState().getPeriodicBoxVolume()
    with pytest.raises(IntegrationError, match="Context keeps the state before this step"):
        context.getIntegrator().step(20)
    np.testing.assert_allclose(held(context), before, rtol=0.0, atol=1e-13)
    assert context.getState().getPeriodicBoxVolume() == volume
    context.getIntegrator().setStepSize(H)
    context.getIntegrator().step(3)


def test_reading_energies_and_forces_and_minimising_leaves_the_run_right(box):
    contexts = pair(*box, maker("W2_1", H))
    for context in contexts:
        context.getIntegrator().step(3)
        context.getState(energy=True, forces=True, groups={0})
        context.getIntegrator().step(3)
    assert apart(*contexts) < 1e-11
    energies = [context.getState(energy=True).getPotentialEnergy()._value for context in contexts]
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)


def test_force_groups_are_respected(box):
    contexts = pair(*box, maker("S2_2", H))
    for context in contexts:
        context.getIntegrator().step(2)
        context.getIntegrator().setIntegrationForceGroups({1})
        context.getIntegrator().step(5)
    assert apart(*contexts) < 1e-12


def test_an_integrator_with_a_program_that_openmm_read_alone_performs_its_steps(box):
    context = on_device(box)
    context.getIntegrator().step(1)
    text = openmm.XmlSerializer.serialize(context.getIntegrator())
    alone = openmm._openmm.XmlSerializer__deserializeIntegrator(text)  # noqa: SLF001
    assert openmm.XmlSerializer.serialize(alone) == text
    other = openmm.Context(copy.deepcopy(box[0]), alone, context.getPlatform())
    other.setPositions(box[1])
    alone.step(1)
    assert (other.getStepCount(), np.isfinite(other.getState(energy=True).getPotentialEnergy()._value)) == (1, True)
