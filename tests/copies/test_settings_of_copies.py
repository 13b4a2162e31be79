"""Copies by Python have the settings of the original, and no Context."""

import copy
import pickle

import numpy as np
import pytest

import openmm_exactrb as rb
import starts
from few_dipoles import simulation_of, snapshot
from starts import held


def test_copies_have_the_settings_and_no_context():
    simulation = simulation_of(scheme="S6_10", rotor="mclachlan_reich", h=0.03)
    simulation.integrator.setIntegrationForceGroups({0, 3})
    for twin in (copy.copy(simulation.integrator), copy.deepcopy(simulation.integrator)):
        assert twin.getScheme().name == "S6_10"
        assert twin.getRotor() == "mclachlan_reich"
        assert twin.getStepSize()._value == 0.03
        assert twin.getIntegrationForceGroups() == 0b1001
    twin = pickle.loads(pickle.dumps(simulation.integrator))
    assert twin.getIntegrationForceGroups() == 0b1001
    again = starts.simulation_of(simulation.topology, simulation.system, twin, snapshot(simulation)[0])
    again.step(1)


class OfWater(rb.ExactRigidBodyLangevinIntegrator):
    """An integrator with arguments of its own."""

    def __init__(self, label):
        super().__init__(300.0, 5.0, 0.004, scheme="BAOAB")
        self.label = label


@pytest.mark.parametrize("twin_of", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_subclass_with_arguments_of_its_own_can_be_copied(twin_of):
    simulation = simulation_of(2)
    integrator = OfWater(["water"])
    integrator.setTemperature(310.0)
    integrator.setRandomNumberSeed(3)
    _context = starts.context_of(simulation.system, integrator, snapshot(simulation)[0])
    integrator.step(1)
    twin = twin_of(integrator)
    assert (type(twin), twin.label) == (OfWater, ["water"])
    assert twin.getSettings() == integrator.getSettings()
    assert set(vars(twin)) == set(vars(OfWater("water")))
    assert twin.timings.evaluations == 0
    again = starts.context_of(simulation.system, twin, snapshot(simulation)[0])
    twin.step(1)
    assert again.getStepCount() == 1


@pytest.mark.parametrize(
    ("name", "duplicate"),
    [("V2", copy.copy), ("SRKN4_6b", copy.deepcopy), ("V2_C17", lambda x: pickle.loads(pickle.dumps(x)))],
)
def test_a_copy_of_an_integrator_moves_as_the_original(name, duplicate):
    context = simulation_of(4, 0.005, name).context
    context.getIntegrator().bodyState()
    x, v = held(context)
    twin = duplicate(context.getIntegrator())
    other = starts.context_of(context.getSystem(), twin, x, v)
    with pytest.raises(ValueError, match="no Context yet"):
        duplicate(twin).step(1)
    for integrator in (context.getIntegrator(), twin):
        integrator.step(2)
    np.testing.assert_allclose(held(other), held(context), rtol=0.0, atol=1e-13)


def test_a_copy_keeps_the_bodies_named_by_hand():
    integrator = rb.ExactRigidBodyIntegrator(0.01, bodies=[[0, 1, 2]])
    for twin in (copy.deepcopy(integrator), pickle.loads(pickle.dumps(integrator))):
        assert twin.getNamedBodies() is not None
        assert twin.__reduce__() == integrator.__reduce__()
