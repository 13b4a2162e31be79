"""Inner steps in one call, compiled or in numpy, are those of the flows that they are made of."""

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb import kernels
from openmm_exactrb.kernels.plain import inner_steps
from openmm_exactrb.multiple_time_steps import compiled_inner_steps
from peptides import peptide
from starts import context_of


@pytest.mark.parametrize("scheme", ["W2_3", "S2_2", "W4_5"])
@pytest.mark.parametrize("in_numpy", [False, True], ids=["compiled", "numpy"])
def test_a_peptide_moves_as_by_flows_that_numpy_turns(in_numpy, scheme, monkeypatch):
    """It has pairs that turn, clusters and single atoms; the rotor in numpy is never part of a compiled call."""
    _, system, positions = peptide()
    calls = []
    if in_numpy:
        load = kernels.load
        monkeypatch.setattr(kernels, "load", lambda name: inner_steps if name == "inner_steps" else load(name))
    made = compiled_inner_steps.CompiledInnerSteps.__call__
    monkeypatch.setattr(
        compiled_inner_steps.CompiledInnerSteps, "__call__", lambda *some: calls.append(some) or made(*some)
    )
    found = []
    for rotor in ("exact", "exact_numpy"):
        integrator = rb.ExactRigidBodyIntegrator(0.004, scheme=scheme, fast="bonded", rotor=rotor, engine="host")
        context = context_of(system, integrator, positions, kelvin=300.0)
        integrator.step(5)
        assert bool(calls) == (rotor == "exact")
        calls.clear()
        state = context.getState(positions=True, velocities=True)
        arrays = state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value
        found.append((*arrays, integrator.timings.fast_evaluations))
    (x, v, count), (x1, v1, count1) = found
    assert np.abs(x - x1).max() < 1e-13
    assert np.abs(v - v1).max() < 1e-11
    assert count == count1
