"""Recipes: a key for each, and the same one in every process and version."""

from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app, unit
from recipe_functions import SHORT, square

import openmm_exactrb as rb
from openmm_exactrb import ensemble
from openmm_exactrb.ensemble import Recipe, recipes


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
    ],
)
def test_wrong_recipe(function, arguments, message):
    with pytest.raises(TypeError, match=message):
        Recipe(function, **arguments)


def test_wrong_axis():
    with pytest.raises(TypeError, match="axis x must be a list of values, not 'V2'"):
        ensemble.sweep(square, {"x": "V2"})
