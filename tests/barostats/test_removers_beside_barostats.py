"""A CMMotionRemover and a barostat act at the same points of a step on every engine."""

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from places import REFERENCE
from starts import context_of, positions_of, velocities_of


@pytest.mark.parametrize("interval", [1, 2, 3])
@pytest.mark.parametrize("scheme", ["S2_2", "BAOA", "BAOAB", "W2_3m", "W2_4g"])
def test_the_engines_agree(scheme, interval):
    found = []
    for engine in ("host", "native"):
        _, system, positions = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)
        barostat = openmm.MonteCarloBarostat(1.0, 300.0, 3)
        barostat.setRandomNumberSeed(5)
        system.addForce(barostat)
        system.addForce(openmm.CMMotionRemover(interval))
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.001, scheme, engine=engine)
        integrator.setRandomNumberSeed(9)
        context = context_of(system, integrator, positions, platform=REFERENCE)
        integrator.setVelocitiesToTemperature(300.0, 1)
        integrator.step(20)
        box = context.getState().getPeriodicBoxVectors(asNumpy=True)._value
        found.append((positions_of(context), velocities_of(context), box, integrator.heat()._value))
    (x, v, box, heat), (x1, v1, box1, heat1) = found
    assert np.abs(x - x1).max() < 1e-13
    assert np.abs(v - v1).max() < 1e-11
    np.testing.assert_allclose(box1, box, rtol=1e-14)
    assert heat1 == pytest.approx(heat, abs=1e-8)
