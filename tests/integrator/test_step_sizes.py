"""What a step is, how many steps a time takes, and intervals that were meant for steps of another size."""

import pytest
from openmm import unit

import openmm_exactrb as rb
from starts import context_of

PS = unit.picosecond


@pytest.mark.parametrize(
    ("integrator", "said"),
    [
        (rb.ExactRigidBodyIntegrator(0.002), "a step is 2 fs with one force evaluation"),
        (
            rb.ExactRigidBodyLangevinIntegrator(300, 1, scheme="W2_3m", forceInterval=0.008),
            "a step is 24 fs with 3 force evaluations, one every 8 fs",
        ),
        (rb.ExactRigidBodyHybridIntegrator(300, 1, 0.006, stepsPerProposal=3), "a step is 6 fs with 6 force eval"),
        (rb.ExactRigidBodyIntegrator(0.0015, "S2_2"), "a step is 1.5 fs with 2 force evaluations, one every 0.75 fs"),
    ],
)
def test_an_integrator_says_what_a_step_is(integrator, said):
    assert said in repr(integrator)
    _, system, positions = rb.rigid_water(8)
    _context = context_of(system, integrator, positions)
    assert said in integrator.engineNote()
    integrator.setStepSize(0.001)
    assert "a step is 1 fs" in str(integrator)


@pytest.mark.parametrize(
    ("h", "time", "steps"),
    [
        (0.002, 1.0, 500),
        (0.003, 1.0 * unit.nanosecond, 333334),
        (0.024, 240 * unit.femtosecond, 10),
        (0.1, 0.3, 3),
        (0.004, 0.0, 0),
        (0.0021, 0.0021, 1),
        (0.0021, 0.00211, 2),
    ],
)
def test_the_steps_for_a_time_take_at_least_that_long(h, time, steps):
    assert rb.ExactRigidBodyIntegrator(h).stepsFor(time) == steps
