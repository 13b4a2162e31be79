"""Nosé-Hoover chains: their flow against its equations of motion, what runs conserve and sample, and what persists."""

import numpy as np
import openmm
import pytest
from scipy import stats

import openmm_exactrb as rb
from chains import FREQUENCY, H, nose_hoover
from openmm_exactrb.context import variables
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.thermostats import NoseHooverChain
from orders import exponent
from starts import droplet_of
from thermostatted import (
    R,
    mean_and_error,
    molecules,
    simulation_of,
    snapshot,
)

# -- what a run conserves -----------------------------------------------------------------------------------------


def wander(h, time=0.64, **options):
    """Return how far the conserved energy of a droplet wanders that begins at twice the temperature (kJ/mol)."""
    integrator = nose_hoover(h, **options)
    simulation = droplet_of(integrator)
    integrator.setVelocitiesToTemperature(60.0, 1)
    begin, energy = integrator.effectiveEnergy()._value, integrator.totalEnergy()._value
    values = []
    for _ in range(16):
        simulation.integrator.step(round(time / 16 / h))
        values.append(integrator.effectiveEnergy()._value - begin)
    assert abs(integrator.totalEnergy()._value - energy) > 0.1  # the total energy is not conserved
    return np.sqrt(np.mean(np.square(values)))


@pytest.mark.parametrize(
    ("options", "order"),
    [
        ({}, 2),
        ({"together": True}, 2),
        ({"scheme": "BAOAB"}, 2),
        ({"scheme": "PEFRL"}, 4),
        ({"scheme": "PEFRL", "numYoshidaSuzuki": 1, "numMTS": 2, "frequency": 40.0}, 2),
        ({"scheme": "PEFRL", "numYoshidaSuzuki": 3, "numMTS": 2, "frequency": 40.0}, 4),
    ],
    ids=["S2_2", "together", "BAOAB", "PEFRL", "chain of order 2", "chain of order 4"],
)
def test_the_conserved_energy_has_the_smaller_order_of_scheme_and_chain(options, order):
    """Each of them keeps its part by itself, so that the splitting between them does not show."""
    steps = 0.008, 0.016 / 3, 0.004  # short enough for the order to show
    errors = [wander(h, **options) for h in steps]
    assert abs(exponent(steps, errors) - order) < 0.35
    assert errors[-1] < 2e-3


def flipped(integrator):
    """Turn momenta and chains around."""
    _, state = integrator.fullState()
    integrator.setBodyState(State(state.R, -state.P, state.q, -state.m))
    for name in integrator.getThermostat().own_numbers:
        if "velocity" in name:
            variables.put(integrator, name, -variables.get(integrator, name))


@pytest.mark.parametrize("options", [{"together": True}, {}, {"scheme": None}], ids=["together", "S2_2", "default"])
def test_a_run_retraces_its_steps_when_momenta_and_chains_are_turned_around(options):
    integrator = nose_hoover(**options)
    simulation = droplet_of(integrator)
    integrator.setVelocitiesToTemperature(60.0, 1)
    _, begin = integrator.bodyState()
    for _ in range(2):
        simulation.integrator.step(40)
        flipped(integrator)
    _, end = integrator.bodyState()
    for a, b in zip(begin, end, strict=True):
        np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-11 * np.abs(a).max())
    for name in integrator.getThermostat().own_numbers:
        assert abs(variables.get(integrator, name)) < 1e-9


def test_a_chain_that_is_hardly_coupled_gives_the_trajectory_of_constant_energy():
    runs = [droplet_of(i) for i in (nose_hoover(frequency=1e-12), rb.ExactRigidBodyIntegrator(H, scheme="S2_2"))]
    for run in runs:
        run.integrator.step(50)
    assert snapshot(runs[0]) == snapshot(runs[1])


def test_a_weak_coupling_leaves_that_trajectory_with_its_square():
    places = []
    for frequency in (1e-3, 2e-3, 1e-9):
        integrator = nose_hoover(frequency=frequency)
        simulation = droplet_of(integrator)
        integrator.setVelocitiesToTemperature(60.0, 1)
        simulation.integrator.step(100)
        places.append(integrator.bodyState()[1].R)
    near, far = (np.abs(x - places[2]).max() for x in places[:2])
    assert far / near == pytest.approx(4.0, rel=1e-2)


# -- what a run samples -------------------------------------------------------------------------------------------


def lopsided_droplet(integrator):
    """Return a Simulation of four dipoles in a trap that shares all energy out.

    In a harmonic one the centre of mass is an oscillator by itself, and in an isotropic one the angular momentum keeps
    its direction: chains alone do not make these canonical.
    """
    _, system, positions = rb.dipole_fluid(4, seed=1, trap=0.5)
    wall = openmm.CustomExternalForce("0.1*(x^4+2*y^4+0.5*z^4)+0.2*x*y*z+0.1*x^2*y")
    for i in range(system.getNumParticles()):
        if not system.isVirtualSite(i):
            wall.addParticle(i)
    system.addForce(wall)
    return simulation_of(integrator, system, positions)


@pytest.mark.parametrize("together", [True, pytest.param(False, marks=pytest.mark.validate)])
def test_translation_and_rotation_of_a_droplet_find_the_temperature(together):
    """From rotation at rest: with one chain for both, the forces between the dipoles share the energy out."""
    integrator = nose_hoover(0.02, together=together)
    simulation = lopsided_droplet(integrator)
    integrator.setVelocitiesToTemperature(60.0, 3)
    _, state = integrator.fullState()
    integrator.setBodyState(state._replace(m=0.0 * state.m))
    simulation.integrator.step(500)
    series = []
    for _ in range(600):
        simulation.integrator.step(5)
        series.append([T._value for T in integrator.temperatures()])
    for temperatures in np.transpose(series):
        mean, error = mean_and_error(temperatures)
        assert error < 2.5
        assert abs(mean - 30.0) < 4.0 * error


def canonical_energies(steps, every):
    """Return kinetic energies over kT of translation and rotation, with their degrees of freedom, from a droplet."""
    integrator = nose_hoover(0.02)
    simulation = lopsided_droplet(integrator)
    integrator.setVelocitiesToTemperature(30.0, 3)
    simulation.integrator.step(500)
    energies = []
    for _ in range(steps // every):
        simulation.integrator.step(every)
        energies.append([energy._value / (30.0 * R) for energy in integrator.kineticEnergies()])
    return np.transpose(energies), integrator.degreesOfFreedom()


def assert_canonical(energies, freedoms):
    """Compare with chi-square: a KS test and a fourth central moment, each with a false alarm in a thousand."""
    for energy, f in zip(energies, freedoms, strict=True):
        assert stats.kstest(energy, "gamma", args=(0.5 * f,)).pvalue > 1e-3
        for power in (2, 4):
            mean, error = mean_and_error((energy - 0.5 * f) ** power)
            exact = 0.5 * f if power == 2 else 0.75 * f * f + 3.0 * f
            assert abs(mean - exact) < stats.t.isf(5e-4, 19) * error


@pytest.mark.validate
def test_kinetic_energies_are_canonical():
    energies, freedoms = canonical_energies(120_000, 24)
    assert_canonical(energies, freedoms)
    assert abs(np.corrcoef(energies)[0, 1]) < 0.05


@pytest.mark.validate
@pytest.mark.parametrize("together", [True, False])
def test_each_momentum_of_a_droplet_is_canonical(together):
    """Those of the centres, and the angular ones in the frame of the body along each axis."""
    integrator = nose_hoover(0.02, together=together)
    simulation = lopsided_droplet(integrator)
    integrator.setVelocitiesToTemperature(30.0, 3)
    simulation.integrator.step(500)
    series = []
    for _ in range(6000):
        simulation.integrator.step(20)
        bodies, state = integrator.bodyState()
        turns = bodies.principal_moments > 0.0
        angular = state.m[turns] ** 2 / bodies.principal_moments[turns]
        series.append(np.append((state.P**2 / bodies.mass).ravel(), angular) / (30.0 * R))
    for values in np.transpose(series):
        mean, error = mean_and_error(values)
        assert error < 0.1
        assert abs(mean - 1.0) < stats.t.isf(1e-5, 19) * error


# -- settings ---------------------------------------------------------------------------------------------------------


def test_getters_and_setters_are_those_of_openmm():
    theirs, ours = openmm.NoseHooverIntegrator(310.0, 15.0, 0.002), nose_hoover(0.002, 300.0, 1.0)
    ours.setTemperature(310.0)
    ours.changeThermostat(collisionFrequency=theirs.getCollisionFrequency())
    assert ours.getTemperature() == theirs.getTemperature()
    assert ours.getThermostat() == NoseHooverChain(310.0, 15.0)


def test_chains_stay_when_the_temperature_is_changed():
    run = droplet_of(nose_hoover())
    run.integrator.step(20)
    names = run.integrator.getThermostat().own_numbers
    before = [variables.get(run.integrator, name) for name in names]
    run.integrator.setTemperature(60.0)
    run.integrator.step(0)
    assert [variables.get(run.integrator, name) for name in names] == before


def test_a_setting_that_is_refused_leaves_the_one_there_was():
    integrator = nose_hoover(temperature=300.0)
    for change in (integrator.setTemperature, lambda f: integrator.changeThermostat(collisionFrequency=f)):
        with pytest.raises(ValueError, match="above zero"):
            change(0.0)
    assert integrator.getThermostat() == NoseHooverChain(300.0, FREQUENCY)


def test_a_chain_that_is_too_stiff_for_the_step_gets_a_sentence():
    run = droplet_of(nose_hoover(frequency=1e5))
    run.integrator.setVelocitiesToTemperature(60.0, 1)
    before = snapshot(run)
    with pytest.raises(rb.IntegrationError, match=r"a Nosé-Hoover chain diverged .* than 100000/ps"):
        run.integrator.step(5)
    assert snapshot(run) == before


def test_momenta_of_zero_stay():
    integrator = nose_hoover(temperature=300.0)
    simulation = simulation_of(integrator, *molecules(waters=1, ions=1))
    simulation.integrator.step(50)
    assert integrator.temperatures()[0]._value == integrator.temperatures()[1]._value == 0.0
