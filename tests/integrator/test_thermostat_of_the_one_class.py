"""`ExactRigidBodyIntegrator(thermostat=...)` has the methods of its thermostat, and no others."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin, NoseHooverChain, StochasticRescaling
from starts import context_of, positions_of

H = 0.002
WATER = rb.rigid_water(8)[1:]
EVERY = {"getTemperature", "setTemperature", "changeThermostat", "temperaturesAroundThermostat", "effectiveEnergy"}
PROPOSALS = {"tally", "acceptanceRate", "resetTally"}
KINDS = {
    "none": (None, set(), lambda: rb.ExactRigidBodyIntegrator(H)),
    "Langevin": (Langevin(300.0, 2.0), EVERY | {"heat"}, lambda: rb.ExactRigidBodyLangevinIntegrator(300.0, 2.0, H)),
    "rescaling": (
        StochasticRescaling(300.0, 0.5),
        EVERY | {"heat"},
        lambda: rb.ExactRigidBodyRescalingIntegrator(300.0, 0.5, H),
    ),
    "chains": (NoseHooverChain(300.0, 20.0), EVERY, lambda: rb.ExactRigidBodyNoseHooverIntegrator(300.0, 20.0, H)),
    "hybrid": (
        HybridMonteCarlo(300.0, 2.0, stepsPerProposal=2),
        EVERY | {"heat"} | PROPOSALS,
        lambda: rb.ExactRigidBodyHybridIntegrator(300.0, 2.0, H, stepsPerProposal=2),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_class_has_the_methods_of_its_thermostat(kind):
    thermostat, methods, _ = KINDS[kind]
    integrator = rb.ExactRigidBodyIntegrator(H, thermostat=thermostat)
    names = EVERY | PROPOSALS | {"heat"}
    assert {name for name in names if hasattr(integrator, name)} == methods
    for name in names - methods:
        with pytest.raises(AttributeError, match=rf"{name}\(\)"):
            getattr(integrator, name)
    assert all(name in dir(integrator) and getattr(rb.ExactRigidBodyIntegrator, name).__doc__ for name in names)


@pytest.mark.parametrize("kind", KINDS)
def test_the_class_and_the_class_of_each_thermostat_move_alike(kind):
    thermostat, methods, make = KINDS[kind]
    ends = []
    for integrator in (rb.ExactRigidBodyIntegrator(H, thermostat=thermostat), make()):
        integrator.setRandomNumberSeed(4)
        context = context_of(*[WATER[0], integrator, WATER[1]], kelvin=300.0)
        if thermostat is not None:
            integrator.setTemperature(320.0)
        integrator.step(5)
        values = [getattr(integrator, name)()._value for name in sorted({"heat", "effectiveEnergy"} & methods)]
        ends.append((positions_of(context), values, integrator.forceEvaluationsPerStep))
        if thermostat is not None:
            assert integrator.getTemperature()._value == 320.0
            assert integrator.getThermostat().temperature == 320.0
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    assert ends[0][1:] == ends[1][1:]


def test_settings_of_the_thermostat_are_changed_by_name():
    integrator = rb.ExactRigidBodyIntegrator(H, thermostat=Langevin(300.0, 2.0))
    integrator.changeThermostat(friction=3.0, rotationalFriction=4.0)
    assert integrator.getThermostat() == Langevin(300.0, 3.0, 4.0)
    assert openmm.XmlSerializer.clone(integrator).getThermostat() == Langevin(300.0, 3.0, 4.0)
    with pytest.raises(ValueError, match="no setting frictions: choose from temperature, friction"):
        integrator.changeThermostat(frictions=1.0)
    with pytest.raises(ValueError, match="friction"):
        integrator.changeThermostat(friction=-1.0)
    assert integrator.getThermostat() == Langevin(300.0, 3.0, 4.0)
