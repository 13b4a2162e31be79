"""The temperature that OpenMM's reporters ask for with the native engine, and the energy balance of its thermostats."""

import pytest

import openmm_exactrb as rb
from both_engines import maker, pair
from peptides import in_water
from zoo import every_kind, water

pytestmark = [pytest.mark.library, pytest.mark.opencl]


def test_the_temperature_of_the_system_is_that_of_the_host():
    system, positions, bodies = every_kind()
    contexts = pair(system, positions, maker("S2_2", 0.002, bodies=bodies))
    found = []
    for context in contexts:
        context.getIntegrator().step(5)
        found.append(context.getIntegrator().computeSystemTemperature()._value)
    assert found[1] == pytest.approx(found[0], rel=1e-9)


@pytest.mark.parametrize("scheme", ["BAOA", "S2_2"])
def test_the_balance_of_rescaling_is_that_of_the_host(scheme):
    def make(engine):
        integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, 0.002, scheme, engine=engine)
        integrator.setRandomNumberSeed(11)
        return integrator

    contexts = pair(*water(), make)
    host, device = (context.getIntegrator() for context in contexts)
    for integrator in (host, device):
        integrator.step(10)
    assert device.effectiveEnergy()._value == pytest.approx(host.effectiveEnergy()._value, rel=1e-8)
    for integrator in (host, device):
        integrator.step(1)
    assert device.totalEnergy()._value == pytest.approx(host.totalEnergy()._value, rel=1e-8)


@pytest.mark.parametrize("scheme", ["BAOAB", "BAOA", "W2_3m"])
def test_the_balance_with_inner_steps_is_that_of_the_host(scheme):
    def make(engine):
        integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, 0.002, scheme, fast="bonded", engine=engine)
        integrator.setRandomNumberSeed(11)
        return integrator

    _, system, x = in_water(waters=30)
    contexts = pair(system, x, make)
    host, device = (context.getIntegrator() for context in contexts)
    for integrator in (host, device):
        integrator.step(7)
    assert device.effectiveEnergy()._value == pytest.approx(host.effectiveEnergy()._value, rel=1e-8)
