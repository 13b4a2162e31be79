"""A friction of their own for molecules of more than one body."""

import copy

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import starts
from openmm_exactrb.openmm_access.molecules import in_flexible_molecules
from places import HOST_AND_NATIVE, platform_for

FRICTION, TURNING, FLEXIBLE, H = 2.0, 3.0, 7.0, 0.01


def molecules():
    """Return a System without forces and its positions: a chain of two atoms and a water, two more of water, an ion.

    The bond and the one to the water are of no strength.
    """
    _, water, positions = rb.rigid_water(3)
    x = [tuple(place) for place in positions._value]
    system = openmm.System()
    for i in range(9):
        system.addParticle(water.getParticleMass(i))
    for i in range(9):
        system.addConstraint(*water.getConstraintParameters(i))
    for place in ((1.0, 0.0, 0.0), (1.1, 0.0, 0.0), (0.0, 1.0, 0.0)):
        system.addParticle(12.0)
        x.append(place)
    bond = openmm.HarmonicBondForce()
    bond.addBond(9, 10, 0.1, 0.0)
    bond.addBond(10, 0, 0.1, 0.0)
    system.addForce(bond)
    return system, x


CHAIN = np.isin(np.arange(12), (0, 1, 2, 9, 10))


def started(engine, flexible=FLEXIBLE, kelvin=0.0, **options):
    system, x = molecules()
    integrator = rb.ExactRigidBodyLangevinIntegrator(
        kelvin, FRICTION, H, "BAOAB", rotationalFriction=TURNING, flexibleFriction=flexible, engine=engine, **options
    )
    integrator.setRandomNumberSeed(5)
    platform, properties = platform_for(engine)
    return starts.context_of(system, integrator, x, kelvin=300.0, seed=2, platform=platform, properties=properties)


def momenta(context):
    bodies, state = context.getIntegrator().bodyState()
    flexible = CHAIN[bodies.first_particle]
    return bodies, flexible, state.P, state.m


def norm(m):
    return np.linalg.norm(m, axis=0)


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
def test_momenta_fade_with_the_friction_of_their_molecule(engine):
    """Without noise, at 0 K; what is free turns with an angular momentum of the same norm."""
    context = started(engine)
    bodies, flexible, P, m = momenta(context)
    context.getIntegrator().step(4)
    _, _, P1, m1 = momenta(context)
    rates = np.where(flexible, FLEXIBLE, FRICTION)
    np.testing.assert_allclose(P1, P * np.exp(-rates * 4 * H), rtol=1e-12)
    rates = np.where(flexible, FLEXIBLE, TURNING)[: bodies.n_turning]
    np.testing.assert_allclose(norm(m1), norm(m) * np.exp(-rates * 4 * H), rtol=1e-12)


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
def test_it_can_be_changed_and_taken_back(engine):
    context = started(engine, None)
    integrator = context.getIntegrator()
    assert integrator.getFlexibleFriction()._value == FRICTION
    for coeff, expected in ((None, FRICTION), (FLEXIBLE, FLEXIBLE), (0.0, 0.0), (None, FRICTION)):
        integrator.setFlexibleFriction(coeff)
        _, flexible, P, _ = momenta(context)
        integrator.step(1)
        _, _, P1, _ = momenta(context)
        np.testing.assert_allclose(P1, P * np.exp(-np.where(flexible, expected, FRICTION) * H), rtol=1e-12)


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
def test_a_checkpoint_of_a_run_with_one_friction_is_continued_with_two(engine):
    one = started(engine, None)
    one.getIntegrator().step(1)
    two = started(engine)
    two.getIntegrator().step(1)
    two.loadCheckpoint(one.createCheckpoint())
    _, flexible, P, _ = momenta(two)
    two.getIntegrator().step(1)
    np.testing.assert_allclose(momenta(two)[2], P * np.exp(-np.where(flexible, FLEXIBLE, FRICTION) * H), rtol=1e-12)


def test_the_same_friction_given_twice_has_the_bits_of_one():
    runs = [started("host", flexible, kelvin=300.0) for flexible in (None, FRICTION)]
    for context in runs:
        context.getIntegrator().setRotationalFriction(None)
        context.getIntegrator().step(5)
    np.testing.assert_array_equal(*(momenta(context)[2] for context in runs))


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
def test_the_temperature_is_that_of_the_thermostat_in_both(engine):
    """Momenta drawn anew in each step, with hardly a friction or a huge one."""
    context = started(engine, 1e6, kelvin=300.0)
    integrator = context.getIntegrator()
    integrator.setFriction(1e-6)
    integrator.setRotationalFriction(1e-6)
    before = momenta(context)
    energies = []
    for _ in range(300):
        integrator.step(1)
        bodies, flexible, P, m = momenta(context)
        turning = flexible[: bodies.n_turning]
        moments = bodies.principal_moments[:, turning]
        squares = [(P[:, flexible] ** 2 / bodies.mass[flexible]).ravel(), (m[:, turning] ** 2 / moments).ravel()]
        energies.append(np.concatenate(squares))
    energies = np.array(energies) / (0.00831446261815324 * 300.0)
    error = (2.0 / energies.size) ** 0.5
    assert abs(energies.mean() - 1.0) < 4.0 * error
    assert energies.var() == pytest.approx(2.0, abs=4.0 * (56.0 / energies.size) ** 0.5)
    still = ~flexible
    np.testing.assert_allclose(P[:, still], before[2][:, still], atol=1e-2 * np.abs(before[2]).max())


@pytest.mark.opencl
def test_a_rigid_pair_of_atoms_is_one_body_on_every_engine():
    """Next to an atom that fast forces act on, the program of the native engine moves the atoms of pairs one by one."""
    system = openmm.System()
    for mass in (14.0, 14.0, 12.0, 12.0, 1.0):
        system.addParticle(mass)
    system.addConstraint(0, 1, 0.11)
    system.addConstraint(3, 4, 0.1)
    bond, outer = openmm.HarmonicBondForce(), openmm.CustomExternalForce("0*x")
    bond.addBond(2, 3, 0.15, 2e5)
    outer.addParticle(0)
    for force in (bond, outer):
        system.addForce(force)
    x = [(2.0, 0.0, 0.0), (2.11, 0.0, 0.0), (0.0, 0.0, 0.0), (0.15, 0.0, 0.0), (0.15, 0.1, 0.0)]
    slowed = []
    for engine in ("host", "native"):
        integrator = rb.ExactRigidBodyLangevinIntegrator(
            0.0, FRICTION, 0.004, "BAOAB", flexibleFriction=FLEXIBLE, engine=engine
        )
        platform, properties = platform_for(engine)
        context = starts.context_of(
            system, integrator, x, kelvin=300.0, seed=2, platform=platform, properties=properties
        )
        before = squared_velocity(context, (0, 1))
        integrator.step(5)
        assert integrator.timings.fast_evaluations > 0
        slowed.append(squared_velocity(context, (0, 1)) / before)
    np.testing.assert_allclose(slowed, np.exp(-2.0 * FRICTION * 0.02), rtol=1e-3)


def squared_velocity(context, particles):
    v = context.getState(velocities=True).getVelocities(asNumpy=True)._value
    return (v[list(particles)] ** 2).sum()


def test_bodies_named_by_hand_join_molecules():
    context = started("host")
    bodies = context.getIntegrator().bodyState()[0]
    np.testing.assert_array_equal(in_flexible_molecules(context, bodies, None), CHAIN[bodies.first_particle])
    joined = in_flexible_molecules(context, bodies, [[3, 11]])
    np.testing.assert_array_equal(joined, (CHAIN | np.isin(np.arange(12), (3, 4, 5, 11)))[bodies.first_particle])


def test_it_is_a_setting_like_others():
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, H, flexibleFriction=FLEXIBLE)
    assert copy.copy(integrator).getFlexibleFriction()._value == FLEXIBLE
    assert integrator.getSettings()["arguments"]["flexibleFriction"] == FLEXIBLE
    hybrid = rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, H, flexibleFriction=FLEXIBLE)
    assert copy.copy(hybrid).getFlexibleFriction()._value == FLEXIBLE
    with pytest.raises(ValueError, match="friction"):
        integrator.setFlexibleFriction(-1.0)


def test_heat_is_watched_for_as_long_as_the_smallest_friction_takes():
    assert rb.thermostats.Langevin(300.0, 2.0, flexibleFriction=0.5).relaxation == pytest.approx(2.0)
