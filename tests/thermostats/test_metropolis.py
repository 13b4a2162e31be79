"""Metropolis decides, and turns momenta round where it refuses; `test_distributions` has what follows from it."""

import math

import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.integrators.bath_access import Tally
from openmm_exactrb.thermostats.hybrid import accepts
from starts import droplet_of


def test_metropolis_takes_what_its_rule_takes():
    assert accepts(0.0, 1.0, 0.999)
    assert accepts(-5.0, 1.0, 0.999)
    assert accepts(2.0, 4.0, math.exp(-0.5) - 1e-12)
    assert not accepts(2.0, 4.0, math.exp(-0.5) + 1e-12)
    assert not accepts(1e300, 1.0, 1e-300)
    assert not accepts(math.inf, 1.0, 1e-300)
    assert not accepts(math.nan, 1.0, 1e-300)


def test_momenta_turn_round_on_refusal_and_proposals_are_counted():
    simulation = droplet_of(rb.ExactRigidBodyHybridIntegrator(1.0, 0.0, 0.1))
    integrator = simulation.integrator
    integrator.setRandomNumberSeed(1)
    assert math.isnan(integrator.acceptanceRate())
    accepted = proposed = 0
    for _ in range(20):
        before, was = integrator.bodyState()[1], integrator.tally().accepted
        integrator.step(1)
        after, proposed = integrator.bodyState()[1], proposed + 1
        if integrator.tally().accepted == was:
            for name, sign in {"R": 1.0, "P": -1.0, "q": 1.0, "m": -1.0}.items():
                np.testing.assert_array_equal(getattr(after, name), sign * getattr(before, name))
        else:
            accepted += 1
            assert np.abs(after.R - before.R).max() > 0.0
    assert integrator.tally() == Tally(accepted, proposed)
    assert 0 < accepted < proposed
    assert integrator.acceptanceRate() == accepted / proposed
