"""Friction and noise on the device: the flow itself against numpy, and what is sampled against exact distributions."""

import copy

import numpy as np
import openmm
import pytest
from devices import REFERENCE, all_kinds, gpu_platform, shown, stepped

import openmm_exactrb as rb
from openmm_exactrb.engines.custom_program.noise import GENERATORS, draws, streams
from openmm_exactrb.engines.custom_program.rows import Table

KT = 0.00831446261815324 * 300.0


def langevin(
    system, positions, friction=5.0, *, h=0.001, platform=REFERENCE, precision=None, engine="device", **options
):
    """Return a Context with Langevin dynamics at 300 K and a seed."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, friction, h, engine=engine, **options)
    integrator.setRandomNumberSeed(7)
    properties = {"Precision": precision} if precision else {}
    context = openmm.Context(copy.deepcopy(system), integrator, platform, properties)
    context.setPositions(positions)
    return context


def free_water(n):
    """Return rigid molecules without forces, and their positions."""
    _, water, positions = rb.rigid_water(n)
    system = openmm.System()
    for i in range(water.getNumParticles()):
        system.addParticle(water.getParticleMass(i))
    for i in range(water.getNumConstraints()):
        system.addConstraint(*water.getConstraintParameters(i))
    return system, positions


def gaussians(begin):
    """Return two arrays of normal numbers of the generators, in whole numbers of numpy, and where they are then."""
    state, uniforms = begin.astype(np.int64), []
    for _ in range(2):
        state = np.array([multiplier * r % modulus for r, (multiplier, modulus) in zip(state, GENERATORS, strict=True)])
        parts = [r / modulus for r, (_, modulus) in zip(state, GENERATORS, strict=True)]
        uniforms.append(sum(parts) % 1.0)
    radius, angle = np.sqrt(-2.0 * np.log(1.0 - uniforms[0])), 2.0 * np.pi * uniforms[1]
    return radius * np.cos(angle), radius * np.sin(angle), state


def test_the_flow_is_that_of_ornstein_and_uhlenbeck():
    system, positions = free_water(3)
    h, friction, turning = 0.02, 7.0, 3.0
    context = langevin(system, positions, friction, h=h, rotationalFriction=turning, scheme="BAOAB")
    integrator = context.getIntegrator()
    bodies, before = integrator.bodyState()
    assert not before.P.any()
    assert not before.m.any()
    integrator.step(1)
    first = integrator.bodyState()[1]
    integrator.step(1)
    second = integrator.bodyState()[1]
    fade, spread = np.exp(-friction * h), np.sqrt(KT * bodies.mass[:, None] * (1.0 - np.exp(-2.0 * friction * h)))
    # Each of the rows B A, O A, B of a step draws, whether a thermostat is in it or not.
    draws, state = [], streams(3, 7)
    for _ in range(6):
        *draw, state = gaussians(state)
        draws.append(draw)
    one, other = draws[1]
    np.testing.assert_allclose(first.P.T, spread * one, rtol=1e-11)
    # The free rotation behind the noise keeps the norm of the angular momentum.
    width = np.sqrt(KT * bodies.principal_moments.T * (1.0 - np.exp(-2.0 * turning * h)))
    np.testing.assert_allclose(np.linalg.norm(first.m, axis=0), np.linalg.norm(width * other, axis=1), rtol=1e-11)
    np.testing.assert_allclose(second.P.T, fade * first.P.T + spread * draws[4][0], rtol=1e-11)


def test_the_generators_are_those_of_wichmann_and_hill():
    # Periods are those of primitive roots: the product of their orders over the common factors is 2^121.
    for multiplier, modulus in GENERATORS:
        order = modulus - 1
        primes = [p for p in range(2, 50000) if order % p == 0 and all(p % k for k in range(2, int(p**0.5) + 1))]
        rest = order
        for p in primes:
            while rest % p == 0:
                rest //= p
        primes += [rest] if rest > 1 else []
        assert all(pow(multiplier, order // p, modulus) != 1 for p in primes)


@pytest.mark.parametrize("scheme", ["S2_2", pytest.param("Chin4A", marks=pytest.mark.validate)])
def test_without_friction_it_is_the_dynamics_without_a_thermostat(scheme):
    _, system, positions = rb.rigid_water(3)
    plain = openmm.Context(
        copy.deepcopy(system), rb.ExactRigidBodyIntegrator(0.001, scheme, engine="device"), REFERENCE
    )
    plain.setPositions(positions)
    frictionless = langevin(system, positions, 0.0, scheme=scheme)
    np.testing.assert_array_equal(stepped(frictionless, 5), stepped(plain, 5))


def test_all_replicas_get_the_same_noise_and_axes_that_are_none_get_none():
    system, positions, named = all_kinds()
    context = langevin(system, positions, 20.0, bodies=named)
    integrator = context.getIntegrator()
    integrator.step(3)
    bodies, state = integrator.bodyState()
    for name in ("P", "L", "r1"):
        values = np.array(integrator.getPerDofVariableByName(name), dtype=float)
        for kind in bodies.kinds:
            for particles in kind.particles:
                np.testing.assert_array_equal(values[particles], values[particles[:1]].repeat(len(particles), axis=0))
    moments = bodies.principal_moments
    assert (moments == 0.0).any()
    assert not state.m[moments == 0.0].any()
    assert state.m[moments > 0.0].all()
    assert state.P.all()


def test_seed_and_calls():
    _, system, positions = rb.rigid_water(2)
    one, other, third = (langevin(system, positions) for _ in range(3))
    third.getIntegrator().setRandomNumberSeed(8)
    x = stepped(one, 6)
    stepped(other, 2)
    np.testing.assert_array_equal(stepped(other, 4), x)
    assert np.abs(stepped(third, 6) - x).max() > 1e-6
    checkpoint = one.createCheckpoint()
    x = stepped(one, 3)
    one.loadCheckpoint(checkpoint)
    np.testing.assert_array_equal(stepped(one, 3), x)


@pytest.mark.parametrize("preserve", [True, False])
def test_noise_continues_or_restarts_in_a_recreated_context(preserve):
    system, positions = free_water(2)
    context, twin = (langevin(system, positions, 1e3) for _ in range(2))
    context.getIntegrator().step(2)
    context.reinitialize(preserveState=preserve)
    if not preserve:
        context.setPositions(positions)
    twin.getIntegrator().step(2 * preserve)
    momenta = []
    for each in (context, twin):
        each.getIntegrator().step(2)
        momenta.append(each.getIntegrator().bodyState()[1].P)
    np.testing.assert_allclose(*momenta, rtol=1e-9)
    assert np.abs(momenta[0]).min() > 0.0


def hot(context):
    """Give bodies momenta so large that a drift is made of several rotations."""
    context.getIntegrator().setVelocitiesToTemperature(5000.0, 3)
    return context


def test_noise_does_not_depend_on_calls_and_rotations():
    system, positions = free_water(3)
    contexts = [hot(langevin(system, positions, 5.0, h=0.05, scheme="BAOAB")) for _ in range(2)]
    turns = []
    for context, calls in zip(contexts, ([8], [1] * 8), strict=True):
        integrator = context.getIntegrator()
        for n in calls:
            integrator.step(n)
            turns.append(integrator.getGlobalVariableByName("exactrb_turns"))
    assert len(set(turns)) > 1
    np.testing.assert_allclose(*(context.getIntegrator().bodyState()[1].P for context in contexts), rtol=1e-9)


def test_noise_is_put_back_for_steps_that_are_made_again():
    """Bodies at rest get momenta at once for which a drift needs more rotations than were expected."""
    system, positions = free_water(3)
    context = langevin(system, positions, 1e5, h=0.05, scheme="BAOAB")
    integrator = context.getIntegrator()
    integrator.step(1)
    assert integrator.getGlobalVariableByName("exactrb_turns") > 1.0
    bodies, after = integrator.bodyState()
    *_, state = gaussians(streams(3, 7))
    normal, *_ = gaussians(state)
    np.testing.assert_allclose(after.P.T, np.sqrt(KT * bodies.mass[:, None]) * normal, rtol=1e-11)


@pytest.mark.parametrize("engine", ["host", "device"])
def test_a_seed_that_is_set_again_brings_its_noise_back(engine):
    system, positions = free_water(2)
    context = langevin(system, positions, 1e5, engine=engine)  # a step forgets the momenta before it
    integrator = context.getIntegrator()
    integrator.step(1)
    momenta = []
    for _ in range(2):
        context.setStepCount(1)
        integrator.setRandomNumberSeed(7)
        integrator.step(2)
        momenta.append(integrator.bodyState()[1].P)
    np.testing.assert_allclose(*momenta, rtol=1e-12)


def test_generators_jump_ahead_as_they_go():
    seed, n = 11, 5
    state = streams(2, seed)
    for _ in range(n):
        *_, state = gaussians(state)
    np.testing.assert_array_equal(streams(2, seed, 2 * n), state)


def test_virtual_sites_draw_once_more():
    """What the number of draws in a step says is what the generators do."""
    for sites in (False, True):
        table = Table.of(rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, "BAOAB")._steps())  # noqa: SLF001
        assert draws(table, sites) == 2 * (3 + sites)


def test_noise_is_not_that_of_a_checkpoint_from_before_the_first_step():
    system, positions = free_water(2)
    context = langevin(system, positions, 1e3)
    integrator = context.getIntegrator()
    checkpoint = context.createCheckpoint()
    integrator.step(0)
    context.loadCheckpoint(checkpoint)
    integrator.step(1)
    assert np.abs(integrator.bodyState()[1].P).min() > 0.0


def test_temperature_and_friction_are_taken_up():
    _, system, positions = rb.rigid_water(2)
    context = langevin(system, positions, 1e4)  # every step draws new momenta
    integrator = context.getIntegrator()
    integrator.step(1)
    assert integrator.temperatures()[0]._value > 10.0
    integrator.setTemperature(0.0)
    integrator.step(1)
    assert integrator.temperatures()[0]._value < 1.0
    integrator.setFriction(0.0)
    before = integrator.bodyState()[1].P
    integrator.step(1)
    assert np.abs(integrator.bodyState()[1].P - before).max() > 0.0
    assert not np.isnan(shown(context)).any()


def test_a_temperature_that_is_set_in_plain_openmm():
    _, system, positions = rb.rigid_water(2)
    context = langevin(system, positions, 1e4)
    integrator = context.getIntegrator()
    integrator.step(1)
    integrator.setGlobalVariableByName("exactrb_kT", 0.0)
    integrator.setGlobalVariableByName("exactrb_changed", 1.0)
    openmm.CustomIntegrator.step(integrator, 1)
    # The thermostat is the last substep of a step: nothing moves behind it.
    assert np.abs(shown(context)[1]).max() < 1e-3 * np.sqrt(KT)


def test_refusals():
    with pytest.raises(ValueError, match="Langevin thermostat only, not StochasticRescaling; use engine='host'"):
        rb.ExactRigidBodyRescalingIntegrator(300.0, 1.0, 0.001, engine="device")
    with pytest.raises(ValueError, match="Langevin thermostat only, not HybridMonteCarlo; use engine='host'"):
        rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, 0.001, engine="device")
    _, system, positions = rb.rigid_water(2)
    context = langevin(system, positions)
    context.getIntegrator().step(1)
    with pytest.raises(ValueError, match="momenta within a step are not available"):
        context.getIntegrator().temperaturesAroundThermostat()


def test_copies_keep_the_engine():
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, engine="device")
    assert copy.copy(integrator).getEngine() == "device"


@pytest.mark.opencl
@pytest.mark.parametrize("scheme", [pytest.param("W2_3m", marks=pytest.mark.validate), "BAOAB"])
def test_molecules_in_a_trap_and_a_field_have_their_exact_distributions(scheme):
    system, positions = free_water(125)
    force = openmm.CustomExternalForce("0.5*strength*mass*(x*x+y*y+z*z)-charge*z")
    force.addGlobalParameter("strength", 400.0)
    for name in ("mass", "charge"):
        force.addPerParticleParameter(name)
    for i in range(system.getNumParticles()):
        force.addParticle(i, [system.getParticleMass(i)._value, (-2.0, 1.0, 1.0)[i % 3] * 50.0])
    system.addForce(force)
    context = langevin(system, positions, 8.0, h=0.005, platform=gpu_platform(), precision="mixed", scheme=scheme)
    integrator = context.getIntegrator()
    integrator.step(200)
    places, along = [], []
    for _ in range(20):
        integrator.step(40)
        x = shown(context)[0].reshape(-1, 3, 3)
        arms = x[:, 1] + x[:, 2] - 2.0 * x[:, 0]
        places.append(integrator.bodyState()[1].R)
        along.append(arms[:, 2])
    bodies = integrator.bodyState()[0]
    squares = np.array(places) ** 2 * 400.0 * bodies.mass / KT
    # Samples 0.2 ps apart: the trap forgets within 0.1 ps, dipoles within 0.2 ps.
    assert squares.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / squares.size * 2.0))
    arm = np.linalg.norm(arms, axis=1).mean()
    a = 50.0 * arm / KT
    cosines = np.array(along) / arm
    variance = 1.0 - 2.0 / a / np.tanh(a) + 2.0 / a**2 - (1.0 / np.tanh(a) - 1.0 / a) ** 2
    assert cosines.mean() == pytest.approx(1.0 / np.tanh(a) - 1.0 / a, abs=4.0 * np.sqrt(3.0 * variance / cosines.size))
