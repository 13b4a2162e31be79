"""What describes a flow to the host and to the kernels is overridden together, in whatever way, or an error says so."""

import copy
from dataclasses import dataclass, field

import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.substeps import DRIFT, KICK, Drift, GradientKick, HeatExchange, Kick, LastForcesKick, Substep
from openmm_exactrb.support.descriptions import mismatch, unperformed
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin, NoseHooverChain, StochasticRescaling
from products import spread_over

ORIGINALS = {
    "drift": Drift("all"),
    "kick": Kick(),
    "kick of a group": Kick(3),
    "gradient": GradientKick(0.1),
    "stored": LastForcesKick((1.0,)),
    "exchange": HeatExchange(),
    "Langevin": Langevin(300.0, 5.0),
    "rescaling": StochasticRescaling(300.0, 0.1),
    "chain": NoseHooverChain(300.0, 5.0),
}
# The kernels of each kind, and the methods that define its flow.
KERNELS = {name: "kernel_moves" if isinstance(one, Substep) else "kernel_exchange" for name, one in ORIGINALS.items()}
FLOWS = {name: getattr(one, "flows", ("bind",)) for name, one in ORIGINALS.items()}
ALONE = [(name, method) for name in ORIGINALS for method in (*FLOWS[name], KERNELS[name])]


def method_of(original, name):
    """Return a function that does what the method of an object does."""
    method = getattr(original, name)
    return lambda self, *arguments: method(*arguments)


def alike(kind, original):
    """Return an object of a class with the values of another object."""
    made = object.__new__(kind)
    for name, value in vars(original).items():
        object.__setattr__(made, name, value)
    return made


def _mixed(base, methods):
    return type("Mine", (type("Mixin", (), methods), base), {})


def _patched(base, methods):
    """Return a class that defined everything, and in which these methods were replaced."""
    kind = type("Mine", (base,), {name: getattr(base, name) for name in dir(base) if name in METHODS})
    for name, method in methods.items():
        setattr(kind, name, method)
    return kind


def _extended(base, methods):
    kind = type("Mine", (base,), {})
    for name, method in methods.items():
        setattr(kind, name, method)
    return kind


def _dataclass(base, methods):
    own = field(default=1.0, kw_only=True)
    return dataclass(frozen=True)(type("Mine", (base,), {"own": own, "__annotations__": {"own": float}, **methods}))


METHODS = {"bind", "flow", "moved", "kernel_moves", "kernel_exchange"}
CLASSES = {
    "subclass": lambda base, methods: type("Mine", (base,), methods),
    "grandchild": lambda base, methods: type("Mine", (type("Mine", (base,), methods),), {}),
    "mixin": _mixed,
    "mixin of a mixin": lambda base, methods: type("Mine", (type("M", (type("M", (), methods),), {}), base), {}),
    "mixin of a subclass": lambda base, methods: _mixed(type("Between", (base,), {}), methods),
    "dataclass": _dataclass,
    "patched": _patched,
    "extended": _extended,
}


def overriding(way, original, *names):
    """Return an object that overrides methods of another in some way."""
    if way == "instance":
        made = copy.copy(original)
        for name in names:
            object.__setattr__(made, name, getattr(original, name))
        return made
    methods = {name: method_of(original, name) for name in names}
    return alike(CLASSES[way](type(original), methods), original)


def integrator_of(thing, **arguments):
    """Return an integrator with a substep or a thermostat."""
    if not isinstance(thing, Substep):
        return rb.ExactRigidBodyIntegrator(0.001, "S2_2", thermostat=thing, **arguments)
    middle = ((DRIFT, 0.5), (thing, 1.0), (DRIFT, 0.5)) if isinstance(thing, HeatExchange) else ((DRIFT, 1.0),)
    rows = (KICK, 0.5), *middle, (KICK, 0.5)
    thermostat = Langevin(300.0, 1.0) if isinstance(thing, HeatExchange) else None
    if isinstance(thing, LastForcesKick):
        V2 = rb.SCHEMES["V2_drift"].sequence
        scheme = Scheme("mine", 2, V2, processor=((DRIFT, 0.1),), output=((DRIFT, -0.1), (thing, 0.1)))
        return rb.ExactRigidBodyIntegrator(0.001, scheme, **arguments)
    if not isinstance(thing, HeatExchange):
        rows = (thing, 0.5), *rows, (thing, 0.5)
    return rb.ExactRigidBodyIntegrator(0.001, Scheme("mine", 2, rows), thermostat=thermostat, **arguments)


@spread_over({"name, method": ALONE, "way": [*CLASSES, "instance"]}, times=4)
def test_one_of_two_descriptions_that_is_overridden_alone(name, method, way):
    """A new flow is left to the host, and new kernels without their flow are an error with every engine."""
    thing, kernel = overriding(way, ORIGINALS[name], method), KERNELS[name]
    if method == kernel:
        for engine in ("host", "native", "auto"):
            with pytest.raises(ValueError, match=rf"overrides {kernel}\(\) but inherits bind\(\).*: override bind\(\)"):
                integrator_of(thing, engine=engine)
    else:
        why = rf"overrides {method}\(\) but inherits {kernel}\(\).*: override {kernel}\(\)"
        with pytest.raises(ValueError, match=why):
            integrator_of(thing, engine="native")
        left = integrator_of(thing)
        assert (left.getEngine(), f"overrides {method}()" in left.engineNote()) == ("host", True)


@spread_over({"name": ORIGINALS, "way": [*CLASSES, "instance"]}, times=4)
def test_both_descriptions_belong_together(name, way):
    for flow in FLOWS[name]:
        thing = overriding(way, ORIGINALS[name], flow, KERNELS[name])
        assert mismatch(thing, KERNELS[name], *FLOWS[name]) is None
        assert unperformed(thing, KERNELS[name], *FLOWS[name]) is None
        assert integrator_of(thing, engine="host").getEngine() == "host"


@pytest.mark.parametrize("base", [Drift, Kick, GradientKick, LastForcesKick, HeatExchange, Langevin, NoseHooverChain])
@pytest.mark.parametrize("which", ["flow", "kernels"])
def test_a_class_of_the_package_that_is_patched_is_noticed(monkeypatch, base, which):
    name = next(name for name, one in ORIGINALS.items() if type(one) is base)
    thing, kernel = ORIGINALS[name], KERNELS[name]
    patched, other = ("bind", kernel) if which == "flow" else (kernel, "bind")
    monkeypatch.setattr(base, patched, method_of(thing, patched))
    with pytest.raises(ValueError, match=rf"overrides {patched}\(\) but inherits {other}\(\)"):
        integrator_of(thing, engine="native")
    monkeypatch.undo()
    integrator_of(thing, engine="host")


@pytest.mark.parametrize(
    ("levels", "wrong"),
    [
        ("", None),
        ("b", "bind"),
        ("k", "kernel_moves"),
        ("bk both", None),
        ("b k", None),  # kernels for the flow of the base class
        ("k b", "bind"),
        ("b b k", None),
        ("b k k", "kernel_moves"),
        ("b k b", "bind"),
        ("b k b k", None),
        ("bk both k", "kernel_moves"),
        ("bk both b", "bind"),
        ("k both", None),
    ],
)
def test_what_a_line_of_classes_overrides(levels, wrong):
    kind = Kick
    for level in levels.split():
        names = {"b": ["bind"], "k": ["kernel_moves"]}.get(level, ["bind", "kernel_moves"])
        kind = type("Mine", (kind,), {name: getattr(Kick, name) for name in names})
    found = {"bind": mismatch, "kernel_moves": unperformed}
    assert [name for name, why in found.items() if why(kind(), "kernel_moves", "bind")] == [wrong] * bool(wrong)


def test_kernels_without_a_flow_and_no_kernels_contradict_nothing():
    class OfKernels(Substep):
        kernel_moves = Kick.kernel_moves

    class Again(OfKernels):
        kernel_moves = Kick.kernel_moves

    class NoKernels(Kick):
        def kernel_moves(self, part):
            return None

    assert [unperformed(one, "kernel_moves", "bind") for one in (OfKernels(), Again())] == [None, None]
    left = integrator_of(NoKernels())
    assert (left.getEngine(), "has no kernel" in left.engineNote()) == ("host", True)
    assert integrator_of(HybridMonteCarlo(300.0, 1.0)).getEngine() == "host"


@pytest.mark.parametrize("method", ["bind", "kernel_moves"])
def test_a_method_that_is_patched_after_an_integrator_was_made_is_noticed_at_the_next_context(monkeypatch, method):
    _, system, positions = rb.rigid_water(2)
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine="host")
    monkeypatch.setattr(Kick, method, method_of(Kick(), method))
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    if method == "bind":
        integrator.step(1)
    else:
        with pytest.raises(ValueError, match=r"Kick overrides kernel_moves\(\)"):
            integrator.step(1)
