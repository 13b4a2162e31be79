"""Some of the bodies by themselves: a peptide among molecules of water."""

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.mechanics.bodies import ChosenBodies
from openmm_exactrb.mechanics.free_motion import free_motion
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.multiple_time_steps.excerpt import bonded_excerpt
from openmm_exactrb.multiple_time_steps.inner_drift import inner_steps
from openmm_exactrb.steps.substeps import kick
from peptides import in_water, moving


@pytest.fixture(scope="module")
def droplet():
    """All bodies, the peptide's part of them with its particles, and a state with momenta."""
    _, system, x = in_water()
    integrator, _context = moving(system, x)
    integrator.step(1)
    bodies, state = integrator.fullState()
    excerpt = bonded_excerpt(system, bodies)
    return bodies, excerpt, state


def kinetic_of(bodies):
    return free_motion(bodies, "exact")


def test_the_part_of_the_bonded_forces_is_the_peptide(droplet):
    bodies, excerpt, state = droplet
    part = excerpt.part
    np.testing.assert_array_equal(excerpt.particles, np.arange(22))
    assert (len(part.bodies), part.bodies.n_turning, len(part.bodies.clusters)) == (22, 0, 6)  # CH, NH and CH3
    everywhere = bodies.positions(state.rounded, np.zeros((bodies.n_particles, 3)))
    here = part.bodies.positions(part.of(state).rounded, np.zeros((22, 3)))
    np.testing.assert_array_equal(here, everywhere[excerpt.particles])


def test_bodies_that_turn_are_parts_too(droplet):
    """Every other molecule of water: their drift is that of the same ones among all, bit for bit."""
    bodies, _, state = droplet
    chosen = np.zeros(len(bodies), dtype=bool)
    chosen[: bodies.n_turning : 2] = True
    particles = np.flatnonzero(chosen[bodies.owner])
    number = np.full(bodies.n_particles, -1)
    number[particles] = np.arange(len(particles))
    part = ChosenBodies(bodies.chosen(chosen, number, len(particles)), chosen)
    assert part.bodies.n_turning == len(part.bodies) == chosen.sum()
    own = kinetic_of(part.bodies).drift(part.of(state), 0.01)
    everything = kinetic_of(bodies).drift(state, 0.01)
    for a, b in zip(part.of(everything), own, strict=True):
        np.testing.assert_array_equal(b, a)


def test_a_part_goes_back_where_it_was_and_leaves_the_others(droplet):
    _, excerpt, state = droplet
    part = excerpt.part
    own = State(*(2.0 * a for a in part.of(state)))
    after = part.into(state, own)
    for a, b in zip(part.of(after), own, strict=True):
        np.testing.assert_array_equal(a, b)
    others = np.setdiff1d(np.arange(state.P.shape[2]), part.columns)
    np.testing.assert_array_equal(after.P[..., others], state.P[..., others])
    np.testing.assert_array_equal(after.R[..., others], state.R[..., others])


def test_a_drift_of_inner_steps_without_forces_is_the_drift(droplet):
    """Of a part in three steps with two kicks each and the one between the others, and of all bodies in one."""
    bodies, excerpt, state = droplet
    free, part = kinetic_of(bodies), excerpt.part
    calls = []

    def nothing(state):
        calls.append(state)
        return np.zeros(state.R.shape[1:]), np.zeros(state.m.shape[1:])

    sequence = rb.SCHEMES["S2_2"].sequence
    alone = inner_steps(kinetic_of(part.bodies).drift, kick(nothing), sequence, lambda tau: 3)
    for a, b in zip(alone(part.of(state), 0.002), part.of(free.drift(state, 0.002)), strict=True):
        np.testing.assert_allclose(a[0], b[0], rtol=0.0, atol=1e-13)
    assert len(calls) == 7
    whole = inner_steps(free.drift, kick(nothing), sequence, lambda tau: 1)
    for a, b in zip(whole(state, 0.002), free.drift(state, 0.002), strict=True):
        np.testing.assert_allclose(a[0], b[0], rtol=0.0, atol=3e-15)
    assert len(calls) == 7 + 3
