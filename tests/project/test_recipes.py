"""The recipes in docs/contributing.md, typed into a copy of the project as a reader would, and tested there."""

import json
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import three_masses
from peptides import peptide
from places import has_device
from starts import context_of

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
#: A piece of code, whose first line names its place: a new file, the end of a file, or a name in a file.
PIECE = re.compile(
    r"^```python\n# (?:in (?P<name>\w+) of )?(?P<end>at the end of )?(?P<file>[\w/]+\.py)"
    r"(?:, which imports (?P<module>\w+))?\n(?P<code>.*?)^```",
    flags=re.M | re.S,
)
KINDS = {
    "scheme", "rotor", "substep", "thermostat", "engine", "constraint type", "potential", "command option", "reporter",
    "documented number",
}  # fmt: skip


def section(title):
    """Return the text of a recipe."""
    (text,) = (part for part in re.split(r"^### ", PAGE, flags=re.M) if part.startswith(f"{title}\n"))
    return text


def put_after(file, pattern, text):
    """Put text behind the one place of a file that matches a pattern."""
    content = file.read_text(encoding="utf-8")
    (found,) = re.finditer(pattern, content, flags=re.M)
    file.write_text(content[: found.end()] + text + content[found.end() :], encoding="utf-8")


def type_in(root, piece):
    """Type a piece of code where its first line says."""
    file, code = root / piece["file"], piece["code"]
    if piece["end"]:
        file.write_text(f"{file.read_text(encoding='utf-8')}\n\n{code}", encoding="utf-8")
    elif piece["name"]:  # before the entries that are there
        put_after(file, rf"^{piece['name']}\b(?:.* = \(\n|(?:.*\n)+? +for \w+ in \(\n)", f"{code.rstrip()},\n")
        if piece["module"]:
            package = ".".join(file.relative_to(root).parts[:-1])
            put_after(file, r"^from __future__ import annotations\n", f"from {package} import {piece['module']}\n")
    else:
        assert not file.exists(), file
        file.write_text(code, encoding="utf-8")


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """Return a copy of the project into which all recipes were typed."""
    root = tmp_path_factory.mktemp("checkout")
    for part in ("openmm_exactrb", "tests", "benchmarks"):
        shutil.copytree(ROOT / part, root / part, ignore=shutil.ignore_patterns("*.pyc"))
    shutil.copytree(ROOT / "docs", root / "docs", ignore=shutil.ignore_patterns("_build", "examples", "pictures"))
    shutil.copy(ROOT / "pyproject.toml", root)
    for piece in PIECE.finditer(PAGE):
        type_in(root, piece)
    number = section("A documented number")
    (row,) = re.findall(r"^\| `.*\n", number, flags=re.M)
    (comment,) = re.findall(r"`(<!-- table: \w+ -->)`", number)
    put_after(root / "benchmarks" / "README.md", r"^\| `schemes/search.py`.*\n", row)
    page = root / "docs" / "reference" / "units.md"
    page.write_text(f"{page.read_text(encoding='utf-8')}\n{comment}\n", encoding="utf-8")
    for script in re.findall(r"`(benchmarks/\S+\.py)`", number):
        carried_out(root, script)
    return root


def carried_out(root, *arguments):
    """Return what a Python process prints in the copy."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    return done.stdout


def test_every_kind_of_addition_has_a_recipe_with_its_place():
    for title, name in (titles := re.findall(r"^### (An? (.*))$", PAGE, flags=re.M)):
        assert PIECE.search(section(title)) or name == "kernel stage"  # whose code is that of a substep
    assert {name for _, name in titles} == KINDS | {"kernel stage"}
    assert PAGE.count("```python\n") == len(PIECE.findall(PAGE))


def test_the_tests_of_each_recipe_cover_it_and_pass(checkout):
    commands = re.findall(r"`pytest\s+([^`]*?)\s+-k\s+(\w+)`", PAGE)
    words = [word for _, word in commands]
    paths = sorted({path for paths, _ in commands for path in paths.split()})
    told = carried_out(checkout, "-m", "pytest", *paths, "-k", " or ".join(words), "-v", "-p", "no:cacheprovider")
    passed = re.findall(r"^(\S.*) PASSED", told, flags=re.M)
    for word in words:
        assert sum(word.lower() in name.lower() for name in passed) >= 1, word
    for law in ("order_with_the_exact_rotor", "steps_are_reversible", "steps_are_symplectic", "no_force_is_evaluated"):
        assert any(law in name and "VEFRL" in name for name in passed), law
    for law in ("spatial_momentum", "flow_back", "measured_order", "inputs_are_not_modified", "steps_are_symplectic"):
        assert any(law in name and "axes_321" in name for name in passed), law


def test_no_page_or_list_besides_needs_a_change(checkout):
    """Where the tests of the project would ask for one."""
    tests = [
        "project/test_tables.py::test_tables_of_a_page_are_those_of_the_records",
        "project/test_tables.py::test_every_scheme_is_in_the_table_or_its_benchmark_is_named",
        "project/test_sizes.py",
        "benchmarks/test_benchmarks.py::test_the_readme_lists_every_script_with_its_question",
        "benchmarks/test_benchmarks.py::test_every_script_has_a_record_or_is_imported",
    ]
    told = carried_out(checkout, "-m", "pytest", *(f"tests/{test}" for test in tests), "-p", "no:cacheprovider")
    assert "angular_momentum.py --schemes VEFRL and write_tables.py" in told


def test_the_linters_have_no_complaints(checkout):
    if missing := [name for name in ("ruff", "mypy", "importlinter") if find_spec(name) is None]:
        pytest.skip(f"the extra lint is not installed: {', '.join(missing)}")
    if (cache := ROOT / ".mypy_cache").exists():
        shutil.copytree(cache, checkout / ".mypy_cache", dirs_exist_ok=True)
    parts = "openmm_exactrb", "tests", "benchmarks"
    carried_out(checkout, "-m", "ruff", "check", "--quiet", "--fix", "--select", "I", *parts)  # as the hook of commits
    carried_out(checkout, "-m", "ruff", "format", "--quiet", *parts)
    carried_out(checkout, "-m", "ruff", "check", *parts)
    carried_out(checkout, "-m", "mypy")
    carried_out(checkout, "-c", "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports())")


#: Steps of two triangles with each addition to the motion, on each engine and platform.
ON_EVERY_ENGINE = """
import itertools, json, sys
import numpy as np, openmm, openmm_exactrb as rb, three_masses
from on_a_plane import on_a_plane
from openmm_exactrb.potentials.soft_spheres import soft_sphere_force

def end(engine, platform, **options):
    system, x = openmm.System(), np.concatenate([three_masses.POSITIONS, three_masses.POSITIONS + [0.4, 0.0, 0.0]])
    for k, i in itertools.product((0, 3), range(3)):
        system.addParticle(1.0)
        for j in range(i):
            system.addConstraint(k + i, k + j, 0.1)
    system.addForce(soft_sphere_force([0, 4], sigma=0.4))
    integrator = rb.ExactRigidBodyIntegrator(0.002, engine=engine, **options)
    properties = {"Precision": "double"} if platform == "OpenCL" else {}
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform), properties)
    context.setPositions(x)
    integrator.setVelocitiesToTemperature(100.0, 1)
    integrator.step(10)
    return integrator.fullState()[1], integrator.getEngine(), integrator.engineNote()

told = []
for platform in sys.argv[1:]:
    for options in {"scheme": "VEFRL"}, {"rotor": "axes_321"}, {"constraints": [on_a_plane]}, {"scheme": "S2_2"}:
        host, *_ = end("host", platform, **options)
        try:
            native, *_ = end("native", platform, **options)
            found = max(float(np.abs(a - b).max()) for a, b in zip(host, native, strict=True))
        except ValueError as error:
            auto, engine, note = end("auto", platform, **options)
            assert all(np.array_equal(a, b) for a, b in zip(host, auto, strict=True))
            assert (engine, note.split("; ")[0]) == ("host", str(error).split(": use")[0])
            found = str(error)
        told.append((platform, *options, found))
print(json.dumps(told))
"""


@pytest.mark.library
def test_additions_to_the_motion_act_alike_on_every_engine_or_are_left_to_the_host(checkout):
    """Where the native engine does not perform the steps, it says why in a sentence, and "auto" takes the host."""
    platforms = ["Reference", "CPU", *["OpenCL"] * has_device()]
    path = os.pathsep.join((str(checkout), str(checkout / "tests" / "common")))
    run = f"import sys; sys.path[:0] = {path.split(os.pathsep)!r}\n{ON_EVERY_ENGINE}"
    told = json.loads(carried_out(checkout, "-c", run, *platforms).splitlines()[-1])
    assert len(told) == 4 * len(platforms)
    for platform, what, found in told:
        if what == "rotor":
            assert found.startswith("the native engine supports only the exact rotor, not axes_321: use engine='host'")
        elif what == "constraints":
            assert found.startswith(
                "the native engine supports only constraints of the System, not <function on_a_plane"
            )
        else:
            assert found < 1e-11, (platform, what, found)


# -- what a type of constraint does -----------------------------------------------------------------------------------


def on_a_plane():
    """Return the constraint of the recipe."""
    names = {}
    exec(PIECE.search(section("A constraint type"))["code"], names)
    return names["on_a_plane"]


def pushed(scheme, **options):
    """Return the state of a triangle that a force pushes along the diagonal of space, after five steps."""
    system, force = three_masses.system(), openmm.CustomExternalForce("-10*(x+y+z)")
    for i in range(3):
        force.addParticle(i)
    system.addForce(force)
    integrator = rb.ExactRigidBodyIntegrator(0.01, scheme=scheme, **options)
    _context = context_of(system, integrator, three_masses.POSITIONS)
    integrator.setVelocitiesToTemperature(100.0, 1)
    begin = integrator.fullState()[1]
    integrator.step(5)
    return begin, integrator.fullState()[1]


@pytest.mark.parametrize("scheme", ["V2", "Chin4A"])
def test_a_constraint_type_is_an_argument(scheme):
    """With forces at displaced positions too, and of this integrator alone."""
    begin, plane = pushed(scheme, constraints=[on_a_plane()])
    _, space = pushed(scheme, engine="host")
    np.testing.assert_array_equal(plane.R[:, :2], space.R[:, :2])
    np.testing.assert_array_equal(plane.R[:, 2], begin.R[:, 2])
    assert abs(space.R[0, 2] - begin.R[0, 2]) > 1e-3


def test_a_constraint_type_holds_within_inner_steps():
    """Also where the compiled ones, which know distances alone, would be faster."""
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", fast="bonded", constraints=[on_a_plane()])
    _context = context_of(system, integrator, x, kelvin=300.0)
    _, begin = integrator.fullState()
    integrator.step(3)
    bodies, end = integrator.fullState()
    free = slice(bodies.clustered.stop, None)
    np.testing.assert_array_equal(end.R[:, 2, free], begin.R[:, 2, free])
    assert np.abs(end.R[0, :2, free] - begin.R[0, :2, free]).min() > 0.0
    assert integrator.timings.fast_evaluations > 0
