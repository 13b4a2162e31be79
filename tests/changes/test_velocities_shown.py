"""Velocities along constraints, which users and AndersenThermostat set, are not shown after a call of `step`."""

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from places import REFERENCE
from products import in_pairs
from starts import context_of, positions_of, velocities_of

EVERYWHERE = in_pairs(
    {"scheme": ["S2_2", "V2", "W2_1", "W4_4"], "engine": ["host", "auto"], "platform": ["Reference", "CPU"]},
    indirect=["platform"],
)


def along_constraints(context):
    """Return the largest velocity (nm/ps) along a constraint."""
    system, x, v = context.getSystem(), positions_of(context), velocities_of(context)
    pairs = [system.getConstraintParameters(k) for k in range(system.getNumConstraints())]
    return max(abs((x[i] - x[j]) @ (v[i] - v[j])) / length._value for i, j, length in pairs)


def context_with(engine, scheme, platform, thermostat):
    _, system, x = rb.rigid_water(8, nonbondedMethod=app.NoCutoff)
    if thermostat:
        force = openmm.AndersenThermostat(300.0, 50.0)
        force.setRandomNumberSeed(1)
        system.addForce(force)
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme, engine=engine)
    return context_of(system, integrator, np.array(x.value_in_unit(unit.nanometer)), kelvin=300.0, platform=platform)


@EVERYWHERE
def test_velocities_of_the_andersen_thermostat_are_those_of_rigid_bodies(scheme, engine, platform):
    context = context_with(engine, scheme, platform, thermostat=True)
    for _ in range(20):
        context.getIntegrator().step(1)
        assert along_constraints(context) < 1e-6


@EVERYWHERE
def test_step_0_removes_velocities_along_constraints(scheme, engine, platform):
    context = context_with(engine, scheme, platform, thermostat=False)
    context.getIntegrator().step(2)
    v = np.random.default_rng(3).normal(size=(24, 3))
    context.setVelocities(v)
    context.getIntegrator().step(0)
    shown = velocities_of(context)
    assert along_constraints(context) < 1e-9
    system, reference = context.getSystem(), openmm.VerletIntegrator(0.001)
    reference.setConstraintTolerance(1e-12)
    other = openmm.Context(system, reference, REFERENCE)
    other.setPositions(positions_of(context))
    other.setVelocities(v)
    other.applyVelocityConstraints(1e-12)
    np.testing.assert_allclose(shown, velocities_of(other), rtol=0.0, atol=1e-9)
