"""Barostats of OpenMM beside our integrators."""

import warnings

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from chains import nose_hoover
from four_barostats import barostats
from peptides import in_box
from places import HOST_AND_NATIVE
from starts import context_of, positions_of
from thermostatted import (
    KT,
    boxes_and_momenta,
    ending_at_kicks,
    ideal_gas,
    mean_and_error,
    molecules,
    simulation_of,
)

BAR = 0.06022140857  # kJ/mol/nm³


def test_a_box_that_changes_leaves_momenta_to_the_forces():
    """A constant force: within one call of many steps, with as many moves of the barostat, P grows by F t."""
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme="V2")
    context = ideal_gas(integrator, 10.0, force=50.0, waters=10, ions=5)
    volume = context.getState().getPeriodicBoxVolume()
    bodies, before = integrator.bodyState()
    integrator.step(100)
    _, after = integrator.bodyState()
    assert context.getState().getPeriodicBoxVolume() != volume
    forces = np.where(np.arange(15) < 10, 150.0, 50.0)
    np.testing.assert_allclose(after.P[0] - before.P[0], forces * 0.2, rtol=1e-11)
    np.testing.assert_allclose(after.P[1:], before.P[1:], rtol=1e-12)
    assert len(bodies) == 15


def test_one_call_is_as_many_calls_with_a_barostat_too():
    """Not so with hybrid Monte Carlo: a kinetic energy that OpenMM's Reference and CPU platforms are asked for takes
    random numbers out of the row that the barostat draws from.
    """
    snapshots = []
    for calls in (1, 20):
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 2.0, 0.004)
        integrator.setRandomNumberSeed(3)
        context = ideal_gas(integrator, 10.0, force=50.0, waters=10, ions=5)
        for _ in range(calls):
            integrator.step(20 // calls)
        state = context.getState(positions=True, velocities=True)
        snapshots.append((state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value))
    for a, b in zip(*snapshots, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("engine", ["host", "native"])
def test_frozen_particles_stay_where_the_barostat_moves_them(engine):
    """At the same fraction of the edges of the box."""
    integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", engine=engine)
    context = ideal_gas(integrator, 10.0, ions=6)
    x = positions_of(context)
    x[0] = 1.5, 3.0, 4.5
    context.setPositions(x)
    context.getSystem().setParticleMass(0, 0.0)
    context.reinitialize(preserveState=True)
    integrator.step(20)
    edge = context.getState().getPeriodicBoxVectors()[0][0]._value
    assert edge != 6.0
    np.testing.assert_allclose(positions_of(context)[0] / edge, [0.25, 0.5, 0.75], rtol=1e-12)


@pytest.mark.parametrize(
    ("integrator", "before"),
    [(rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.01), 500), (nose_hoover(0.01, 300.0), 1500)],
    ids=["Langevin", "Nosé-Hoover"],
)
def test_an_ideal_gas_has_the_volume_of_its_law(integrator, before):
    """<V> = (N + 1) kT / P, at the temperature of the thermostat."""
    n, pressure = 20, 20.0
    integrator.setRandomNumberSeed(1)  # on OpenMM's Reference platform the barostat draws from the integrator's numbers
    context = ideal_gas(integrator, pressure, waters=10, ions=10)
    integrator.step(before)
    volumes, temperatures = [], []
    for _ in range(200):
        integrator.step(5)
        volumes.append(context.getState().getPeriodicBoxVolume()._value)
        temperatures.append([T._value for T in integrator.temperatures()])
    mean, error = mean_and_error(volumes)
    exact = (n + 1) * KT / (pressure * BAR)
    assert error < 0.1 * exact
    assert abs(mean - exact) < 4.0 * error
    for T in np.transpose(temperatures):
        mean, error = mean_and_error(T)
        assert abs(mean - 300.0) < max(4.0 * error, 3.0)
    integrator.setTemperature(310.0)
    with pytest.raises(ValueError, match="Barostat is 300 K, but that of the integrator is 310 K"):
        integrator.step(1)


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
@pytest.mark.parametrize("flexible", [False, True])
def test_a_barostat_acts_where_the_next_kick_does(flexible, engine):
    """W2_3m ends its steps before: its boxes are those of the same steps from kick to kick, and bodies come back."""
    if flexible:
        _, system, positions = in_box()
        held_to = context_of(system, openmm.VerletIntegrator(0.001), positions)
        held_to.applyConstraints(1e-9)
        positions, options = positions_of(held_to), {"fast": "bonded", "steps": 6}
    else:
        _, system, positions = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)
        options = {}
    runs = [boxes_and_momenta(system, positions, scheme, engine, **options) for scheme in ("W2_3m", ending_at_kicks())]
    (volumes, P), (others, other_P) = runs
    assert len(set(volumes)) >= 3
    np.testing.assert_allclose(volumes, others, rtol=1e-12)
    np.testing.assert_allclose(P, other_P, atol=1e-8 * np.abs(P).max())


def test_a_trial_that_fails_leaves_the_box_and_the_state():
    _, system, positions = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)

    def force(state):
        if state.getPeriodicBoxVolume()._value != before:
            raise RuntimeError("no force in another box")
        return 0.0, np.zeros((system.getNumParticles(), 3))

    own = openmm.PythonForce(force)
    own.setUsesPeriodicBoundaryConditions(True)
    system.addForce(own)
    system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, 3))
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.006, "W2_3m")
    context = context_of(system, integrator, positions)
    before = context.getState().getPeriodicBoxVolume()._value
    integrator.step(2)
    x = positions_of(context)
    with pytest.raises(openmm.OpenMMException, match="no force in another box"):
        integrator.step(1)
    state = context.getState()
    assert (state.getPeriodicBoxVolume()._value, state.getStepCount()) == (before, 2)
    np.testing.assert_allclose(positions_of(context), x, atol=1e-15)


def density(model, integrator, picoseconds, seed):
    """Return the density of 216 waters at 298.15 K and 1 bar in kg/m³, and its error from blocks of 10 ps."""
    _, system, positions = rb.rigid_water(216, model=model, nonbondedMethod=app.PME, nonbondedCutoff=0.85)
    h = integrator.getStepSize()._value
    system.addForce(openmm.MonteCarloBarostat(1.0, 298.15, max(1, round(0.02 / h))))
    integrator.setRandomNumberSeed(seed)
    context = context_of(system, integrator, positions, platform=openmm.Platform.getPlatform("CPU"))
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    context.setVelocitiesToTemperature(298.15, seed)
    integrator.step(round(20.0 / h))
    densities = []
    for _ in range(round(picoseconds / 0.1)):
        integrator.step(round(0.1 / h))
        densities.append(216 * 18.01528 * 1.66053906892 / context.getState().getPeriodicBoxVolume()._value)
    blocks = np.reshape(densities, (-1, 100)).mean(axis=1)
    return blocks.mean(), blocks.std(ddof=1) / np.sqrt(len(blocks))


@pytest.mark.validate
@pytest.mark.parametrize("model", ["tip3p", "tip4pew"])
def test_water_has_the_density_that_openmm_finds_at_one_femtosecond(model):
    """Ours at a force every 4 fs, where W2_3 would be 0.6 % off."""
    theirs, their_width = density(model, openmm.LangevinMiddleIntegrator(298.15, 5.0, 0.001), 1000.0, 1)
    ours, our_width = density(model, rb.ExactRigidBodyLangevinIntegrator(298.15, 5.0, 0.012), 1000.0, 1)
    width = np.hypot(their_width, our_width)
    assert width < 1.5
    assert abs(ours - theirs) < 0.002 * theirs + width


@pytest.mark.parametrize("name", (BAROSTATS := barostats(310)))
def test_a_barostat_must_have_the_same_temperature(name):
    barostat = BAROSTATS[name](25)
    system, places = molecules(waters=2)
    places[3:] += 0.5
    periodic = openmm.NonbondedForce()
    periodic.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
    for _ in range(6):
        periodic.addParticle(0.0, 0.1, 0.0)
    system.addForce(periodic)
    system.addForce(barostat)
    simulation = simulation_of(rb.ExactRigidBodyLangevinIntegrator(300.0, 2.0, 0.002), system, places)
    with pytest.raises(ValueError, match=r"Barostat is 310 K, but that of the integrator is 300 K: .*setParameter"):
        simulation.integrator.step(1)
    simulation.integrator.setTemperature(310.0)
    simulation.integrator.step(1)
    simulation.integrator.setTemperature(320.0)
    simulation.context.setParameter(barostat.Temperature(), 320.0)
    simulation.integrator.step(1)


@pytest.mark.parametrize(
    ("scheme", "frequency", "message"),
    [
        ("BAOA", 25, None),
        ("W2_3m", 8, None),
        ("W2_3m", 25, "every 25 steps, which are 300 fs, .* one every 4 fs: .* frequency to 8"),
        ("W2_3m", 100, None),
        ("S2_2", 25, None),
        ("W2_3m", 0, None),
    ],
)
def test_a_barostat_with_an_interval_for_single_evaluations_is_named(scheme, frequency, message):
    _, system, positions = rb.rigid_water(64, nonbondedMethod=openmm.app.PME, nonbondedCutoff=0.5)
    system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, frequency))
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, scheme=scheme, forceInterval=0.004)
    _context = context_of(system, integrator, positions)
    if message:
        with pytest.warns(UserWarning, match=message):
            integrator.step(1)
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            integrator.step(1)
