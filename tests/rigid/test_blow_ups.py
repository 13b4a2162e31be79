"""Runs that blow up end with an IntegrationError, and the Context keeps the last valid state."""

import contextlib
import functools

import numpy as np
import openmm
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from openmm import app

import openmm_exactrb as rb
from starts import positions_of, velocities_of

SCHEMES = ["S2_2", "W2_1", "W4_4", "SRKN6_14a", "V2_C17"]


@pytest.mark.parametrize(("engine", "platform"), [("host", "Reference"), ("native", "CPU"), ("native", "Reference")])
@settings(max_examples=8, deadline=None)
@given(st.sampled_from(SCHEMES), st.floats(0.05, 1.0), st.floats(300.0, 1e5), st.sampled_from([1, 60, 300]))
@example("W2_1", 0.05, 3e4, 200)
@example("V2_C17", 0.875, 30581.0, 60)
def test_blow_ups_of_any_size_are_integration_errors(engine, platform, scheme, size, kelvin, steps):
    """Whether a body, the energy or OpenMM notices first."""
    blow_up(rb.rigid_water(8, seed=1), engine, platform, scheme, size, kelvin, steps)


@pytest.mark.parametrize(("engine", "platform"), [("host", "CPU"), ("native", "Reference")])
@settings(max_examples=8, deadline=None)
@given(st.sampled_from(SCHEMES), st.floats(0.04, 2.0), st.floats(100.0, 1e5), st.sampled_from([1, 60, 300]))
@example("W2_1", 0.06, 1602.0, 1)
@example("SRKN6_14a", 0.78, 9011.0, 60)
def test_blow_ups_with_a_mesh_are_integration_errors(engine, platform, scheme, size, kelvin, steps):
    """On Reference, OpenMM's mesh has indices from the positions, and writes outside it if these are not finite."""
    blow_up(boxed_water(), engine, platform, scheme, size, kelvin, steps)


@functools.cache
def boxed_water():
    return rb.rigid_water(64, nonbondedMethod=app.PME, nonbondedCutoff=0.5)


def blow_up(water, engine, platform, scheme, size, kelvin, steps):
    """Make steps that are too long; the Context must keep a valid state."""
    _, system, positions = water
    integrator = rb.ExactRigidBodyIntegrator(size, scheme, engine=engine)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform))
    context.setPositions(positions)
    integrator.setVelocitiesToTemperature(kelvin, 1)
    with contextlib.suppress(rb.IntegrationError):
        integrator.step(steps)
    assert np.isfinite(positions_of(context)).all()
    assert np.isfinite(velocities_of(context)).all()
    integrator.step(0)
