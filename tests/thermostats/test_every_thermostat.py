"""What every thermostat of the package does, found in its folder; each takes a temperature and a rate or time."""

import copy
import importlib
import pickle
import pkgutil

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import three_masses
from openmm_exactrb import thermostats
from openmm_exactrb.thermostats import Thermostat
from starts import R, context_of

BODIES, T = 800, 300.0
_MODULES = (f"openmm_exactrb.thermostats.{module.name}" for module in pkgutil.iter_modules(thermostats.__path__))
KINDS = {
    name: kind
    for module in map(importlib.import_module, _MODULES)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and issubclass(kind, Thermostat) and kind.__module__ == module.__name__
    if kind is not Thermostat
}


@pytest.fixture(params=KINDS)
def thermostat(request):
    return KINDS[request.param](T, 5.0)


def gas():
    """Return many triangles without forces, and their positions."""
    system, positions = openmm.System(), []
    for k in range(BODIES):
        for i in range(3):
            system.addParticle(1.0)
            for j in range(i):
                system.addConstraint(3 * k + i, 3 * k + j, 0.1)
        positions.append(three_masses.POSITIONS + np.array([k, 0.0, 0.0]))
    return system, np.concatenate(positions)


def moving(thermostat, engine="host", h=0.02):
    """Return the integrator of a gas in motion, and its Context."""
    integrator = rb.ExactRigidBodyIntegrator(h, thermostat=thermostat, engine=engine)
    integrator.setRandomNumberSeed(4)
    system, positions = gas()
    context = context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(T, 1)
    return integrator, context


def test_the_temperatures_of_translation_and_rotation_stay(thermostat):
    """Within four standard deviations of one sample, which is all that a run within a relaxation time contains."""
    (integrator, _context), found = moving(thermostat), []
    for _ in range(40):
        integrator.step(5)
        found.append([2.0 * e._value / (3 * BODIES * R * T) for e in integrator.kineticEnergies()])
    np.testing.assert_allclose(np.mean(found, axis=0), 1.0, atol=4.0 * np.sqrt(2.0 / (3 * BODIES)))


def test_a_copy_is_equal_and_acts_alike(thermostat):
    for twin in (copy.deepcopy(thermostat), pickle.loads(pickle.dumps(thermostat))):
        assert twin == thermostat
    ends = []
    for one in (thermostat, copy.deepcopy(thermostat)):
        integrator, _context = moving(one)
        integrator.step(3)
        ends.append(integrator.fullState()[1].P)
    np.testing.assert_array_equal(*ends)


def test_the_native_engine_exchanges_the_same_or_refuses_in_a_sentence(thermostat):
    name = type(thermostat).__name__
    if thermostat.kernel_exchange(0.0, (0, 0)) is None:
        with pytest.raises(ValueError, match=f"the native engine does not support {name}: use engine='host' instead"):
            moving(thermostat, "native")
        integrator, _context = moving(thermostat, "auto")
        assert name in integrator.engineNote()
        return
    ends = []
    for engine in ("host", "native"):
        integrator, _context = moving(thermostat, engine)
        integrator.step(5)
        assert integrator.getEngine() == engine
        ends.append(integrator.fullState()[1])
    for one, other in zip(*ends, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)
