"""States of other integrators are loaded by OpenMM's own methods, or a sentence says which method loads them."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from places import platform_for
from products import in_pairs
from starts import held, simulation_of

H, T = 0.002, 300.0


def own_program():
    integrator = openmm.CustomIntegrator(H)
    integrator.addGlobalVariable("work", 0.0)
    integrator.addPerDofVariable("before", 0.0)
    integrator.addComputePerDof("before", "x")
    integrator.addComputePerDof("x", "x + dt*v")
    integrator.addConstrainPositions()
    return integrator


THEIRS = {
    "Verlet": lambda: openmm.VerletIntegrator(H),
    "LangevinMiddle": lambda: openmm.LangevinMiddleIntegrator(T, 1.0, H),
    "Brownian": lambda: openmm.BrownianIntegrator(T, 1000.0, H),
    "VariableVerlet": lambda: openmm.VariableVerletIntegrator(1e-4),
    "NoseHoover": lambda: openmm.NoseHooverIntegrator(T, 1.0, H),
    "MTS": lambda: openmm.MTSIntegrator(H, [(0, 2)]),
    "Custom": own_program,
}
OURS = {
    "W2_1": lambda **engine: rb.ExactRigidBodyIntegrator(H, **engine),
    "S2_2": lambda **engine: rb.ExactRigidBodyIntegrator(H, "S2_2", **engine),
    "Langevin": lambda **engine: rb.ExactRigidBodyLangevinIntegrator(T, 1.0, H, **engine),
    "NoseHoover": lambda **engine: rb.ExactRigidBodyNoseHooverIntegrator(T, 10.0, H, **engine),
    "Hybrid": lambda **_: rb.ExactRigidBodyHybridIntegrator(T, 1.0, H),
}


def water(integrator, platform=None):
    topology, system, positions = rb.rigid_water(8)
    options = {} if platform is None else {"platform": platform}
    return simulation_of(topology, system, integrator, positions, kelvin=T, **options)


@in_pairs({"theirs": THEIRS, "ours": OURS, "moved": [False, True]})
def test_states_of_openmms_integrators_are_loaded(tmp_path, theirs, ours, moved):
    """By a Simulation that has made steps, and by one that has not, with time and step count."""
    first, second = water(THEIRS[theirs]()), water(OURS[ours]())
    first.step(2)
    first.saveState(str(tmp_path / "state.xml"))
    second.step(2 * moved)
    second.loadState(str(tmp_path / "state.xml"))
    np.testing.assert_array_equal(held(second), held(first))
    assert second.context.getStepCount() == 2
    assert second.context.getTime() == first.context.getTime()
    second.step(1)
    assert np.isfinite(held(second)).all()


@pytest.mark.parametrize("ours", OURS)
@pytest.mark.parametrize("theirs", THEIRS)
def test_states_of_ours_are_loaded_by_openmms_integrators(tmp_path, theirs, ours):
    first, second = water(OURS[ours]()), water(THEIRS[theirs]())
    first.step(2)
    first.saveState(str(tmp_path / "state.xml"))
    second.loadState(str(tmp_path / "state.xml"))
    np.testing.assert_array_equal(held(second), held(first))
    assert second.context.getStepCount() == 2


@pytest.mark.opencl
@pytest.mark.parametrize("theirs", ["LangevinMiddle", "NoseHoover", "Custom"])
def test_states_of_openmms_integrators_are_loaded_by_the_native_engine(theirs):
    first, second = water(THEIRS[theirs]()), water(OURS["S2_2"](engine="native"), platform_for("native")[0])
    first.step(2)
    second.step(1)
    second.context.setState(first.context.getState(positions=True, velocities=True, integratorParameters=True))
    np.testing.assert_allclose(held(second), held(first), atol=1e-6)
    second.step(1)


@pytest.mark.parametrize("loads", ["S2_2", "Langevin"])
def test_states_of_another_scheme_continue_the_shown_state(loads):
    first, second, third = water(OURS["W2_1"]()), water(OURS[loads]()), water(OURS[loads]())
    first.step(2)
    for integrator in (second.integrator, third.integrator):
        integrator.setRandomNumberSeed(1)
    second.context.setState(first.context.getState(positions=True, velocities=True, integratorParameters=True))
    third.context.setState(first.context.getState(positions=True, velocities=True))
    for simulation in (second, third):
        simulation.step(3)
    np.testing.assert_allclose(held(second), held(third), atol=1e-9)


@pytest.mark.parametrize(("saved", "loads"), [("NoseHoover", "S2_2"), ("NoseHoover", "Hybrid")])
def test_states_of_other_schemes_and_thermostats_are_refused_with_the_remedy(saved, loads):
    first, second = water(OURS[saved]()), water(OURS[loads]())
    first.step(2)
    state = first.context.getState(positions=True, velocities=True, integratorParameters=True)
    with pytest.raises(openmm.OpenMMException, match=r"thermostat with other variables .* openmm_exactrb\.loadState"):
        second.context.setState(state)
    rb.loadState(second, state)
    np.testing.assert_array_equal(held(second), held(first))
