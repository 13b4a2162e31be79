"""The recipe for a potential in docs/contributing.md, carried out as a reader would type it."""

import inspect
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from force_laws import energy_and_forces

PAGE = Path(__file__).parents[2] / "docs" / "contributing.md"


def blocks():
    """Return the recipe's three pieces of code: the module, the line of the imports, the test."""
    section = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.M)
    (recipe,) = (text for text in section if text.startswith("A potential"))
    return re.findall(r"```python\n(.*?)```", recipe, flags=re.S)


@pytest.fixture
def typed(monkeypatch):
    """Return what the test of the recipe defines, after the module and the import are where the page says."""
    module, line, test = blocks()
    (name,) = re.findall(r"from (\S+) import", line)
    assert f"`{name.replace('.', '/')}.py`" in PAGE.read_text(encoding="utf-8")
    spheres = ModuleType(name)
    monkeypatch.setitem(sys.modules, name, spheres)
    exec(compile(module, f"{name}.py", "exec"), vars(spheres))
    public = {}
    exec(line, public)
    for function in set(public) - {"__builtins__"}:
        monkeypatch.setattr(rb, function, public[function], raising=False)
    tests = {}
    exec(compile(test, "test_spheres.py", "exec"), tests)
    return tests


def test_the_tests_of_the_recipe_pass(typed, rng):
    tests = [value for name, value in typed.items() if name.startswith("test_")]
    assert len(tests) == 2
    for test in tests:
        test(*([rng] if inspect.signature(test).parameters else []))


def test_the_tests_of_the_recipe_notice_a_wrong_power(typed, rng, monkeypatch):
    def wrong(centres, **options):
        force = openmm.CustomBondForce("soft_repulsion/r^11")
        force.addGlobalParameter("soft_repulsion", 4.0 * 1.7 * 0.9**12)
        for i in centres:
            for j in range(i):
                force.addBond(i, j, [])
        return force

    monkeypatch.setattr(rb, "soft_sphere_force", wrong)
    with pytest.raises(AssertionError):
        typed["test_soft_spheres_have_the_energy_of_their_definition"](rng)


def test_the_potential_of_the_recipe_has_the_energy_and_the_forces_of_its_formula(typed, rng):
    x = 1.3 * np.argwhere(np.ones((2, 2, 2))) + 0.1 * rng.standard_normal((8, 3))
    sigma, epsilon = 1.1, 0.7
    r = x[:, None] - x
    d = np.linalg.norm(r, axis=2) + np.diag(np.full(8, np.inf))
    energy, forces = energy_and_forces(rb.soft_sphere_force(range(8), sigma=sigma, epsilon=epsilon), x)
    assert energy == pytest.approx(0.5 * np.sum(4.0 * epsilon * (sigma / d) ** 12), rel=1e-13)
    exact = np.sum((48.0 * epsilon * sigma**12 / d**14)[..., None] * r, axis=1)
    np.testing.assert_allclose(forces, exact, rtol=0.0, atol=1e-12 * np.abs(exact).max())
