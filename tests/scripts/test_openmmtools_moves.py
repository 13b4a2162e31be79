"""Moves and caches of openmmtools copy integrators, and use each as it was made."""

import copy
import pickle

import numpy as np
import pytest
from openmm import unit

import openmm_exactrb as rb
from every_integrator import KINDS, made, others
from places import REFERENCE

pytestmark = pytest.mark.filterwarnings("ignore")
reason = "pip install 'openmm-exactrb[validation]'"
cache = pytest.importorskip("openmmtools.cache", reason=reason)
mcmc = pytest.importorskip("openmmtools.mcmc", reason=reason)
states = pytest.importorskip("openmmtools.states", reason=reason)

SYSTEM, START = rb.rigid_water(8)[1:]
TEMPERATURE = 300 * unit.kelvin


def state_at(temperature=TEMPERATURE):
    return states.ThermodynamicState(SYSTEM, temperature)


def test_a_cache_has_a_context_for_each_setting():
    """But for those that it sets itself: the step, the temperature and the friction."""
    contexts = cache.ContextCache(platform=REFERENCE)
    distinct = set()
    for kind in KINDS:
        for name, value in others(kind):
            asked = made(kind, **{name: value})
            if kind is not rb.ExactRigidBodyIntegrator and name != "temperature":
                assert asked.getTemperature() == TEMPERATURE
            later = {"stepSize", "forceInterval", "temperature", "frictionCoeff"}
            distinct.add((kind, None if name in later else (name, str(value))))
            state = state_at(getattr(asked, "getTemperature", lambda: TEMPERATURE)())
            _, integrator = contexts.get_context(state, asked)
            assert type(integrator) is kind
            assert integrator.getSettings() == asked.getSettings()
            assert len(contexts) == len(distinct)


def integrator_at(state):
    return rb.ExactRigidBodyLangevinIntegrator(state.temperature, 5.0, 0.006, scheme="W2_3m")


class ExactMove(mcmc.BaseIntegratorMove):
    """A move such as LangevinDynamicsMove, with an integrator at the temperature of the state."""

    def _get_integrator(self, state):
        return integrator_at(state)


def moves():
    yield ExactMove(n_steps=4)
    for kind in KINDS:
        yield mcmc.IntegratorMove(made(kind), n_steps=4)


@pytest.mark.parametrize("copied", [lambda one: one, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_moves_move(copied):
    contexts = cache.ContextCache(platform=REFERENCE)
    for number, move in enumerate(map(copied, moves())):
        sampled = states.SamplerState(START)
        for _ in range(2):
            before = sampled.positions / unit.nanometer
            move.apply(state_at(), sampled, context_cache=contexts)
            moved = np.abs(sampled.positions / unit.nanometer - before).max()
            assert 1e-4 < moved < 0.3
        assert len(contexts) == number + 1


def test_a_move_serves_several_temperatures_in_one_context():
    contexts, move = cache.ContextCache(platform=REFERENCE), ExactMove(n_steps=2)
    for kelvin in (300.0, 320.0, 345.0, 300.0):
        state = state_at(kelvin * unit.kelvin)
        move.apply(state, states.SamplerState(START), context_cache=contexts)
        _, integrator = contexts.get_context(state, integrator_at(state))
        assert (integrator.getTemperature(), integrator.getScheme().name) == (state.temperature, "W2_3m")
    assert len(contexts) == 1
