"""The host engine moves bodies in NumPy as it does with functions of the library."""

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.library import functions
from peptides import peptide
from starts import context_of

pytestmark = pytest.mark.library


def water():
    _, system, positions = rb.rigid_water(8)
    return system, positions


def bonded():
    """Return a peptide, with pairs that turn, clusters and single atoms, whose drifts have inner steps."""
    _, system, positions = peptide()
    return system, positions


SYSTEMS = {
    "water": (water, {}),
    "clusters": (bonded, {"fast": None}),
    "inner steps": (bonded, {"fast": "bonded"}),
}


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("scheme", ["W2_3", "S2_2", "BAOA"])
def test_a_trajectory_does_not_depend_on_the_library(name, scheme, monkeypatch):
    make, settings = SYSTEMS[name]
    system, positions = make()
    found = []
    for in_numpy in (False, True):
        monkeypatch.setattr(functions, "available", lambda in_numpy=in_numpy: not in_numpy)
        common = {"scheme": scheme, "engine": "host", **settings}
        integrator = (
            rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, **common)
            if scheme == "BAOA"
            else rb.ExactRigidBodyIntegrator(0.002, **common)
        )
        integrator.setRandomNumberSeed(7)
        context = context_of(system, integrator, positions, kelvin=300.0)
        integrator.step(5)
        state = context.getState(positions=True, velocities=True)
        arrays = state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value
        found.append((*arrays, integrator.timings.fast_evaluations))
    (x, v, count), (x1, v1, count1) = found
    assert np.abs(x - x1).max() < 1e-13
    assert np.abs(v - v1).max() < 1e-10
    assert count == count1
