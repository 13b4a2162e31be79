"""What a user sets, asks for and gets told."""

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.context.updates import ContextUpdates, acting_updates
from openmm_exactrb.schemes import Scheme, spelled
from starts import droplet_of
from thermostatted import R, molecules, simulation_of, snapshot

RATE = unit.picosecond**-1


def langevin(*arguments, **options):
    return rb.ExactRigidBodyLangevinIntegrator(*(arguments or (300.0, 2.0, 0.002)), **options)


def test_getters_and_setters_are_those_of_openmm():
    ours, theirs = langevin(), openmm.LangevinMiddleIntegrator(300.0, 2.0, 0.002)
    for integrator in (ours, theirs):
        integrator.setTemperature(310.0 * unit.kelvin)
        integrator.setFriction(0.5)
        integrator.setRandomNumberSeed(8)
    for name in ("Temperature", "Friction", "StepSize", "RandomNumberSeed"):
        a, b = getattr(ours, f"get{name}")(), getattr(theirs, f"get{name}")()
        assert a == b
    assert ours.getFriction().unit == theirs.getFriction().unit


def test_friction_of_rotation_follows_that_of_translation_unless_it_has_its_own():
    integrator = langevin(300.0, 2.0 / unit.nanosecond, 2.0 * unit.femtosecond)
    assert integrator.getRotationalFriction() / RATE == pytest.approx(0.002)
    integrator.setFriction(3.0)
    assert integrator.getRotationalFriction() == 3.0 * RATE
    integrator.setRotationalFriction(5.0)
    integrator.setFriction(1.0)
    assert integrator.getRotationalFriction() == 5.0 * RATE
    integrator.setRotationalFriction(None)
    assert integrator.getRotationalFriction() == 1.0 * RATE


def test_a_temperature_that_is_refused_leaves_the_one_there_was():
    hybrid = rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, 0.002)
    with pytest.raises(ValueError, match="the temperature of the Metropolis test must be a positive number"):
        hybrid.setTemperature(0.0)
    for integrator in (hybrid, langevin()):
        with pytest.raises(ValueError, match="a temperature must"):
            integrator.setTemperature(-1.0)
        assert integrator.getTemperature() == 300.0 * unit.kelvin


def test_a_thermostat_that_joined_the_system_later_does_nothing_and_is_not_refused():
    """OpenMM does not know them either, until the Context is reinitialised."""
    simulation = droplet_of(langevin(30.0, 1.0, 0.002))
    hotter = openmm.AndersenThermostat(300.0, 1.0)
    simulation.system.addForce(hotter)
    simulation.integrator.step(1)
    assert acting_updates(simulation.context) == []
    assert not ContextUpdates(simulation.context, []).pushes


def test_the_temperature_of_a_thermostat_is_the_one_that_the_context_has():
    simulation = droplet_of(rb.ExactRigidBodyIntegrator(0.002))
    simulation.system.addForce(openmm.AndersenThermostat(30.0, 1.0))
    simulation.context.reinitialize(preserveState=True)
    found = ContextUpdates(simulation.context, [])
    assert found.hottest(simulation.context) == pytest.approx(30.0 * R, rel=1e-12)
    simulation.context.setParameter(openmm.AndersenThermostat.Temperature(), 310.0)
    assert found.hottest(simulation.context) == pytest.approx(310.0 * R, rel=1e-12)


def test_a_heat_exchange_without_a_thermostat_is_refused():
    """And leaves the state as it was."""
    own = Scheme("mine", 2, spelled("B A O A B"))
    simulation = droplet_of(rb.ExactRigidBodyIntegrator(0.01, scheme=own))
    before = snapshot(simulation)
    with pytest.raises(ValueError, match="mine contains a thermostat, but the integrator has none"):
        simulation.integrator.step(1)
    assert snapshot(simulation) == before
    with pytest.raises(ValueError, match="BAOAB contains a thermostat"):
        rb.ExactRigidBodyIntegrator(0.01, scheme="BAOAB")


def test_a_cold_start_may_be_heated_by_any_friction():
    """Nor is a single body that gains most of its energy in a step taken for a blow-up."""
    system, places = molecules(waters=1)
    for friction in (5.0, 1e3):
        simulation = simulation_of(langevin(300.0, friction, 0.002), system, places)
        simulation.integrator.setRandomNumberSeed(1)
        simulation.step(400)


def test_temperatures_around_the_thermostat_need_a_step():
    simulation = droplet_of(langevin(30.0, 1.0, 0.01, scheme="BAOAB"))
    with pytest.raises(ValueError, match=r"call step\(\) first"):
        simulation.integrator.temperaturesAroundThermostat()
    simulation.step(1)
    assert all(0.0 < T._value < 100.0 for T in simulation.integrator.temperaturesAroundThermostat())
    checkpoint = simulation.context.createCheckpoint()
    simulation.step(2)
    simulation.context.loadCheckpoint(checkpoint)
    with pytest.raises(ValueError, match=r"call step\(\) first"):
        simulation.integrator.temperaturesAroundThermostat()
    simulation.step(1)
    simulation.integrator.setVelocitiesToTemperature(3000.0, 1)
    with pytest.raises(ValueError, match=r"call step\(\) first"):
        simulation.integrator.temperaturesAroundThermostat()
    simulation.integrator.step(0)
    with pytest.raises(ValueError, match=r"call step\(\) first"):
        simulation.integrator.temperaturesAroundThermostat()


def test_reporters_and_velocities_tell_the_temperature_of_the_step_s_end(tmp_path):
    system, places = molecules(waters=3, ions=2)
    simulation = simulation_of(langevin(), system, places)
    simulation.reporters.append(app.StateDataReporter(str(tmp_path / "log"), 5, temperature=True, kineticEnergy=True))
    simulation.step(5)
    temperature, kinetic = np.loadtxt(tmp_path / "log", delimiter=",", skiprows=1)[::-1]
    integrator = simulation.integrator
    energies, freedom = integrator.kineticEnergies(), sum(integrator.degreesOfFreedom())
    assert freedom == 3 * 6 + 2 * 3
    assert kinetic == pytest.approx(sum(e._value for e in energies), rel=1e-12)
    assert temperature == pytest.approx(2.0 * kinetic / (freedom * R), rel=1e-12)
    assert simulation.context.getState(energy=True).getKineticEnergy()._value == pytest.approx(kinetic, rel=1e-12)


def test_tuning_advises_a_scheme_for_constant_energy():
    simulation = droplet_of(langevin(30.0, 1.0, 0.01))
    simulation.step(20)
    result = rb.tune(simulation, target=0.1, schemes=["V2", "S2_2"], duration=0.5, horizon=1.0, levels=4)
    assert type(result.best().integrator()) is rb.ExactRigidBodyIntegrator


def test_a_job_knows_all_settings_of_an_integrator():
    def key(**changes):
        arguments = {"temperature": 300.0, "frictionCoeff": 1.0, "stepSize": 0.002} | changes
        return rb.ensemble.Job(describe, integrator=rb.ExactRigidBodyLangevinIntegrator(**arguments)).key

    others = [{"temperature": 310.0}, {"frictionCoeff": 2.0}, {"scheme": "BAOAB"}, {"rotationalFriction": 3.0}]
    assert len({key(), *(key(**other) for other in others)}) == 5
    assert key() == key(rotor="exact")


def describe(integrator):
    return integrator.getScheme().name
