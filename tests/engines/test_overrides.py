"""A class that overrides one description of its flow, and not the others, has no flow but its own."""

import copy
import pickle
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import openmm
import pytest
from hypothesis import given
from hypothesis import strategies as st

import openmm_exactrb as rb
import starts
from on_device import platform_for
from openmm_exactrb.moves import Move, Op
from openmm_exactrb.schemes import Scheme, stability_limit
from openmm_exactrb.substeps import DRIFT, KICK, Drift, GradientKick, HeatExchange, Kick, LastForcesKick, Substep
from openmm_exactrb.support.descriptions import mismatch
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin, NoseHooverChain, StochasticRescaling

WATERS = rb.rigid_water(2)


def idle(environment):
    """Return the flow that does nothing."""
    return lambda state, tau: state


class Idle:
    """A mixin whose flow does nothing."""

    def bind(self, environment):
        return idle(environment)


class NoKick(Kick):
    def bind(self, environment):
        return idle(environment)


class Grandchild(NoKick):
    """Inherits the flow of one ancestor and the moves of another."""


class MixedIn(Idle, Kick):
    pass


class MixedInAhead(Idle):
    """A mixin above a mixin."""


class MixedInTwice(MixedInAhead, Kick):
    pass


@dataclass(frozen=True)
class Decorated(Kick):
    strength: float = 0.0

    def bind(self, environment):
        return idle(environment)


class Halved(Kick):
    """Half a kick, by the flow of the base class."""

    def bind(self, environment):
        kick = super().bind(environment)
        return lambda state, tau: kick(state, 0.5 * tau)


class ByAttribute(Kick):
    bind = Idle.bind


class NoGradientKick(GradientKick, Idle):
    bind = Idle.bind


class NoLastKick(LastForcesKick):
    def bind(self, environment):
        return idle(environment)


def of_instance():
    """Return a kick with a method of its own."""
    substep = Kick()
    object.__setattr__(substep, "bind", idle)
    return substep


SUBSTEPS = {
    "subclass": NoKick(),
    "grandchild": Grandchild(),
    "mixin": MixedIn(),
    "mixin of a mixin": MixedInTwice(),
    "dataclass": Decorated(),
    "super": Halved(),
    "attribute": ByAttribute(),
    "group": NoKick(3),
    "gradient": NoGradientKick(0.1),
    "stored": NoLastKick((1.0,)),
    "drift": type("NoDrift", (Idle, Drift), {})(),
    "exchange": type("NoExchange", (Idle, HeatExchange), {})(),
    "instance": of_instance(),
}


def scheme_of(substep):
    """Return a scheme in which a substep replaces the kicks of Verlet's."""
    return Scheme("mine", 2, ((substep, 0.5), (DRIFT, 1.0), (substep, 0.5)))


def note_of(integrator):
    """Return why an integrator is left to the host, whatever the Context."""
    assert integrator.getEngine() == "host"  # which is settled, because no other engine serves it
    return integrator.engineNote()


def moved(integrator, engine="host", n=5, platform=None):
    """Return the states of two water molecules before and after n steps."""
    _, system, positions = WATERS
    context = openmm.Context(copy.deepcopy(system), integrator, *platform_for(platform or engine))
    context.setPositions(positions)
    integrator.setVelocitiesToTemperature(300.0, 1)
    before = integrator.bodyState()[1]
    integrator.step(n)
    assert integrator.getEngine() == engine
    return before, integrator.bodyState()[1]


# -- the device refuses what only the host knows ----------------------------------------------------------------------


@pytest.mark.parametrize("substep", SUBSTEPS.values(), ids=SUBSTEPS)
@pytest.mark.parametrize("place", ["sequence", "processor", "output"])
def test_a_substep_that_overrides_its_flow_alone_is_left_to_the_host(substep, place):
    rows = ((substep, 0.5), (DRIFT, 1.0), (substep, 0.5))
    verlet = ((KICK, 0.5), (DRIFT, 1.0), (KICK, 0.5))
    options, processor = {}, {"processor": verlet}
    if isinstance(substep, HeatExchange):  # not within processors
        options, processor, place = {"thermostat": Langevin(300.0, 1.0)}, {}, "sequence"
    scheme = Scheme("mine", 2, **({"sequence": verlet} | processor | {place: rows}))
    why = rf"{type(substep).__name__} overrides bind\(\) but inherits device_moves\(\)"
    with pytest.raises(ValueError, match=why):
        rb.ExactRigidBodyIntegrator(0.001, scheme, engine="device", **options)
    left = rb.ExactRigidBodyIntegrator(0.001, scheme, **options)
    assert note_of(left).startswith(f"{type(substep).__name__} overrides bind()")


def no_exchange(self, environment):
    return lambda P, m, tau, at: (P, m)


def of_no_class():
    thermostat = Langevin(300.0, 1.0)
    object.__setattr__(thermostat, "bind", lambda environment: no_exchange(None, environment))
    return thermostat


def overriding(base, *names):
    """Return a subclass of a thermostat that exchanges no heat, by the methods of these names."""
    methods = {"bind": no_exchange, "flow": lambda self, environment, number: lambda state, tau: state}
    others = {"moved": lambda self, chain, kinetic, freedom, tau: (1.0, chain)}
    return type(f"No{base.__name__}", (base,), {name: (methods | others)[name] for name in names})


THERMOSTATS = {
    "Langevin": overriding(Langevin, "bind")(300.0, 5.0),
    "Langevin, flow": overriding(Langevin, "flow")(300.0, 5.0),
    "Langevin, mixin": type("Mixed", (type("M", (), {"bind": no_exchange}), Langevin), {})(300.0, 5.0),
    "Langevin, grandchild": type("Grand", (overriding(Langevin, "bind"),), {})(300.0, 5.0),
    "Langevin, instance": of_no_class(),
    "rescaling": overriding(StochasticRescaling, "bind")(300.0, 0.1),
    "rescaling, flow": overriding(StochasticRescaling, "flow")(300.0, 0.1),
    "chain": overriding(NoseHooverChain, "bind")(300.0, 5.0),
    "chain, flow": overriding(NoseHooverChain, "flow")(300.0, 5.0),
    "chain, moved": overriding(NoseHooverChain, "moved")(300.0, 5.0),
}


@pytest.mark.parametrize("thermostat", THERMOSTATS.values(), ids=THERMOSTATS)
def test_a_thermostat_that_overrides_its_exchange_alone_is_left_to_the_host(thermostat):
    with pytest.raises(ValueError, match=r"overrides (bind|flow|moved)\(\) but inherits kernel_exchange\(\)"):
        rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine="device", thermostat=thermostat)
    left = rb.ExactRigidBodyIntegrator(0.001, "S2_2", thermostat=thermostat)
    assert "but inherits kernel_exchange()" in note_of(left)
    left.setRandomNumberSeed(5)
    _, with_it = moved(left)
    _, without = moved(rb.ExactRigidBodyIntegrator(0.001, "S2_2"))
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
    _, whole = moved(rb.ExactRigidBodyIntegrator(0.001, scheme_of(KICK)))
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
    _, without = moved(rb.ExactRigidBodyIntegrator(0.001, scheme_of(KICK)))
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
    expected = moved(rb.ExactRigidBodyIntegrator(0.001, Scheme("told", 2, ((KICK, 0.5), (shift, 1.0), (KICK, 0.5)))))
    own = shifting(base, 0.0) if base is GradientKick else shifting(base)
    options = {"thermostat": Langevin(300.0, 0.0)} if base is HeatExchange else {}
    scheme = Scheme("mine", 2, ((KICK, 0.5), (own, 1.0), (KICK, 0.5)))
    found = moved(rb.ExactRigidBodyIntegrator(0.001, scheme, **options))
    for one, other in zip(found[1], expected[1], strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.abs(found[1].R - found[0].R).max() > 0.01


# -- overriding both works on both ------------------------------------------------------------------------------------


class HalfKick(Halved):
    def device_moves(self, part):
        return super().device_moves(0.5 * part)


class SlowDrift(Drift):
    def bind(self, environment):
        drift = super().bind(environment)
        return lambda state, tau: drift(state, 0.7 * tau)

    def device_moves(self, part):
        return super().device_moves(0.7 * part)


class OneMethod(Kick):
    """A kick whose moves alone were written anew, with the same flow."""

    def device_moves(self, part):
        return (Move(Op.KICK, 0.25 * part, groups=-1), Move(Op.KICK, 0.75 * part, groups=-1))


class Stronger(Langevin):
    """Twice the friction, by both methods."""

    def _doubled(self):
        return Langevin(self.temperature, 2.0 * self.friction)

    def bind(self, environment):
        return self._doubled().bind(environment)

    def kernel_exchange(self, tau, freedom):
        return self._doubled().kernel_exchange(tau, freedom)


class Shared(Langevin):
    """Twice the friction, by what both methods read."""

    @property
    def frictions(self):
        return 2.0 * self.friction, 2.0 * self.friction


class Faster(StochasticRescaling):
    """Half the relaxation time."""

    def _faster(self):
        return StochasticRescaling(self.temperature, 0.5 * self.relaxationTime)

    def bind(self, environment):
        return self._faster().bind(environment)

    def kernel_exchange(self, tau, freedom):
        return self._faster().kernel_exchange(tau, freedom)


BOTH = {
    "kick": (scheme_of(HalfKick()), None),
    "drift": (Scheme("mine", 2, ((KICK, 0.5), (SlowDrift(), 1.0), (KICK, 0.5))), None),
    "moves": (scheme_of(OneMethod()), None),
    "friction": ("S2_2", Stronger(300.0, 10.0)),
    "shared": ("S2_2", Shared(300.0, 10.0)),
    "rescaling": ("S2_2", Faster(300.0, 0.02)),
}


@pytest.mark.opencl
@pytest.mark.parametrize("name", BOTH)
def test_a_flow_that_is_overridden_with_its_moves_is_the_same_on_both_engines(name):
    scheme, thermostat = BOTH[name]
    found = []
    for engine in ("host", "device"):
        integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine=engine, thermostat=thermostat)
        integrator.setRandomNumberSeed(3)
        found.append(moved(integrator, engine, 20, "device")[1])
    for host, device in zip(*found, strict=True):
        np.testing.assert_allclose(device, host, rtol=0.0, atol=1e-10)


@pytest.mark.opencl
def test_drifts_of_ones_own_have_no_inner_steps_that_openmm_evaluates():
    """Their moves would be those of the package."""
    system = starts.system_of([12.0, 16.0, 12.0])
    bonds = openmm.CustomBondForce("k*(r-0.12)^4")
    bonds.addGlobalParameter("k", 1e7)
    bonds.addBond(0, 1, [])
    bonds.setForceGroup(1)
    system.addForce(bonds)
    slow = openmm.CustomBondForce("100*(r-0.2)^2")
    slow.addBond(1, 2, [])
    system.addForce(slow)
    scheme = BOTH["drift"][0]
    integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine="device", fast=(1,), innerSteps=4)
    context = openmm.Context(system, integrator, *platform_for("device"))
    context.setPositions([[0, 0, 0], [0.12, 0, 0], [0.32, 0, 0]])
    with pytest.raises(ValueError, match=r"no kernel for .* which the drifts .*SlowDrift.* of mine need"):
        integrator.step(1)


# -- other descriptions -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("substep", [NoKick(), MixedIn(), Halved(), SUBSTEPS["instance"]], ids=repr)
def test_an_oscillator_of_another_flow_is_an_error(substep):
    with pytest.raises(ValueError, match=r"overrides bind\(\) but inherits oscillator\(\)"):
        rb.schemes.stability.oscillated(scheme_of(substep).sequence, 0.1)


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


@pytest.mark.parametrize("thermostat", [t for n, t in THERMOSTATS.items() if n.startswith("Langevin")], ids=repr)
def test_averages_of_another_exchange_are_not_corrected_as_those_of_langevin_dynamics(thermostat, tmp_path):
    integrator = rb.ExactRigidBodyIntegrator(0.002, thermostat=thermostat)
    simulation = starts.simulation_of(*WATERS[:2], integrator, WATERS[2], kelvin=300.0)
    simulation.reporters.append(rb.AverageReporter(tmp_path / "averages.csv", 1))
    with pytest.raises(ValueError, match="averages can be corrected only for Langevin dynamics"):
        simulation.step(1)


def test_no_class_of_the_package_contradicts_itself():
    made = (Drift(), Kick(), GradientKick(0.1), LastForcesKick((1.0,)), HeatExchange())
    assert not any(mismatch(s, "device_moves", "bind") for s in made)
    assert not any(mismatch(s, "oscillator", "bind") for s in made if not isinstance(s, LastForcesKick))
    ours = Langevin(300, 1), StochasticRescaling(300, 1), NoseHooverChain(300, 1), HybridMonteCarlo(300, 1)
    assert not any(mismatch(t, "kernel_exchange", *t.flows) for t in ours)


# -- the rule ---------------------------------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), min_size=1, max_size=6), st.booleans())
def test_a_description_belongs_to_the_flow_that_was_last_defined_with_or_before_it(classes, of_its_own):
    """Going down the classes, each flow outdates the description, and each description describes the present flow."""

    class Base:
        symbol: ClassVar[str] = "?"

        def flow(self):
            pass

        def description(self):
            pass

    kind, valid = Base, True
    for flow, description, mixed_in in classes:
        methods = {name: lambda self: None for name, has in (("flow", flow), ("description", description)) if has}
        bases = (type("Mixin", (), methods), kind) if mixed_in else (kind,)
        kind = type("Derived", bases, {} if mixed_in else methods)
        valid = description or (valid and not flow)
    thing = kind()
    if of_its_own:
        object.__setattr__(thing, "flow", lambda: None)
        valid = False
    assert (mismatch(thing, "description", "flow") is None) == valid
