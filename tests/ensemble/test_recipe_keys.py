"""Recipes: a key for each, and the same one in every process and version."""

import dataclasses
import json
import warnings
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app, unit
from recipe_functions import SHORT, Multiple, Other, disguised, length_of, square

import openmm_exactrb as rb
from openmm_exactrb import ensemble
from openmm_exactrb.ensemble import Outcome, Recipe, recipes, workers
from openmm_exactrb.ensemble.store import Store


def keys(*values):
    return {Recipe(square, x=value).key for value in values}


def test_keys_tell_recipes_apart_and_nothing_else():
    system = rb.dipole_fluid(2)[1]
    values = [1, 2, 1.5, "1", None, [1, 2], {"a": 1}, np.arange(3), np.arange(3.0), np.arange(6).reshape(2, 3)]
    values += [Path("a"), 1 * unit.femtosecond, 1 * unit.picosecond, rb.SCHEMES["V2"], rb.SCHEMES["S6_10"], square]
    values += [system, rb.dipole_fluid(3)[1], app.PME, app.NoCutoff, {"mapping": []}, True]
    assert len(keys(*values)) == len(values)
    assert len(keys((1, 2), [1, 2], np.array([1, 2]).tolist(), [np.int64(1), np.int32(2)])) == 1
    assert len(keys({"a": 1, "b": 2}, {"b": 2, "a": 1})) == 1
    assert len(keys(system, openmm.XmlSerializer.clone(system))) == 1
    assert len(keys(0.1, np.float64(0.1))) == 1
    assert Recipe(square, x=1) != 1


#: Of recipes of the first version, in the folders of who used it: a later one must find what an earlier one wrote.
KEPT = {
    "8a3b4d2b2990d6bb209b5673336f5b4b": {**SHORT, "scheme": "S6_10", "seed": 1},
    "8cca64530949eaa507f554038a3117c2": {
        "build": rb.rigid_water,
        "step": 0.002,
        "duration": 0.2,
        "scheme": rb.SCHEMES["V2"],
        "n": 4,
        "nonbondedMethod": app.NoCutoff,
    },
}


@pytest.mark.parametrize("key", KEPT)
def test_the_key_of_a_recipe_is_what_it_was(key, monkeypatch):
    monkeypatch.setattr(recipes, "package_version", lambda: "0.1.0")
    assert Recipe(ensemble.energies, **KEPT[key]).key == key


def done(recipe):
    """Return what a worker says that gets a recipe."""
    return workers.perform(workers.packed(recipe), recipes.package_version())


def changed_system():
    system = rb.dipole_fluid(2)[1]
    return system, lambda: system.setParticleMass(0, 7.0)


def changed_integrator():
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.01)
    return integrator, lambda: integrator.setFriction(5.0)


def changed_list():
    nested = {"a": [1, {"b": [2.0]}]}
    return nested, lambda: nested["a"][1]["b"].append(3.0)


def changed_array():
    array = np.arange(3.0)
    return array, lambda: array.__setitem__(0, 9.0)


def changed_quantity():
    quantity = np.arange(3.0) * unit.nanometer
    return quantity, lambda: quantity._value.__setitem__(0, 9.0)


@pytest.mark.parametrize(
    "make",
    [changed_array, changed_list, changed_quantity, changed_system, changed_integrator],
    ids=lambda f: f.__name__,
)
def test_what_is_changed_later_does_not_change_a_recipe(make):
    value, change = make()
    made = [Recipe(square, x=value), *ensemble.sweep(square, {"x": [value]}), *ensemble.sweep(square, {}, x=value)]
    change()
    assert len({recipe.key for recipe in made}) == 1
    for recipe in made:
        assert Recipe(square, x=recipe.arguments["x"]) == recipe  # that is what a worker gets
        assert Recipe(square, x=value) != recipe


def test_what_is_changed_in_a_recipe_does_not_reach_the_worker():
    recipe = Recipe(square, x=np.arange(3.0))
    recipe.arguments["x"][0] = 9.0
    assert done(recipe)["result"] == [0.0, 1.0, 4.0]


def test_arrays_in_files_are_arrays(tmp_path):
    np.save(tmp_path / "x.npy", np.arange(3.0))
    assert len(keys(np.arange(3.0), np.load(tmp_path / "x.npy", mmap_mode="r"))) == 1


def test_the_key_knows_what_is_in_a_file(tmp_path):
    file = tmp_path / "atoms.xyz"
    nothing, folder = keys(file), keys(tmp_path)
    file.write_text("one")
    text, one = keys(str(file)), keys(file)
    file.write_text("another")
    another = keys(file)
    assert len(nothing | one | another) == 3
    assert text == keys(str(file))
    assert folder == keys(tmp_path)
    file.write_text("one")
    assert keys(file) == one


def test_a_file_that_was_changed_is_not_computed_with(tmp_path):
    file = tmp_path / "atoms.xyz"
    file.write_text("one")
    made = [Recipe(length_of, file=file), Recipe(square, x=[{"deep": file}])]
    assert done(made[0])["result"] == 3
    for change in (lambda: file.write_text("another"), file.unlink):
        change()
        for recipe in made:
            report = done(recipe)
            assert report["error"].startswith(
                f"RuntimeError: the file {file} is not here as it was when the recipe was"
            )
            assert "result" not in report


def test_classes_of_one_name_in_two_modules_are_two():
    one, two = (dataclasses.make_dataclass("Box", ["edge"]) for _ in range(2))
    one.__module__, two.__module__ = "cubes", "parcels"
    assert len(keys(one(1.0), one(1.0), two(1.0))) == 2


def test_a_function_in_a_class_has_a_name():
    assert repr(Recipe(Multiple.twice, x=1)) == "Recipe(recipe_functions.Multiple.twice, x=1)"


def test_results_of_another_version_of_openmm_are_told(tmp_path):
    store, recipe = Store(tmp_path), Recipe(square, x=2)
    store.write(Outcome(recipe, 4))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert store.read(recipe).result == 4
    (file,) = tmp_path.iterdir()
    record = json.loads(file.read_text())
    here, record["versions"]["openmm"] = record["versions"]["openmm"], "7.7"
    file.write_text(json.dumps(record))
    with pytest.warns(UserWarning, match=rf"results in {tmp_path} are of openmm 7\.7, and this is openmm {here}"):
        assert store.read(recipe).result == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"frames": 0}, "frames must be a whole number of at least 1, not 0"),
        ({"frames": -3}, "frames must be a whole number of at least 1, not -3"),
        ({"frames": 2.5}, "frames must be a whole number of at least 1, not 2.5"),
        ({"step": 0.0}, "step must be a positive number of ps, not 0.0"),
        ({"step": -0.1}, "step must be a positive number of ps, not -0.1"),
        ({"duration": 0.0}, "duration must be a positive number of ps, not 0.0"),
        ({"duration": -1.0}, "duration must be a positive number of ps, not -1.0"),
        ({"duration": np.nan}, "duration must be a positive number of ps, not nan"),
        ({"duration": 1.0 * unit.nanometer}, "duration must be a positive number of ps, not 1.0 nm"),
        ({"duration": 0.05}, "duration must be at least one step of 0.1 ps, not 0.05 ps"),
    ],
)
def test_energies_of_no_time_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ensemble.energies(rb.dipole_fluid, **{"n": 2, "step": 0.1, "duration": 1.0} | arguments)


def test_energies_of_one_step_are_two():
    result = ensemble.energies(rb.dipole_fluid, n=2, step=10.0 * unit.femtosecond, duration=0.01, frames=5)
    assert result["times"] == pytest.approx([0.0, 0.01])
    assert (result["steps"], len(result["energies"])) == (1, 2)


def test_energies_take_velocities_and_samples():
    def build():
        topology, system, positions = rb.dipole_fluid(2, spacing=5.0)
        return topology, system, positions, np.ones((system.getNumParticles(), 3))

    result = ensemble.energies(build, step=0.1, duration=1.0, scheme="V2_drift", frames=4)
    assert result["times"] == pytest.approx([0.0, 0.2, 0.5, 0.8, 1.0])
    assert result["steps"] == 10
    assert result["evaluations"] == 10
    assert result["energies"][0] == pytest.approx(3.0, abs=0.1)  # two spheres of mass 1 at (1, 1, 1) nm/ps
    assert result["energies"] == pytest.approx([result["energies"][0]] * 5, rel=1e-3)


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (lambda: 1, {}, "a function at the top level of a module is needed"),
        ("square", {}, "a function at the top level of a module is needed"),
        (
            square,
            {"y": 1},
            "recipe_functions.square cannot be called with these arguments: missing a required",
        ),
        (square, {"x": object()}, "argument x of a recipe cannot be <object"),
        (square, {"x": {1, 2}}, "argument x of a recipe cannot be {1, 2}"),
        (Multiple(3).of, {"x": 1}, "a function at the top level of a module is needed"),
        (Other.named, {"x": 1}, "a function at the top level of a module is needed"),  # its name is Multiple.named
        (disguised, {"x": 1}, "a function at the top level of a module is needed"),
        (square, {"x": Multiple(3).of}, "argument x of a recipe cannot be <bound method Multiple.of"),
        (square, {"x": disguised}, "a function at the top level of a module is needed"),
        (square, {"x": np.ma.array([1, 2], mask=[0, 1])}, "argument x of a recipe cannot be a MaskedArray: hand over"),
        (square, {"x": np.ma.array([1], mask=[1]) * unit.nanometer}, "argument x of a recipe cannot be a MaskedArray"),
    ],
)
def test_wrong_recipe(function, arguments, message):
    with pytest.raises(TypeError, match=message):
        Recipe(function, **arguments)


def test_wrong_axis():
    with pytest.raises(TypeError, match="axis x must be a list of values, not 'V2'"):
        ensemble.sweep(square, {"x": "V2"})


def test_an_argument_is_an_axis_or_fixed():
    with pytest.raises(TypeError, match="argument seed is an axis and fixed: give it once"):
        ensemble.sweep(ensemble.energies, {"seed": range(3)}, **SHORT, seed=1)
