"""The record of an engine is all that the package knows of it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.engines import ENGINES
from openmm_exactrb.runs.checkpoint import Checkpoint
from places import REFERENCE

PACKAGE = Path(rb.__file__).parent
HOST = ENGINES["host"]


def moving_water(integrator, seed=1):
    """Return the Context of a few water molecules in motion."""
    _, system, positions = rb.rigid_water(3)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    integrator.setRandomNumberSeed(7)
    integrator.setVelocitiesToTemperature(300.0, seed)
    return context


def stepped(context, n=5):
    """Return the state after some steps, as sums."""
    context.getIntegrator().step(n)
    return context.getIntegrator().fullState()[1]


@pytest.fixture
def own(monkeypatch):
    """Register the host's engine under another name; return what it was asked."""
    asked = []

    def unsupported(settings):
        asked.append("settings")
        return "it does not serve V2" if settings.outer.name == "V2" else None

    def unsupported_in(context, settings):
        asked.append("context")
        return "steps are too long" if settings.h > 0.01 else None

    def advice(context, settings):
        asked.append("advice")
        return settings.h < 0.005, "its steps are short"

    engine = replace(HOST, name="own", unsupported=unsupported, unsupported_in=unsupported_in, advice=advice)
    monkeypatch.setitem(ENGINES, "native", replace(ENGINES["native"], advice=lambda *_: (False, "not here")))
    monkeypatch.setitem(ENGINES, "own", engine)
    return asked


@pytest.mark.parametrize("kind", ["plain", "Langevin"])
def test_an_engine_that_is_registered_makes_the_steps_that_are_asked_of_it(own, kind):
    states = []
    for engine in ("own", "host"):
        arguments = (0.002, "S2_2") if kind == "plain" else (300.0, 1.0, 0.002, "BAOA")
        make = rb.ExactRigidBodyIntegrator if kind == "plain" else rb.ExactRigidBodyLangevinIntegrator
        context = moving_water(integrator := make(*arguments, engine=engine))
        states.append(stepped(context))
        assert integrator.getEngine() == engine
        assert integrator.engineNote().startswith(f'engine="{engine}" was asked for; ')
    assert "settings" in own
    for one, other in zip(*states, strict=True):
        np.testing.assert_array_equal(one, other)


def test_auto_takes_the_first_that_serves_and_pays(own):
    cases = (0.002, "S2_2", "own"), (0.007, "S2_2", "host"), (0.02, "S2_2", "host"), (0.002, "V2", "host")
    for h, scheme, name in cases:
        integrator = rb.ExactRigidBodyIntegrator(h, scheme)
        context = moving_water(integrator)
        assert integrator.getEngine() == name
        assert integrator.engineNote().startswith("its steps are short; ") == (name == "own")
        stepped(context, 1)


def test_what_an_engine_does_not_serve_is_an_error_where_it_was_asked_for(own):
    with pytest.raises(ValueError, match=r"it does not serve V2: use engine='host' instead"):
        rb.ExactRigidBodyIntegrator(0.002, "V2", engine="own")
    integrator = rb.ExactRigidBodyIntegrator(0.02, "S2_2", engine="own")
    assert "settings" in own
    with pytest.raises(ValueError, match=r"steps are too long: use engine='host' instead"):
        moving_water(integrator)
    integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", engine="own")
    context = moving_water(integrator)
    stepped(context, 1)
    with pytest.raises(ValueError, match="steps are too long"):
        integrator.setStepSize(0.02)
    assert integrator.getStepSize()._value == 0.002
    stepped(context, 1)


def test_unknown_engines_are_an_error_with_those_that_there_are(own):
    with pytest.raises(ValueError, match="the engine 'gpu' is unknown: choose one of host, native, own, auto"):
        rb.ExactRigidBodyIntegrator(0.002, engine="gpu")


def test_the_former_name_of_the_native_engine_is_read():
    integrator = rb.ExactRigidBodyIntegrator(0.002, engine="device")
    assert integrator.getSettings() == rb.ExactRigidBodyIntegrator(0.002, engine="native").getSettings()
    run = Checkpoint(0, 0, 0.0, {}, {}, {"integrator engine": "device", "setting where": "device"}, b"")
    run.check_same_run({"integrator engine": "native", "setting where": "device"}, Path("run"))
    with pytest.raises(ValueError, match="in which setting where was device, but now it is native"):
        run.check_same_run({"integrator engine": "native", "setting where": "native"}, Path("run"))


def test_a_run_from_a_checkpoint_keeps_the_engine_whose_mark_it_has(own, monkeypatch):
    """An engine with a mark of its own, which the others report."""
    marked = replace(ENGINES["own"], marks=lambda settings: (8.0,))
    monkeypatch.setitem(ENGINES, "own", marked)
    integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", engine="host")
    context = moving_water(integrator)
    integrator.setGlobalVariable(0, 8.0)
    with pytest.raises(ValueError, match='from a run with engine="own"'):
        integrator.step(1)
    integrator.setGlobalVariable(0, 16.0)
    with pytest.raises(ValueError, match="another kind of integrator"):
        integrator.step(1)
    integrator.setGlobalVariable(0, 0.0)
    stepped(context, 1)


def test_no_file_outside_of_the_engines_imports_one():
    inside = re.compile(r"^ *(?:from|import) openmm_exactrb\.engines\.(?:host|native)", re.M)
    for file in PACKAGE.rglob("*.py"):
        name = file.relative_to(PACKAGE).as_posix()
        if not name.startswith("engines/"):
            assert not inside.search(file.read_text(encoding="utf-8")), name


@pytest.mark.parametrize("name", rb.SCHEMES)
def test_every_scheme_is_served_or_has_a_reason(name, monkeypatch):
    reasons = []
    for engine in list(ENGINES.values()):
        asked = replace(engine, unsupported=lambda settings, ask=engine.unsupported: reasons.append(ask(settings)))
        monkeypatch.setitem(ENGINES, engine.name, asked)
    rb.ExactRigidBodyIntegrator(0.002, name)
    assert len(reasons) == len(ENGINES)
    for why in reasons:
        assert why is None or (len(why) > 10 and not why.endswith(".")), why
