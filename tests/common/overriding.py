"""Substeps and thermostats that override one description of their flow, and how they move two water molecules."""

import copy
from dataclasses import dataclass

import openmm

import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.substeps import DRIFT, Drift, GradientKick, HeatExchange, Kick, LastForcesKick
from openmm_exactrb.thermostats import Langevin, NoseHooverChain, StochasticRescaling
from places import platform_for

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
