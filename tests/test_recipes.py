"""The recipes in docs/contributing.md, carried out as a reader would type them."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import three_masses
from few_dipoles import REFERENCE, simulation_of
from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.motion.engine import run
from openmm_exactrb.motion.fit import fit
from openmm_exactrb.motion.kick import kick
from openmm_exactrb.motion.kinetic import rigid
from openmm_exactrb.motion.state import State
from openmm_exactrb.rotors import rotor_of_sums
from orders import slope

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")


def recipe(title):
    """Return the text of a recipe and its pieces of code."""
    (text,) = (part for part in re.split(r"^## ", PAGE, flags=re.M) if part.startswith(f"{title}\n"))
    return text, re.findall(r"```python\n(.*?)```", text, flags=re.S)


def typed(title):
    """Return what the one piece of code of a recipe defines."""
    (code,) = recipe(title)[1]
    names = {}
    exec(compile(code, f"{title}.py", "exec"), names)
    return names


def put_after(file, line, text):
    """Put text behind the first line of a file that ends in this."""
    content = file.read_text(encoding="utf-8")
    assert content.count(line) == 1, (file, line)
    file.write_text(content.replace(line, line + text), encoding="utf-8")


@pytest.fixture(scope="module")
def tested(tmp_path_factory):
    """Return what the tests say of a scheme and a rotor after they were typed into a copy of the package."""
    root = tmp_path_factory.mktemp("checkout")
    for part in ("openmm_exactrb", "tests"):
        shutil.copytree(ROOT / part, root / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", root)
    page, (scheme,) = recipe("A scheme")
    put_after(root / named(page, "_SCHEMES"), "_SCHEMES = (\n", f"{scheme.rstrip()},\n")
    page, (module, entry) = recipe("A rotor")
    (file,) = re.findall(r"One file, `(\S+)`", page)
    (root / file).write_text(module, encoding="utf-8")
    registry = root / named(page, "ROTORS")
    put_after(registry, "from openmm_exactrb.rotors import ", f"{Path(file).stem}, ")
    put_after(registry, "        for entry in (\n", f"{entry.rstrip()},\n")
    tests = ("tests/schemes", "tests/rotors/test_rotors.py", "-k", "VEFRL or axes_321", "-v", "-p", "no:cacheprovider")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *tests],
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root), "OPENMM_EXACTRB_COMPILED": "0"},  # nothing to compile anew
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    return done.stdout


def named(page, name):
    """Return the file that a page says a name is in."""
    return re.search(rf"`{name}` in\s+`(\S+?)`", page)[1]


def test_a_scheme_is_one_entry_and_its_laws_are_tested(tested):
    for law in ("order_with_the_exact_rotor", "steps_are_reversible", "steps_are_symplectic", "no_force_is_evaluated"):
        assert re.search(rf"{law}\S*\[VEFRL\S*\] PASSED", tested), law


def test_a_rotor_is_one_file_and_one_entry_and_its_laws_are_tested(tested):
    for law in ("spatial_momentum", "flow_back", "measured_order", "inputs_are_not_modified", "steps_are_symplectic"):
        assert re.search(rf"{law}\S*\[\S*axes_321\S*\] PASSED", tested), law


def test_a_letter_is_a_function_told_to_an_integrator():
    integrator = typed("A letter")["integrator"]
    context = openmm.Context(three_masses.system(), integrator, REFERENCE)
    context.setPositions(three_masses.POSITIONS)
    integrator.setVelocitiesToTemperature(100.0, 1)
    before = integrator.kineticEnergies()
    integrator.step(30)
    for now, then in zip(integrator.kineticEnergies(), before, strict=True):
        assert now / then == pytest.approx(np.exp(-2.0 * 0.5 * 0.3), rel=1e-12)


def triangle(rng):
    """Return a body of three particles and a state of it in motion."""
    bodies = find_bodies(three_masses.system(), three_masses.POSITIONS)
    rounded = fit(bodies, three_masses.POSITIONS, np.zeros((3, 3)))
    m = 0.01 * rng.standard_normal((3, 1))
    return bodies, State.of(rounded._replace(P=rng.standard_normal((3, 1)), m=m))


def test_a_force_source_is_a_function_of_places(rng):
    advance = typed("A force source")["advance"]
    bodies, state = triangle(rng)
    omega, t = np.sqrt(3.0 / bodies.mass), 2.0
    expected = state.R[0] * np.cos(omega * t) + state.P[0] / (bodies.mass * omega) * np.sin(omega * t)
    scheme = rb.SCHEMES["SRKN4_6b"]
    np.testing.assert_allclose(advance(bodies, state, t / 200, 200, scheme).R[0], expected, rtol=0.0, atol=1e-7)
    assert abs(slope(lambda n: advance(bodies, state, t / n, n, scheme).R[0], (4, 6, 8)) - 4.0) < 0.35


def test_a_kinetic_flow_is_a_record(rng):
    bodies, state = triangle(rng)
    rotation = rotor_of_sums("exact", bodies.inertia)
    plane, space = typed("A kinetic flow")["on_a_plane"](bodies.mass, rotation), rigid(bodies.mass, rotation)

    def end(kinetic):
        flows = {"A": kinetic.drift, "B": kick(lambda state: (np.ones((3, 1)), np.zeros((3, 1))))}
        return run(rb.SCHEMES["V2"].word * 5, flows, kinetic.tangent(state), 0.1)

    ours, theirs = end(plane), end(space)
    np.testing.assert_array_equal(ours.R[:, :2], theirs.R[:, :2])
    np.testing.assert_array_equal(ours.R[:, 2], state.R[:, 2])
    assert abs(theirs.R[0, 2] - state.R[0, 2]) > 0.01


def test_an_engine_is_a_loop_over_letters(rng):
    traced = typed("An engine")["traced"]
    simulation = simulation_of(4)
    bodies, state = simulation.integrator.fullState()
    kinetic = rigid(bodies.mass, rotor_of_sums("exact", bodies.inertia))
    flows = {"A": kinetic.drift, "B": kick(lambda s: (-s.R[0], -s.m[0]))}
    word, seen = rb.SCHEMES["SRKN4_6b"].word, []
    end = traced(word, flows, state, 0.1, lambda *shown: seen.append(shown))
    for a, b in zip(end, run(word, flows, state, 0.1), strict=True):
        np.testing.assert_array_equal(a, b)
    assert [(letter, tau) for letter, tau, _ in seen] == [(letter, 0.1 * part) for letter, part in word]
    assert seen[-1][2] is end
