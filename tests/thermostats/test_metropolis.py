"""Metropolis decides: the distribution is exact at steps where the splitting alone is visibly biased."""

import math

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.mechanics.rng import Instant, Purpose
from openmm_exactrb.thermostats.hybrid import Tally, accepts
from openmm_exactrb.thermostats.langevin import ornstein_uhlenbeck
from thermal_tops import KT, SEQUENCES, WATER, WATER_MASS, Tops, flipped, langevin_function
from thermostatted import droplet_of


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


def oscillator(metropolis, h=1.44, friction=0.7, steps=200_000):
    """Return <q²>, <p²> and their errors for an oscillator of unit frequency: velocity Verlet, exact thermostat."""
    a = math.exp(-friction * h)
    at = Instant(1, 0, 0)
    noise = math.sqrt(1.0 - a * a) * at.normals(Purpose.TRANSLATION, (steps,))
    uniforms = at.generator(Purpose.METROPOLIS).random(steps)
    state, accepted, squares = (1.0, 0.0), 0, np.empty((2, steps))
    for step in range(steps):
        q, p = state[0], a * state[1] + noise[step]
        half = p - 0.5 * h * q
        q1 = q + h * half
        p1 = half - 0.5 * h * q1
        rise = 0.5 * (q1 * q1 + p1 * p1 - q * q - p * p)
        state = (q1, p1)
        if metropolis:
            taken = accepts(rise, 1.0, uniforms[step])
            state, accepted = state if taken else (q, -p), accepted + taken
        squares[:, step] = state[0] ** 2, state[1] ** 2
    blocks = squares.reshape(2, 100, -1).mean(axis=2)
    return blocks.mean(axis=1), blocks.std(axis=1, ddof=1) / 10.0, accepted / steps


def test_an_oscillator_is_exact_where_the_splitting_is_not():
    mean, error, rate = oscillator(metropolis=True)
    assert (np.abs(mean - 1.0) < 4.0 * error).all()
    assert (error < 0.02).all()
    assert 0.3 < rate < 0.9
    biased, error, _ = oscillator(metropolis=False)
    assert abs(biased[0] - 1.0 / (1.0 - 1.44**2 / 4.0)) < 4.0 * error[0]


def ghmc_of_dipoles(n, h, steps):
    """Return the error of U/kT of dipoles that OBABO moves as one system, its width, and the rate of acceptance."""
    tops = Tops(n, WATER, WATER_MASS, KT, axis=1, x=20.0, w=40.0)
    exchange = ornstein_uhlenbeck(tops.masses, tops.all_moments, KT, 5.0, 5.0)
    state, accepted, found = tops.canonical(np.random.default_rng(7)), 0, np.empty(steps)
    flows, (outer, *inner, _) = tops.flows(), SEQUENCES["OBABO"]

    def refreshed(state, step, place):
        P, m = exchange(state.P, state.m, outer[1] * h, Instant(2, step, place))
        return state._replace(P=P, m=m)

    for step in range(steps):
        state = new = refreshed(state, step, 0)
        for substep, part in inner:
            new = flows[substep](new, part * h)
        rise = float((tops.energies(new) - tops.energies(state)).sum())
        u = Instant(2, step, 1).uniform(Purpose.METROPOLIS)
        taken = accepts(rise, KT, u)
        state, accepted = new if taken else flipped(state), accepted + taken
        state = refreshed(state, step, 2)
        found[step] = -20.0 * (tops.cosine(state).mean() - langevin_function(20.0))
    blocks = found[: steps - steps % 50].reshape(50, -1).mean(axis=1)
    return blocks.mean(), blocks.std(ddof=1) / np.sqrt(50), accepted / steps


@pytest.mark.validate
def test_rigid_dipoles_are_exact_where_the_splitting_is_not():
    """OBABO at 8 fs is 0.09 kT off by itself."""
    energy, width, rate = ghmc_of_dipoles(n=30, h=0.008, steps=150_000)
    assert width < 0.01
    assert abs(energy) < 3.0 * width
    assert 0.2 < rate < 0.95
