"""A class that overrides one description of its flow, and not the others, has no flow but its own."""

import copy
import pickle

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme, stability_limit
from openmm_exactrb.steps.substeps import DRIFT, KICK, Drift, GradientKick, HeatExchange, Kick, LastForcesKick, Substep
from openmm_exactrb.support.descriptions import mismatch
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin, NoseHooverChain, StochasticRescaling
from overriding import (
    SUBSTEPS,
    THERMOSTATS,
    Decorated,
    NoKick,
    idle,
    moved,
    no_exchange,
    of_instance,
    scheme_of,
)


def note_of(integrator):
    """Return why an integrator is left to the host, whatever the Context."""
    assert integrator.getEngine() == "host"  # which is settled, because no other engine serves it
    return integrator.engineNote()


# -- the kernels refuse what only the host knows ----------------------------------------------------------------------


@pytest.mark.parametrize("substep", SUBSTEPS.values(), ids=SUBSTEPS)
@pytest.mark.parametrize("place", ["sequence", "processor", "output"])
def test_a_substep_that_overrides_its_flow_alone_is_left_to_the_host(substep, place):
    rows = ((substep, 0.5), (DRIFT, 1.0), (substep, 0.5))
    verlet = ((KICK, 0.5), (DRIFT, 1.0), (KICK, 0.5))
    options, processor = {}, {"processor": verlet}
    if isinstance(substep, HeatExchange):  # not within processors
        options, processor, place = {"thermostat": Langevin(300.0, 1.0)}, {}, "sequence"
    scheme = Scheme("mine", 2, **({"sequence": verlet} | processor | {place: rows}))
    why = rf"{type(substep).__name__} overrides bind\(\) but inherits kernel_moves\(\)"
    with pytest.raises(ValueError, match=why):
        rb.ExactRigidBodyIntegrator(0.001, scheme, engine="native", **options)
    left = rb.ExactRigidBodyIntegrator(0.001, scheme, **options)
    assert note_of(left).startswith(f"{type(substep).__name__} overrides bind()")


@pytest.mark.parametrize("thermostat", THERMOSTATS.values(), ids=THERMOSTATS)
def test_a_thermostat_that_overrides_its_exchange_alone_is_left_to_the_host(thermostat):
    with pytest.raises(ValueError, match=r"overrides (bind|flow|moved)\(\) but inherits kernel_exchange\(\)"):
        rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine="native", thermostat=thermostat)
    left = rb.ExactRigidBodyIntegrator(0.001, "S2_2", thermostat=thermostat)
    assert "but inherits kernel_exchange()" in note_of(left)
    left.setRandomNumberSeed(5)
    _, with_it = moved(left)
    _, without = moved(rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine="host"))
    for one, other in zip(with_it, without, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-13)


def test_a_setting_changes_no_method_of_a_thermostat():
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.001, "S2_2")
    object.__setattr__(integrator.getThermostat(), "bind", lambda environment: no_exchange(None, environment))
    integrator.setFriction(7.0)
    assert integrator.getFriction()._value == 7.0
    assert mismatch(integrator.getThermostat(), "kernel_exchange", *Langevin.flows)


# -- the host does what is overridden ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["subclass", "grandchild", "mixin", "mixin of a mixin", "dataclass", "instance"])
def test_the_host_does_what_is_overridden(name):
    substep = SUBSTEPS[name]
    before, after = moved(rb.ExactRigidBodyIntegrator(0.001, scheme_of(substep)))
    np.testing.assert_array_equal(after.P, before.P)
    kicked = Scheme("both", 2, ((KICK, 0.5), (DRIFT, 1.0), (substep, 0.5)))
    _, half = moved(rb.ExactRigidBodyIntegrator(0.001, kicked))
    _, whole = moved(rb.ExactRigidBodyIntegrator(0.001, scheme_of(KICK), engine="host"))
    assert 0.4 < np.linalg.norm(half.P - before.P) / np.linalg.norm(whole.P - before.P) < 0.6


def test_a_method_of_an_instance_belongs_to_this_instance():
    substep = of_instance()
    assert substep == copy.deepcopy(substep) != KICK == Kick() == pickle.loads(pickle.dumps(KICK))
    assert NoKick() == NoKick() != KICK
    assert Decorated(None, 1.0) != Decorated(None, 2.0)
    assert len({KICK, Kick(), Kick(1), Kick(1), NoKick(), substep}) == 4
    with pytest.raises(ValueError, match="the inner scheme mine must consist only of drifts and kicks"):
        rb.ExactRigidBodyIntegrator(0.002, fast="bonded", inner=scheme_of(substep))


def test_a_heat_exchange_keeps_its_class():
    class NoExchange(HeatExchange):
        def bind(self, environment):
            return idle(environment)

    rows = ((KICK, 0.5), (DRIFT, 0.5), (NoExchange(), 1.0), (DRIFT, 0.5), (KICK, 0.5))
    thermostat = Langevin(300.0, 50.0)
    _, without = moved(rb.ExactRigidBodyIntegrator(0.001, scheme_of(KICK), engine="host"))
    _, idling = moved(rb.ExactRigidBodyIntegrator(0.001, Scheme("mine", 2, rows), thermostat=thermostat))
    for one, other in zip(idling, without, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)


def shifting(base, *arguments):
    """Return a substep whose flow moves the centres at constant velocities."""

    def bind(self, environment):
        def flow(state, tau):
            R = state.R.copy()
            R[0, 0] += 3.0 * tau * np.arange(R.shape[2])
            return state._replace(R=R)

        return flow

    return type("Shift", (base,), {"bind": bind})(*arguments)


@pytest.mark.parametrize("base", [Substep, Drift, Kick, GradientKick, HeatExchange])
def test_forces_follow_the_positions_of_a_flow_that_was_overridden(base):
    """Flags that describe the flow of the base class do not keep the forces of other positions."""
    shift = shifting(Substep)
    told = Scheme("told", 2, ((KICK, 0.5), (shift, 1.0), (KICK, 0.5)))
    expected = moved(rb.ExactRigidBodyIntegrator(0.001, told, engine="host"))
    own = shifting(base, 0.0) if base is GradientKick else shifting(base)
    options = {"thermostat": Langevin(300.0, 0.0)} if base is HeatExchange else {}
    scheme = Scheme("mine", 2, ((KICK, 0.5), (own, 1.0), (KICK, 0.5)))
    found = moved(rb.ExactRigidBodyIntegrator(0.001, scheme, **options))
    for one, other in zip(found[1], expected[1], strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.abs(found[1].R - found[0].R).max() > 0.01


# -- other descriptions -----------------------------------------------------------------------------------------------


def test_an_oscillator_that_is_overridden_with_its_flow_is_used():
    class Doubled(Kick):
        def bind(self, environment):
            kick = super().bind(environment)
            return lambda state, tau: kick(state, 2.0 * tau)

        def oscillator(self, tau):
            return super().oscillator(2.0 * tau)

    scheme = Scheme("mine", 2, ((Doubled(), 0.5), (DRIFT, 1.0), (Doubled(), 0.5)))
    assert stability_limit(scheme) == pytest.approx(2.0**0.5, abs=2e-4)
    assert stability_limit(scheme_of(KICK)) == pytest.approx(2.0, abs=2e-4)


def test_no_class_of_the_package_contradicts_itself():
    made = (Drift(), Kick(), GradientKick(0.1), LastForcesKick((1.0,)), HeatExchange())
    assert not any(mismatch(s, "kernel_moves", "bind") for s in made)
    assert not any(mismatch(s, "oscillator", "bind") for s in made if not isinstance(s, LastForcesKick))
    ours = Langevin(300, 1), StochasticRescaling(300, 1), NoseHooverChain(300, 1), HybridMonteCarlo(300, 1)
    assert not any(mismatch(t, "kernel_exchange", *t.flows) for t in ours)
