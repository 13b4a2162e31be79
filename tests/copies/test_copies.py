"""Copies of integrators, by Python and by OpenMM, within a process."""

import copy
import gc
import inspect
import itertools
import weakref
from dataclasses import dataclass, replace

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from every_integrator import KINDS, MOVING, WATER, WAYS, begun, ends, every, made, others, seeded, unconstrained
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.thermostats import Langevin
from places import REFERENCE, platform_for
from starts import context_of, positions_of, topology_of

# -- settings ---------------------------------------------------------------------------------------------------------


def test_the_table_has_every_argument():
    common = inspect.signature(rb.ExactRigidBodyIntegrator.__init__).parameters.keys() - {"self", "thermostat"}
    for kind in KINDS:
        asked = inspect.signature(kind.__init__).parameters.keys() - {"self", "options"}
        assert {name for name, _ in others(kind)} == asked | common


def test_different_settings_have_different_xml_and_equal_ones_the_same():
    texts = [openmm.XmlSerializer.serialize(one) for one in (*every(), *map(made, KINDS))]
    assert all(one != other for one, other in itertools.combinations(texts, 2))
    assert [openmm.XmlSerializer.serialize(one) for one in (*every(), *map(made, KINDS))] == texts


@pytest.mark.parametrize("way", WAYS)
def test_copies_have_every_setting(way):
    for integrator in every():
        twin = WAYS[way](integrator)
        assert type(twin) is type(integrator)
        assert twin.getSettings() == integrator.getSettings()
        assert openmm.XmlSerializer.serialize(twin) == openmm.XmlSerializer.serialize(integrator)


def setter_of(kind, argument):
    """Return the name of the method that changes the setting of an argument, or None."""
    names = (f"set{name[0].upper()}{name[1:]}" for name in (argument, argument.removesuffix("Coeff")))
    return next((name for name in names if hasattr(kind, name)), None)


SETTERS = [(kind, name) for kind in KINDS for name, value in others(kind) if setter_of(kind, name)]


@pytest.mark.parametrize(("kind", "argument"), dict.fromkeys(SETTERS))
def test_a_setting_that_was_changed_is_that_of_a_new_integrator(kind, argument):
    value = dict(others(kind))[argument]
    integrator = made(kind)
    getattr(integrator, setter_of(kind, argument))(value)
    text = openmm.XmlSerializer.serialize(made(kind, **{argument: value}))
    assert openmm.XmlSerializer.serialize(integrator) == text
    assert openmm.XmlSerializer.deserialize(text).getSettings() == integrator.getSettings()


def test_settings_of_openmm_are_copied_and_a_seed_only_if_it_was_set():
    integrator = made(rb.ExactRigidBodyLangevinIntegrator)
    integrator.setIntegrationForceGroups({0, 3, 31})
    integrator.setConstraintTolerance(1e-9)
    integrator.checkDivergence = False
    _context = context_of(WATER[0], integrator, WATER[1], kelvin=300.0)
    integrator.step(1)
    assert integrator.getSeedInUse()
    for way in WAYS.values():
        twin = way(integrator)
        assert twin.getSettings() == integrator.getSettings()
        assert twin.getIntegrationForceGroups() == integrator.getIntegrationForceGroups()
        assert twin.getSeedInUse() == 0
    integrator.setRandomNumberSeed(11)
    assert [way(integrator).getSeedInUse() for way in WAYS.values()] == [11] * len(WAYS)


# -- trajectories -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MOVING)
def test_copies_have_the_same_trajectory_to_the_last_bit(name):
    integrator, where = seeded(MOVING[name][0]), (REFERENCE, {})
    end = ends(name, seeded(integrator), *where)
    before = [way(integrator) for way in WAYS.values()]
    _context = begun(name, integrator, *where)
    integrator.step(3)
    for twin in (*before, *(way(integrator) for way in WAYS.values())):
        assert type(twin) is type(integrator)
        np.testing.assert_array_equal(ends(name, twin, *where), end)


@pytest.mark.parametrize("name", ["default", "thermostat", "ExactRigidBodyNoseHooverIntegrator"])
def test_copies_have_the_same_trajectory_with_the_native_engine(name):
    integrator, where = seeded(MOVING[name][0], engine="native"), platform_for("native")
    end = ends(name, seeded(integrator), *where)
    before = openmm.XmlSerializer.clone(integrator)
    _context = begun(name, integrator, *where)
    integrator.step(3)
    for twin in (before, WAYS["XML"](integrator)):
        assert type(twin) is type(integrator)
        np.testing.assert_array_equal(ends(name, twin, *where), end)


def test_a_simulation_reads_an_integrator_from_a_file(tmp_path):
    integrator = seeded(MOVING["thermostat"][0])
    file = tmp_path / "integrator.xml"
    file.write_text(openmm.XmlSerializer.serialize(integrator), encoding="utf-8")
    simulation = app.Simulation(topology_of(WATER[0]), WATER[0], str(file), REFERENCE)
    simulation.context.setPositions(WATER[1])
    simulation.context.setVelocitiesToTemperature(300.0, 1)
    simulation.step(4)
    np.testing.assert_array_equal(positions_of(simulation), ends("thermostat", integrator, REFERENCE, {})[0])


@pytest.mark.parametrize("name", ["default", "inner", "ExactRigidBodyLangevinIntegrator"])
def test_global_variables_may_be_set_to_zero_between_calls(name):
    """As tools do that keep Contexts for several integrators."""
    integrators = [seeded(MOVING[name][0]) for _ in "ab"]
    contexts = [begun(name, one, REFERENCE, {}) for one in integrators]
    for _ in range(3):
        for integrator in integrators:
            integrator.step(2)
        for k in range(integrators[0].getNumGlobalVariables()):
            integrators[0].setGlobalVariable(k, 0.0)
    np.testing.assert_array_equal(*map(positions_of, contexts))


# -- what a user adds -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Warmer(Langevin):
    """A thermostat of a user."""


class Labelled(rb.ExactRigidBodyLangevinIntegrator):
    """An integrator of a user, with attributes and arguments of its own."""

    def __init__(self, label, offset):
        self.offset = offset
        super().__init__(300.0, 5.0, 0.004, scheme="BAOAB")
        self.label = label


OWN_SCHEME = replace(rb.SCHEMES["V2"], name="mine")
OWN = {
    "scheme": lambda: made(scheme=replace(OWN_SCHEME)),
    "inner": lambda: made(inner=replace(OWN_SCHEME), innerSteps=4),
    "rotor": lambda: made(rotor=Rotor("slow", None, rb.ROTORS["exact"].factory, "me")),
    "thermostat": lambda: made(thermostat=Warmer(300.0, 1.0)),
    "constraints": lambda: made(constraints=[unconstrained]),
    "attribute": lambda: Labelled(np.float64, 0.0),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("what", OWN)
def test_objects_of_a_user_are_copied_within_the_process(what, way):
    integrator = OWN[what]()
    twin = WAYS[way](integrator)
    assert (type(twin), twin.getSettings()) == (type(integrator), integrator.getSettings())
    text, settings = openmm.XmlSerializer.serialize(integrator), integrator.getSettings()
    assert text == openmm.XmlSerializer.serialize(twin) == openmm.XmlSerializer.serialize(OWN[what]())
    del integrator, twin
    assert openmm.XmlSerializer.deserialize(text).getSettings() == settings


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("value", [None, 3, "text", 1e-300, True, [1, [2.5]], (1, ("a",)), {"a": (1,), 2: []}], ids=str)
def test_attributes_of_a_user_are_copied_as_they_were_last_set(value, way):
    integrator = Labelled("before", 0)
    plain = openmm.XmlSerializer.serialize(integrator)
    for name in ("label", "offset"):
        setattr(integrator, name, value)
        assert openmm.XmlSerializer.serialize(integrator) != plain
    twin = WAYS[way](integrator)
    assert (type(twin), twin.label, type(twin.label), twin.offset) == (Labelled, value, type(value), value)
    assert set(vars(twin)) == set(vars(integrator))


@pytest.mark.parametrize("value", [{1, 2}, 1j, np.arange(3.0), np.float64(0.1), Langevin(300.0, 1.0)], ids=repr)
def test_attributes_of_a_user_that_have_no_text_are_copied_within_the_process(value):
    integrator = Labelled(value, 0)
    twin = openmm.XmlSerializer.clone(integrator)
    assert np.array_equal(twin.label, value)
    assert openmm.XmlSerializer.serialize(twin) == openmm.XmlSerializer.serialize(integrator)


def test_text_does_not_keep_a_context_alive():
    integrator = Labelled("a", 0)
    integrator.label = context_of(WATER[0], made(), WATER[1])
    text, reference = openmm.XmlSerializer.serialize(integrator), weakref.ref(integrator.label)
    assert openmm.XmlSerializer.deserialize(text).label is integrator.label
    integrator.label = None
    gc.collect()
    assert reference() is None
    with pytest.raises(ValueError, match="this integrator has your own Context, which only the process"):
        openmm.XmlSerializer.deserialize(text)


# -- the key of a cache -----------------------------------------------------------------------------------------------


def standard(integrator):
    """Return the XML by which openmmtools tells integrators apart, without what can be set later."""
    twin = copy.deepcopy(integrator)
    for k in range(twin.getNumGlobalVariables()):
        twin.setGlobalVariable(k, 0.0)
    for name, value in (("StepSize", 0.001), ("Temperature", 273), ("Friction", 5), ("RandomNumberSeed", 0)):
        if hasattr(twin, f"set{name}"):
            getattr(twin, f"set{name}")(value)
    return openmm.XmlSerializer.serialize(twin)


def test_integrators_that_setters_make_equal_share_a_key_and_no_others_do():
    for kind in KINDS:
        later = {"stepSize", "forceInterval", "temperature", "frictionCoeff"}
        keys = {(name, str(value)): standard(made(kind, **{name: value})) for name, value in others(kind)}
        shared = {key for (name, _), key in keys.items() if name in later}
        others_of = [key for (name, _), key in keys.items() if name not in later]
        assert shared == {standard(made(kind))}
        assert len({*others_of, *shared}) == len(others_of) + 1
