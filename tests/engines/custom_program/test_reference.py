"""The program of the device against the host, on the Reference platform."""

import copy
from dataclasses import dataclass, replace

import numpy as np
import openmm
import pytest
from devices import REFERENCE, STRUCTURES, all_kinds, context_of, pair, seeded, shown, stepped
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.engines.custom_program import load, names
from openmm_exactrb.schemes import Scheme, spelled
from openmm_exactrb.substeps import Substep


@dataclass(frozen=True)
class Halt(Substep):
    """A substep that changes nothing."""

    def bind(self, environment):
        return lambda state, tau: state


V2_WITH_HALTS = ((Halt(), 0.5), *rb.SCHEMES["V2"].sequence, (Halt(), 0.5))


@pytest.fixture(scope="module")
def droplet():
    _, system, positions = rb.rigid_water(4)
    return system, positions


@pytest.mark.parametrize("name", STRUCTURES)
def test_every_structure_of_rows_moves_as_on_the_host(name, droplet):
    """The device shows what the inverse processor makes of its state, and no cheaper output."""
    host, device = pair(*droplet, scheme=replace(rb.SCHEMES[name], output=()))
    (x, v), (x1, v1) = stepped(host, 10), stepped(device, 10)
    assert np.abs(x1 - x).max() <= 1e-13
    assert np.abs(v1 - v).max() <= 1e-12
    assert np.abs(x - droplet[1]._value).max() > 1e-3
    assert device.getTime()._value == pytest.approx(0.01)
    assert device.getStepCount() == 10


def test_all_kinds_of_bodies_move_as_on_the_host():
    system, positions, bodies = all_kinds()
    host, device = pair(system, positions, bodies=bodies, scheme="PEFRL")
    np.testing.assert_allclose(stepped(device, 20), stepped(host, 20), rtol=0.0, atol=1e-12)
    for one, other in zip(*(context.getIntegrator().bodyState()[1] for context in (host, device)), strict=True):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-12)
    assert host.getIntegrator().degreesOfFreedom() == device.getIntegrator().degreesOfFreedom()


def test_bodies_at_rest_and_spins_about_axes_are_no_exceptions(droplet):
    host, device = pair(*droplet)
    _, state = host.getIntegrator().bodyState()
    state.P[:] = 0.0
    state.m[:] = np.diag([0.3, 0.3, 0.3, 0.0])[:3]
    for context in (host, device):
        context.getIntegrator().setBodyState(state)
    np.testing.assert_allclose(stepped(device, 5), stepped(host, 5), rtol=0.0, atol=1e-13)


def test_the_system_is_the_same_to_all_who_look(droplet):
    host, device = pair(*droplet)
    for context in (host, device):
        context.getIntegrator().step(1)
    device.setPositions(shown(host)[0])
    states = [context.getState(energy=True, forces=True) for context in (host, device)]
    assert states[0].getPotentialEnergy() == states[1].getPotentialEnergy()
    np.testing.assert_array_equal(*(state.getForces(asNumpy=True)._value for state in states))
    gathered = device.getState(energy=True, forces=True, groups={31})
    assert gathered.getPotentialEnergy()._value == 0.0
    assert not gathered.getForces(asNumpy=True)._value.any()
    kinetic = device.getState(energy=True).getKineticEnergy()._value
    assert kinetic == pytest.approx(sum(e._value for e in device.getIntegrator().kineticEnergies()), rel=1e-12)


@pytest.mark.parametrize("own", [True, False])
def test_minimising_works(own, droplet):
    device = context_of(*droplet, "device")
    integrator = device.getIntegrator()
    integrator.step(2)
    before = device.getState(energy=True).getPotentialEnergy()
    if own:
        integrator.minimizeEnergy(maxIterations=20)
    else:
        openmm.LocalEnergyMinimizer.minimize(device, 10.0, 20)
    assert device.getState(energy=True).getPotentialEnergy() < before - 1.0 * unit.kilojoule_per_mole
    integrator.step(2)


def test_what_is_set_between_calls_is_taken_up(droplet):
    both = pair(*droplet)
    x, v = shown(both[0])

    def steps():
        one, other = (stepped(context, 3) for context in both)
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-12)
        assert both[1].getTime()._value == pytest.approx(both[0].getTime()._value, abs=1e-12)

    steps()
    for context in both:
        context.setPositions(x + 0.01)
    steps()
    for context in both:
        context.setVelocities(-v)
    steps()
    for context in both:
        context.getIntegrator().setStepSize(0.0017)
    steps()
    for context in both:
        context.getIntegrator().setVelocitiesToTemperature(100.0, 7)
    steps()
    for context in both:
        context.setPositions(x[:, ::-1])
    steps()


def test_the_state_that_is_read_is_the_one_that_moves(droplet):
    device = context_of(*droplet, "device")
    twin = context_of(*droplet, "device")
    for _ in range(3):
        twin.getIntegrator().step(2)
        twin.getIntegrator().bodyState()
        device.getIntegrator().step(2)
    np.testing.assert_array_equal(shown(twin), shown(device))


def test_a_parameter_acts_from_the_next_call_on():
    system = openmm.System()
    for _ in range(2):
        system.addParticle(1.0)
    force = openmm.CustomExternalForce("strength*(x*x+y*y+z*z)")
    force.addGlobalParameter("strength", 1.0)
    for i in range(2):
        force.addParticle(i)
    system.addForce(force)
    both = pair(system, [(0.1, 0.2, 0.3), (0.5, 0.1, 0.2)], scheme="S2_2", h=0.02)
    for strength in (1.0, 40.0):
        for context in both:
            context.setParameter("strength", strength)
        np.testing.assert_allclose(*(stepped(context, 5) for context in both), rtol=0.0, atol=1e-13)


def test_long_steps_are_made_of_several_rotations(droplet):
    system, positions = droplet
    for force in system.getForces():
        assert not isinstance(force, openmm.CMMotionRemover)
    free = openmm.System()
    for i in range(system.getNumParticles()):
        free.addParticle(system.getParticleMass(i))
    for i in range(system.getNumConstraints()):
        free.addConstraint(*system.getConstraintParameters(i))
    both = pair(free, positions, scheme="V2_drift", h=0.05, kelvin=1000.0)
    np.testing.assert_allclose(*(stepped(context, 10) for context in both), rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("scheme", ["Chin4A", pytest.param("V2_gradient_C17", marks=pytest.mark.validate)])
def test_displaced_places_and_several_rotations(scheme, droplet):
    both = pair(*droplet, scheme=scheme, h=0.002, kelvin=20000.0)
    one, other = (stepped(context, 3) for context in both)
    assert both[1].getIntegrator().getGlobalVariableByName("exactrb_turns") > 1.0
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-11)


def test_bodies_that_come_to_turn_fast_are_turned_in_shorter_rotations(droplet):
    both = pair(*droplet, h=0.004, scheme="V2_drift", kelvin=1.0)
    one, other = (stepped(context, 12) for context in both)
    assert both[1].getIntegrator().getGlobalVariableByName("exactrb_turns") >= 1.0
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-13)


def test_a_body_beyond_the_range_of_the_series_is_noticed(droplet):
    system, positions = droplet
    device = context_of(system, positions, "device", h=0.002, scheme="V2_drift")
    force = openmm.CustomExternalForce("-push*x")
    force.addGlobalParameter("push", 0.0)
    for i in range(0, system.getNumParticles(), 3):
        force.addParticle(i)
    device.getSystem().addForce(force)
    device.reinitialize(preserveState=True)
    integrator = device.getIntegrator()
    integrator.step(2)
    before, time = shown(device), device.getTime()
    device.setParameter("push", 1e6)
    with pytest.raises(rb.NonFiniteError, match="fewer steps a call"):
        integrator.step(20)
    np.testing.assert_allclose(shown(device), before, rtol=0.0, atol=1e-12)
    assert (device.getTime(), device.getStepCount()) == (time, 2)
    device.setParameter("push", 0.0)
    integrator.step(2)
    assert np.isfinite(shown(device)).all()


def with_or_without_thermostat(engine, h, thermostat):
    """Return an integrator with or without a cold thermostat."""
    if thermostat:
        return rb.ExactRigidBodyLangevinIntegrator(10.0, 0.001, h, "W2_5", engine=engine)
    return rb.ExactRigidBodyIntegrator(h, "W2_5", engine=engine)


@pytest.mark.parametrize(("engine", "thermostat"), [("host", False), ("device", False), ("device", True)])
def test_energy_from_nowhere_is_noticed(engine, thermostat, droplet):
    system, positions = droplet
    integrator = with_or_without_thermostat(engine, 0.045, thermostat)
    integrator.setRandomNumberSeed(1)
    context = openmm.Context(copy.deepcopy(system), integrator, REFERENCE)
    context.setPositions(positions)
    sentence = r"the kinetic energy rose from .*, which no force .* The Context keeps the state before this"
    with pytest.raises(rb.IntegrationError, match=sentence):
        integrator.step(20 if engine == "host" else 5)  # each call to the device is repeated with more rotations
    if engine == "device":
        np.testing.assert_allclose(shown(context)[0], positions._value, rtol=0.0, atol=1e-12)
        assert np.abs(shown(context)[1]).max() < 1e-12
        assert context.getStepCount() == 0
        assert context.getTime()._value == 0.0
    integrator.setStepSize(0.001)
    integrator.step(5)


def pushed(push):
    """Return a System of a body of two particles and a lone one, pushed along x, and positions."""
    system = openmm.System()
    for _ in range(3):
        system.addParticle(1.0)
    system.addConstraint(0, 1, 0.1)
    force = openmm.CustomExternalForce(f"-{push!r}*x")
    for i in range(3):
        force.addParticle(i)
    system.addForce(force)
    return system, [(0.0, 0.0, 0.0), (0.0, 0.1, 0.0), (1.0, 1.0, 1.0)]


def test_forces_too_large_to_be_summed_are_loud():
    both = pair(*pushed(1e8), h=1e-9, scheme="S2_2", kelvin=0.0)
    np.testing.assert_allclose(*(stepped(context, 2) for context in both), rtol=1e-12, atol=1e-15)
    for push in (2e10, 1e12):
        device = context_of(*pushed(push), "device", h=1e-9, scheme="S2_2", kelvin=0.0)
        with pytest.raises(rb.NonFiniteError, match=r"forces on a body were beyond 1.1e\+09 kJ/mol/nm"):
            device.getIntegrator().step(2)


def test_a_lone_particle_may_be_pushed_as_hard_as_on_the_host():
    system, positions = pushed(1e12)
    (force,) = system.getForces()
    for i in range(2):
        force.setParticleParameters(i, 2, [])
    both = pair(system, positions, h=1e-12, scheme="S2_2", kelvin=0.0)
    one, other = (stepped(context, 2) for context in both)
    np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-15)
    assert one[1][2, 0] > 0.0


@pytest.mark.parametrize("engine", ["host", "device"])
def test_a_body_in_its_principal_axes_is_found_again_in_a_recreated_context(engine):
    """Numbers of an integrator outlive `reinitialize`, its vectors become zero: they are no attitude."""
    system, positions = pushed(1.0)
    context = context_of(system, positions, engine, scheme="S2_2")
    bodies, state = context.getIntegrator().bodyState()
    x = bodies.positions(state._replace(q=np.array([[1.0], [0.0], [0.0], [0.0]])), np.array(positions))
    context.getIntegrator().step(1)
    context.reinitialize()
    context.setPositions(x)
    q = context.getIntegrator().bodyState()[1].q
    np.testing.assert_allclose((q * q).sum(axis=0), 1.0, rtol=1e-12)
    fresh = context_of(system, x, engine, scheme="S2_2", kelvin=0.0)
    np.testing.assert_allclose(stepped(context, 3), stepped(fresh, 3), rtol=0.0, atol=1e-12)


def test_speeds_whose_powers_have_no_end_are_measured_otherwise(droplet):
    system = openmm.System()
    for i in range(3):
        system.addParticle(droplet[0].getParticleMass(i))
    for i, j in ((0, 1), (0, 2), (1, 2)):
        system.addConstraint(i, j, np.linalg.norm(droplet[1]._value[i] - droplet[1]._value[j]))
    both = pair(system, droplet[1][:3], scheme="S2_2", h=1e-7, kelvin=0.0)
    state = both[0].getIntegrator().bodyState()[1]
    b = 1.0 / both[0].getIntegrator().bodyState()[0].inertia[0]
    state.m[:] = [[1.2e5], [3.0], [2.0]] / (b[0] - b[2])
    for context in both:
        context.getIntegrator().setBodyState(state)
        context.getIntegrator().step(1)
    assert both[1].getIntegrator().getGlobalVariableByName("exactrb_fastest") == np.inf
    np.testing.assert_allclose(*(stepped(context, 2) for context in both), rtol=1e-9, atol=1e-12)


def test_rotations_without_end_are_refused(droplet):
    device = context_of(*droplet, "device", scheme="S2_2", h=0.001)
    device.setVelocities(1e7 * shown(device)[1])
    with pytest.raises(rb.NonFiniteError, match=r"would need .* rotations in a drift: use a smaller step size"):
        device.getIntegrator().step(1)


def test_the_rotations_of_a_drift_are_the_same_from_a_state(droplet):
    device = context_of(*droplet, "device", scheme="S2_2")
    integrator = device.getIntegrator()
    integrator.step(1)
    bodies, state = integrator.bodyState()
    measured = integrator.getGlobalVariableByName("exactrb_fastest") ** (1.0 / names.POWER)
    assert load.fastest(bodies, state) == pytest.approx(measured, rel=1e-12)


@pytest.mark.parametrize("engine", ["host", "device"])
def test_a_thermostat_that_was_made_hotter_is_no_false_alarm(engine):
    context = context_of(*liquid(seeded(openmm.AndersenThermostat(1.0, 500.0))), engine, scheme="S2_2", kelvin=1.0)
    context.getIntegrator().minimizeEnergy(maxIterations=20)
    context.setParameter(openmm.AndersenThermostat.Temperature(), 300.0)
    context.getIntegrator().step(30)
    assert context.getIntegrator().temperatures()[0]._value > 50.0


def field(state):
    """Return the energy and the forces of a field along x that swings."""
    x, strength = state.getPositions(asNumpy=True)._value, 20.0 * np.cos(10.0 * state.getTime()._value)
    return strength * x[0, 0], np.array([[-strength, 0.0, 0.0]])


def driven(engine):
    """Return a Context of a particle in a trap and a field that swings with the trap's frequency."""
    system = openmm.System()
    system.addParticle(1.0)
    trap = openmm.CustomExternalForce("50*(x^2+y^2+z^2)")
    trap.addParticle(0)
    for force in (trap, openmm.PythonForce(field)):
        system.addForce(force)
    return context_of(system, [(0.0, 0.0, 0.0)], engine, scheme="S2_2", h=0.01, kelvin=0.0)


@pytest.mark.parametrize("engine", ["host", "device"])
def test_a_field_that_swings_may_give_energy(engine):
    """The amplitude at resonance, x = -a t sin(w t)/(2 w m), is that of the equation of motion."""
    context = driven(engine)
    context.getIntegrator().step(500)
    x, v = shown(context)[:, 0, 0]
    assert np.hypot(x, v / 10.0) == pytest.approx(20.0 * 5.0 / 20.0, rel=0.02)


def test_steps_far_too_long_stop(droplet):
    device = context_of(*droplet, "device", h=0.5, scheme="W2_5")
    before = shown(device)
    with pytest.raises(rb.NonFiniteError, match="The Context keeps the state before this call"):
        device.getIntegrator().step(2)
    np.testing.assert_allclose(shown(device), before, rtol=0.0, atol=1e-12)


def test_bodies_at_rest_may_come_to_turn_fast(droplet):
    both = pair(*droplet, scheme="W2_5", h=0.01, kelvin=0.0)
    one, other = (stepped(context, 30) for context in both)
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("thermostat", [False, pytest.param(True, marks=pytest.mark.validate)])
def test_minimised_and_hot_starts_are_no_false_alarm(thermostat, droplet):
    system, positions = droplet
    integrator = with_or_without_thermostat("device", 0.001, thermostat)
    context = openmm.Context(copy.deepcopy(system), integrator, REFERENCE)
    context.setPositions(positions)
    integrator.step(20)  # from rest on a lattice
    integrator.minimizeEnergy()
    context.setVelocitiesToTemperature(0.0)
    integrator.step(20)
    integrator.setVelocitiesToTemperature(3000.0, 1)
    integrator.step(10)
    context.setVelocitiesToTemperature(0.0)
    integrator.step(20)


def test_reading_the_energy_leaves_the_run_as_it_was(droplet):
    system, positions = droplet
    contexts = [
        openmm.Context(copy.deepcopy(system), with_or_without_thermostat(engine, 0.001, False), REFERENCE)
        for engine in ("host", "device")
    ]
    for context in contexts:
        context.setPositions(positions)  # at rest, so that any motion is looked at
        for _ in range(3):
            context.getIntegrator().step(7)
    np.testing.assert_allclose(*map(shown, contexts), rtol=0.0, atol=1e-12)


def liquid(*forces):
    """Return 27 molecules in a box, with more forces."""
    _, system, positions = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)
    for force in forces:
        system.addForce(force)
    return system, positions


def one_step_alone(device, host):
    """Make a step on the device, and the same step of the host without what OpenMM does behind it."""
    x, v = shown(device)
    host.setPeriodicBoxVectors(*device.getState().getPeriodicBoxVectors())
    host.setPositions(x)
    host.setVelocities(v)
    return stepped(device, 1), stepped(host, 1)


def box_of(context):
    return np.array(context.getState().getPeriodicBoxVectors()._value)


@pytest.mark.parametrize("scheme", ["S2_2", "Chin4A"])
def test_the_motion_of_the_centre_of_mass_is_removed(scheme):
    host, device = pair(*liquid(openmm.CMMotionRemover(2)), scheme=scheme)
    for context in (host, device):
        context.setVelocities(shown(context)[1] + [1.0, 2.0, 3.0])
    (x, v), (x1, v1) = stepped(host, 10), stepped(device, 10)
    system = device.getSystem()
    masses = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])
    assert np.abs(masses @ v1).max() < 1e-8
    # The host removes it behind steps 2, 4, ...; OpenMM counts from zero, so that the device does behind 1, 3, ...
    drift = (x1 - x).mean(axis=0)
    np.testing.assert_allclose(x1 - drift, x, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(v1, v, rtol=0.0, atol=1e-9)


def test_a_barostat_moves_whole_bodies():
    system, positions = liquid()
    host = context_of(system, positions, "host", scheme="S2_2")
    device = context_of(*liquid(seeded(openmm.MonteCarloBarostat(5000.0, 300.0, 2))), "device", scheme="S2_2")
    boxes = []
    for _ in range(16):
        (x1, v1), (x, v) = one_step_alone(device, host)
        bodies = (x1.reshape(-1, 3, 3), x.reshape(-1, 3, 3))
        shifts = (bodies[0] - bodies[1]).mean(axis=1, keepdims=True)
        np.testing.assert_allclose(bodies[0] - shifts, bodies[1], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(v1, v, rtol=0.0, atol=1e-10)
        boxes.append(box_of(device)[0, 0])
    assert len(set(boxes)) > 2


def test_a_call_that_fails_leaves_the_box_as_it_was():
    device = context_of(*liquid(seeded(openmm.MonteCarloBarostat(5000.0, 300.0, 1))), "device", scheme="V2", h=0.002)
    integrator = device.getIntegrator()
    integrator.step(2)
    box, before = box_of(device), shown(device)
    integrator.setStepSize(0.1)
    with pytest.raises(rb.NonFiniteError, match="The Context keeps the state before this call"):
        integrator.step(2)
    np.testing.assert_array_equal(box_of(device), box)
    np.testing.assert_allclose(shown(device), before, rtol=0.0, atol=1e-12)


def test_a_thermostat_pushes_whole_bodies():
    system, positions = liquid()
    host = context_of(system, positions, "host", scheme="S2_2")
    device = context_of(*liquid(seeded(openmm.AndersenThermostat(300.0, 200.0))), "device", scheme="S2_2")
    pushed = 0
    for _ in range(5):
        (x1, v1), (x, v) = one_step_alone(device, host)
        np.testing.assert_allclose(x1, x, rtol=0.0, atol=1e-12)
        bodies, state = device.getIntegrator().bodyState()
        np.testing.assert_allclose(v1, bodies.velocities(state, v1.copy()), rtol=0.0, atol=1e-12)
        same = np.abs(v1 - v).reshape(-1, 9).max(axis=1) < 1e-10
        pushed += np.count_nonzero(~same)
        assert same.any()
    assert pushed > 5


def test_checkpoints_and_states_continue(droplet):
    device = context_of(*droplet, "device")
    integrator = device.getIntegrator()
    integrator.step(3)
    checkpoint = device.createCheckpoint()
    state = device.getState(positions=True, velocities=True, parameters=True, integratorParameters=True)
    after = stepped(device, 5)
    device.loadCheckpoint(checkpoint)
    np.testing.assert_array_equal(stepped(device, 5), after)
    device.setState(state)
    np.testing.assert_array_equal(stepped(device, 5), after)


def test_refusals(droplet):
    system, positions = droplet
    with pytest.raises(ValueError, match="unknown engine 'gpu': choose one of host, device, auto"):
        rb.ExactRigidBodyIntegrator(0.001, engine="gpu")
    with pytest.raises(ValueError, match="exact rotor only"):
        rb.ExactRigidBodyIntegrator(0.001, rotor="mclachlan_reich", engine="device")
    for own in (Scheme("of_group_3", 2, spelled("A B3 A")), Scheme("own", 2, V2_WITH_HALTS)):
        with pytest.raises(ValueError, match=r"the substep (Kick\(group=3\)|Halt\(\)); use engine='host'"):
            rb.ExactRigidBodyIntegrator(0.001, own, engine="device")
        assert "substep" in rb.ExactRigidBodyIntegrator(0.001, own).engineNote()
    rotor = rb.rotors.Rotor("exact", 2, rb.ROTORS["mclachlan_reich"].factory, "")
    with pytest.raises(ValueError, match="exact rotor only, not your own rotor exact; use engine='host'"):
        rb.ExactRigidBodyIntegrator(0.001, rotor=rotor, engine="device")
    assert "rotor" in rb.ExactRigidBodyIntegrator(0.001, rotor=rotor).engineNote()
    cpu = openmm.Platform.getPlatform("CPU")
    with pytest.raises(ValueError, match="not CPU; use engine='host'"):
        context_of(system, positions, "device", platform=cpu)
    _, with_sites, places = rb.rigid_water(2, model="tip4pew")
    with pytest.raises(ValueError, match="virtual sites at the end of a step only"):
        context_of(with_sites, places, "device")


def in_groups(system, groups):
    """Return a copy of a System with the first force in the first of some groups, and one without effect in each."""
    system = copy.deepcopy(system)
    system.getForce(0).setForceGroup(groups[0])
    for group in groups:
        other = openmm.CustomExternalForce("0")
        other.setForceGroup(group)
        system.addForce(other)
    return system


def group_of_sums(context):
    """Return the force group of the sums, and those of the other forces."""
    groups = {force.getName(): force.getForceGroup() for force in context.getSystem().getForces()}
    (own,) = [group for name, group in groups.items() if name.startswith("openmm-exactrb")]
    return own, {group for name, group in groups.items() if not name.startswith("openmm-exactrb")}


@pytest.mark.parametrize(("taken", "free"), [([31, 30, 12], 29), (range(1, 32), 0)])
def test_a_force_group_that_is_free_is_found(taken, free, droplet):
    system, positions = droplet
    system = in_groups(system, list(taken))
    for force in system.getForces():
        if force.getForceGroup() == 0:
            force.setForceGroup(taken[0])
    host, device = pair(system, positions)
    np.testing.assert_allclose(stepped(device, 20), stepped(host, 20), rtol=0.0, atol=1e-12)
    own, others = group_of_sums(device)
    assert own == free
    assert own not in others
    gathered = device.getState(energy=True, groups={free})
    assert gathered.getPotentialEnergy()._value == 0.0
    checkpoint = device.createCheckpoint()
    after = stepped(device, 3)
    again = context_of(system, positions, "device")
    again.loadCheckpoint(checkpoint)
    np.testing.assert_array_equal(stepped(again, 3), after)


def test_a_system_without_a_free_force_group_is_refused(droplet):
    system, positions = droplet
    system = in_groups(system, list(range(32)))
    with pytest.raises(ValueError, match="has forces in all 32: give two of them the same one; use engine='host'"):
        context_of(system, positions, "device")


@pytest.mark.parametrize("name", ["v", "f", "dt", "f31"])
def test_parameters_with_names_of_openmms_own_are_refused(name, droplet):
    """OpenMM's devices take such a parameter for velocities, forces or the step."""
    system, positions = copy.deepcopy(droplet)
    force = openmm.CustomExternalForce(f"0*{name}*x")
    force.addGlobalParameter(name, 0.4)
    system.addForce(force)
    with pytest.raises(ValueError, match=f"the parameter '{name}' of a force has the name of a variable"):
        context_of(system, positions, "device")
    host = context_of(system, positions, "host")
    host.getIntegrator().step(1)


def test_forces_without_a_group_take_none(droplet):
    system, positions = droplet
    removed = copy.deepcopy(system)
    remover = openmm.CMMotionRemover()
    remover.setForceGroup(31)  # it has no forces
    removed.addForce(remover)
    device = context_of(removed, positions, "device")
    stepped(device, 1)
    assert group_of_sums(device)[0] == 31


def test_auto_is_the_host_where_there_is_no_device(droplet):
    host = context_of(*droplet, "host", scheme="S2_2")
    auto = context_of(*droplet, "auto", scheme="S2_2")
    integrator = auto.getIntegrator()
    assert integrator.getEngine() == "host"
    assert "Reference" in integrator.engineNote()
    np.testing.assert_array_equal(stepped(auto, 3), stepped(host, 3))
    assert auto.getSystem().getNumForces() == host.getSystem().getNumForces()
    other = rb.ExactRigidBodyIntegrator(0.001, rotor="mclachlan_reich", engine="auto")
    assert "rotor" in other.engineNote()
    assert context_of(*droplet, "device").getIntegrator().getEngine() == "device"
    assert context_of(*droplet, "host").getIntegrator().getEngine() == "host"


@pytest.mark.parametrize(
    "arguments",
    [
        (rb.ExactRigidBodyIntegrator, 0.001),
        (rb.ExactRigidBodyLangevinIntegrator, 300.0, 1.0, 0.001),
        (rb.ExactRigidBodyRescalingIntegrator, 300.0, 1.0, 0.001),
        (rb.ExactRigidBodyHybridIntegrator, 300.0, 1.0, 0.001),
    ],
)
def test_auto_is_the_default_and_costs_an_integrator_nothing(arguments):
    kind, *numbers = arguments
    xml = {}
    for engine in ("auto", "host"):
        integrator = kind(*numbers, engine=engine)
        xml[engine] = openmm.XmlSerializer.serialize(integrator)
    assert xml["auto"] == xml["host"] == openmm.XmlSerializer.serialize(kind(*numbers))
    assert kind(*numbers).getSettings()["arguments"]["engine"] == "auto"


def test_force_groups_are_respected(droplet):
    system, positions = droplet
    both = pair(system, positions)
    for context in both:
        context.getIntegrator().setIntegrationForceGroups({1, 2})
    x = shown(both[0])[0]
    np.testing.assert_allclose(*(stepped(context, 5) for context in both), rtol=0.0, atol=1e-13)
    assert np.abs(shown(both[1])[0] - x).max() > 0.0
    integrator = both[1].getIntegrator()
    integrator.setIntegrationForceGroups(0xFFFFFFFF)
    assert integrator.getIntegrationForceGroups() == -1
    integrator.bodyState()  # prepares the Context
    assert not openmm.CustomIntegrator.getIntegrationForceGroups(integrator) >> 31 & 1


def test_a_second_context_of_the_same_system(droplet):
    first = context_of(*droplet, "device", scheme="S2_2")
    system = first.getSystem()
    forces = system.getNumForces()
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine="device")
    second = openmm.Context(system, integrator, REFERENCE)
    second.setPositions(shown(first)[0])
    second.setVelocities(shown(first)[1])
    np.testing.assert_allclose(stepped(second, 3), stepped(first, 3), rtol=0.0, atol=1e-13)
    assert system.getNumForces() == forces
