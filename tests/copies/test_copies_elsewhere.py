"""Integrators that another process reads, that OpenMM holds without Python, and integrators that are not ours."""

import copy
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app
from test_copies import OWN, Labelled

import openmm_exactrb as rb
from every_integrator import KINDS, MOVING, ends, every, made, seeded
from openmm_exactrb.library.library import of_library
from openmm_exactrb.openmm_access import settings_text
from places import CPU, REFERENCE, device_platform
from starts import context_of, positions_of, put, velocities_of

ROOT = Path(__file__).parents[2]


def run(script, *arguments):
    """Return what a new process prints."""
    paths = os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "common")))
    command = [sys.executable, "-c", script, *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": paths, "PYTHONUTF8": "1"}
    options: dict = {"capture_output": True, "encoding": "utf-8", "check": False, "timeout": 300}
    done = subprocess.run(command, env=environment, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


# -- other processes --------------------------------------------------------------------------------------------------

READ = """
import sys
from pathlib import Path
import openmm
import openmm_exactrb
for file in sys.argv[1:]:
    before = set(sys.modules)
    try:
        integrator = openmm.XmlSerializer.deserialize(Path(file).read_text(encoding="utf-8"))
        print(type(integrator).__name__, integrator.getSettings())
    except Exception as error:
        print(type(error).__name__, error)
        assert set(sys.modules) == before
"""
STEP = """
from every_integrator import *
from starts import REFERENCE
for file in sys.argv[1:]:
    integrator = openmm.XmlSerializer.deserialize(Path(file).read_text(encoding="utf-8"))
    print(ends(Path(file).stem, integrator, REFERENCE, {}).tobytes().hex())
"""


def written(folder, integrators):
    """Return files with the XML of integrators, given by name."""
    files = [folder / f"{name}.xml" for name in integrators]
    for file, integrator in zip(files, integrators.values(), strict=True):
        file.write_text(openmm.XmlSerializer.serialize(integrator), encoding="utf-8")
    return files


def test_a_new_process_reads_the_same_settings(tmp_path):
    with_text = [one for one in every() if not one.getSettings()["arguments"]["constraints"]]
    integrators = dict(enumerate([*with_text, *map(made, KINDS)]))
    lines = run(READ, *written(tmp_path, integrators)).splitlines()
    for integrator, line in zip(integrators.values(), lines, strict=True):
        assert line == f"{type(integrator).__name__} {integrator.getSettings()}"


def test_a_new_process_makes_the_same_steps(tmp_path):
    integrators = {name: seeded(integrator) for name, (integrator, _) in MOVING.items()}
    lines = run(f"import sys\nfrom pathlib import Path\nimport openmm{STEP}", *written(tmp_path, integrators))
    for (name, integrator), line in zip(integrators.items(), lines.splitlines(), strict=True):
        assert line == ends(name, integrator, REFERENCE, {}).tobytes().hex()


def test_a_new_process_refuses_what_only_this_one_has(tmp_path):
    integrators = {name: make() for name, make in OWN.items()} | {"class": Labelled("a", 0)}
    lines = dict(zip(integrators, run(READ, *written(tmp_path, integrators)).splitlines(), strict=True))
    for name, what in {
        "scheme": "Scheme mine",
        "inner": "Scheme mine",
        "rotor": "Rotor slow",
        "thermostat": "Warmer",
        "constraints": "function unconstrained",
    }.items():
        assert lines[name] == (
            f"ValueError this integrator has your own {what}, which only the process that wrote the integrator can "
            "copy: create the integrator again, with openmm_exactrb"
        )
    for name in ("attribute", "class"):
        assert lines[name].startswith("ValueError the class test_copies.Labelled of this integrator does not exist in")


def changed(integrator, **parts):
    """Return the XML of an integrator in whose text some parts were changed."""
    plain = openmm.CustomIntegrator(0.002)
    settings_text.write(plain, json.dumps(json.loads(settings_text.read(integrator)) | parts))
    return openmm.XmlSerializer.serialize(plain)


# -- steps by C++ alone -----------------------------------------------------------------------------------------------

ALONE = r"OpenMM alone cannot perform the steps of this integrator of openmm_exactrb: import openmm_exactrb before"
WITHOUT = """
import sys
from pathlib import Path
import openmm
system, state = (openmm.XmlSerializer.deserialize(Path(file).read_text()) for file in sys.argv[1:3])
try:
    integrator = openmm.XmlSerializer.deserialize(Path(sys.argv[3]).read_text())
except openmm.OpenMMException as error:  # of the library's integrators, which OpenMM alone cannot read
    print(error)
    sys.exit()
context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
context.setState(state)
try:
    integrator.step(3)
except openmm.OpenMMException as error:
    print(error)
after = context.getState(positions=True, velocities=True)
print(after.getPositions() == state.getPositions(), after.getVelocities() == state.getVelocities())
"""


def test_a_process_without_the_package_says_what_to_import(periodic_water, tmp_path):
    system, state = periodic_water
    files = [tmp_path / f"{name}.xml" for name in ("system", "state", "integrator")]
    for file, content in zip(files, (system, state, made()), strict=True):
        file.write_text(openmm.XmlSerializer.serialize(content), encoding="utf-8")
    error, *unchanged = run(WITHOUT, *files).splitlines()
    if of_library(made()):
        assert "openmm_exactrb (import this package before you read its integrators)" in error
    else:
        assert ALONE in error
        assert unchanged == ["True True"]


@pytest.fixture(scope="module")
def periodic_water():
    """Return a System with PME, and a State."""
    _, system, positions = rb.rigid_water(64, nonbondedMethod=app.PME, nonbondedCutoff=0.6)
    context = context_of(system, openmm.VerletIntegrator(0.001), positions, kelvin=300.0)
    return system, context.getState(positions=True, velocities=True)


def without_python(integrator):
    """Return what OpenMM makes of the XML of an integrator where this package is not imported."""
    text = openmm.XmlSerializer.serialize(integrator)
    return openmm._openmm.XmlSerializer__deserializeIntegrator(text)  # noqa: SLF001


def in_a_compound(integrator):
    compound = openmm.CompoundIntegrator()
    compound.addIntegrator(integrator)
    return compound


def in_a_compound_from_xml(integrator):
    return openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(in_a_compound(integrator)))


@pytest.mark.skipif(of_library(made()), reason="with the package's library, OpenMM performs the steps")
@pytest.mark.parametrize("hold", [without_python, in_a_compound, in_a_compound_from_xml])
@pytest.mark.parametrize("platform", ["Reference", "CPU", ""])
def test_steps_by_openmm_alone_are_an_error_and_change_nothing(hold, platform, periodic_water):
    system, state = periodic_water
    holder = hold(made())
    place = openmm.Platform.getPlatform(platform) if platform else device_platform()
    context = openmm.Context(system, holder, place)
    put(context, state)
    before = positions_of(context), velocities_of(context)
    # On a device, OpenMM itself has no error with a text of the integrator's own.
    message = ALONE if platform else f"{ALONE}|Step size cannot be negative"
    for _ in range(2):
        with pytest.raises(openmm.OpenMMException, match=message):
            holder.step(3)
    assert (context.getStepCount(), context.getTime()._value) == (0, 0.0)
    np.testing.assert_array_equal((positions_of(context), velocities_of(context)), before)
    assert np.isfinite(context.getState(energy=True).getPotentialEnergy()._value)


@pytest.mark.skipif(of_library(made()), reason="with the package's library, OpenMM performs the steps")
@pytest.mark.parametrize("platform", [REFERENCE, CPU], ids=["Reference", "CPU"])
def test_the_other_parts_of_a_compound_go_on(platform, periodic_water):
    system, state = periodic_water
    ends_of = []
    for ours_too in (False, True):
        compound = openmm.CompoundIntegrator()
        compound.addIntegrator(openmm.VerletIntegrator(0.001))
        if ours_too:
            compound.addIntegrator(made())
        context = openmm.Context(system, compound, platform)
        put(context, state)
        compound.step(2)
        if ours_too:
            compound.setCurrentIntegrator(1)
            with pytest.raises(openmm.OpenMMException, match=ALONE):
                compound.step(1)
            compound.setCurrentIntegrator(0)
        compound.step(2)
        ends_of.append(positions_of(context))
    np.testing.assert_allclose(*ends_of, rtol=0.0, atol=0.0 if platform is REFERENCE else 1e-6)


# -- parts of compounds, and integrators of others --------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["host", "native"])
def test_a_part_of_a_compound_is_of_our_class_and_can_be_changed(engine):
    integrator = made(rb.ExactRigidBodyLangevinIntegrator, rotationalFriction=3.0, engine=engine)
    integrator.setRandomNumberSeed(5)
    integrator.setIntegrationForceGroups({1})
    settings = integrator.getSettings()
    compound = in_a_compound(integrator)
    part = compound.getIntegrator(0)
    assert (type(part), part.getSettings()) == (rb.ExactRigidBodyLangevinIntegrator, settings)
    part.setTemperature(320.0)
    compound.setStepSize(0.003)
    del part
    changed_to = settings["arguments"] | {"temperature": 320.0, "stepSize": 0.003}
    for one in (
        compound,
        openmm.XmlSerializer.clone(compound),
        in_a_compound_from_xml(copy.copy(compound.getIntegrator(0))),
    ):
        assert one.getIntegrator(0).getSettings() == settings | {"arguments": changed_to}
    with pytest.raises(ValueError, match="no Context yet"):
        compound.getIntegrator(0).step(1)


def custom():
    integrator = openmm.CustomIntegrator(0.001)
    integrator.addGlobalVariable("stored", 0.0)
    integrator.setKineticEnergyExpression("m*v*v/2; a=1")
    return integrator


THEIRS = [
    lambda: openmm.CustomIntegrator(0.001),
    custom,
    lambda: openmm.VerletIntegrator(0.001),
    lambda: openmm.LangevinMiddleIntegrator(300, 1, 0.001),
    lambda: openmm.BrownianIntegrator(300, 1, 0.001),
    lambda: openmm.NoseHooverIntegrator(300, 1, 0.001),
    lambda: openmm.VariableVerletIntegrator(0.001),
    lambda: openmm.MTSLangevinIntegrator(300, 1, 0.001, [(0, 1), (1, 2)]),
    lambda: in_a_compound(openmm.VerletIntegrator(0.001)),
]


@pytest.mark.parametrize("make", THEIRS)
def test_other_integrators_are_those_that_openmm_returns(make):
    text = openmm.XmlSerializer.serialize(make())
    compound = in_a_compound(make())
    original = openmm._openmm  # noqa: SLF001
    for ours, theirs in (
        (openmm.XmlSerializer.clone(make()), original.XmlSerializer__cloneIntegrator(make())),
        (openmm.XmlSerializer.deserialize(text), original.XmlSerializer__deserializeIntegrator(text)),
        (compound.getIntegrator(0), original.CompoundIntegrator_getIntegrator(compound, 0)),
    ):
        assert (type(ours), ours.thisown) == (type(theirs), theirs.thisown)
        assert openmm.XmlSerializer.serialize(ours) == text
    assert int(compound.getIntegrator(0).this) == int(original.CompoundIntegrator_getIntegrator(compound, 0).this)
