"""The recipes in docs/contributing.md, carried out as a reader would type them."""

import copy
import io
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
import three_masses
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines import ENGINES
from openmm_exactrb.mechanics.fit import fit
from openmm_exactrb.mechanics.state import State
from orders import slope
from peptides import peptide
from places import device_platform
from starts import context_of, simulation_of

ROOT = Path(__file__).parents[2]
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
def checkout(tmp_path_factory):
    """Return a copy of the package, tests and benchmarks into which the recipes were typed that change a file of it."""
    root = tmp_path_factory.mktemp("checkout")
    for part in ("openmm_exactrb", "tests", "benchmarks"):
        shutil.copytree(ROOT / part, root / part, ignore=shutil.ignore_patterns("*.pyc"))  # with compiled kernels
    shutil.copy(ROOT / "pyproject.toml", root)
    page, (scheme,) = recipe("A scheme")
    put_after(root / named(page, "_SCHEMES"), "_SCHEMES = (\n", f"{scheme.rstrip()},\n")
    page, (module, entry) = recipe("A rotor")
    (file,) = re.findall(r"One file, `(\S+)`", page)
    (root / file).write_text(module, encoding="utf-8")
    registry = root / named(page, "ROTORS")
    put_after(registry, "from openmm_exactrb.rotors import ", f"{Path(file).stem}, ")
    put_after(registry, "        for entry in (\n", f"{entry.rstrip()},\n")
    page, (option,) = recipe("A command option")
    put_after(
        root / named(page, "OPTIONS"), "OPTIONS: tuple[tuple[str, dict[str, Any]], ...] = (\n", f"{option.rstrip()},\n"
    )
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


@pytest.fixture(scope="module")
def tested(checkout):
    """Return what the tests say of the scheme and the rotor."""
    tests = [f"tests/{name}.py" for name in ("schemes/test_scheme_laws", "schemes/test_schemes", "rotors/test_rotors")]
    return carried_out(checkout, "-m", "pytest", *tests, "-k", "VEFRL or axes_321", "-v", "-p", "no:cacheprovider")


def named(page, name):
    """Return the file that a page says a name is in."""
    return re.search(rf"`{name}` in\s+`(\S+?)`", page)[1]


def test_every_addition_has_one_place_that_exists():
    table = re.findall(r"^\| \[(?:a|an) (.*)\]\(#(.*)\) \| (.*) \|$", PAGE, flags=re.M)
    assert {name for name, *_ in table} >= {
        "scheme", "substep", "thermostat", "rotor", "constraint type", "engine", "kernel stage", "reporter",
        "command option", "potential",
    }  # fmt: skip
    for name, anchor, place in table:
        article = "an" if name[0] in "aeiou" else "a"
        assert anchor == f"{article}-{name.replace(' ', '-').lower()}"
        assert recipe(f"{article.title()} {name}")[1]
        for of, file in re.findall(r"`(\w+)` in `(\S+)`", place):
            assert re.search(rf"\b{of}\b", (ROOT / file).read_text(encoding="utf-8"))


def test_a_scheme_is_one_entry_and_its_laws_are_tested(tested):
    for law in ("order_with_the_exact_rotor", "steps_are_reversible", "steps_are_symplectic", "no_force_is_evaluated"):
        assert re.search(rf"{law}\S*\[VEFRL\S*\] PASSED", tested), law


def test_a_rotor_is_one_file_and_one_entry_and_its_laws_are_tested(tested):
    for law in ("spatial_momentum", "flow_back", "measured_order", "inputs_are_not_modified", "steps_are_symplectic"):
        assert re.search(rf"{law}\S*\[\S*axes_321\S*\] PASSED", tested), law


def moving(integrator, kelvin=100.0):
    """Return the Context of a triangle in motion."""
    context = context_of(three_masses.system(), integrator, three_masses.POSITIONS)
    integrator.setVelocitiesToTemperature(kelvin, 1)
    return context


def test_a_substep_is_a_class_in_the_sequence_of_a_scheme():
    integrator = typed("A substep")["integrator"]
    _context = moving(integrator)
    before = integrator.kineticEnergies()
    integrator.step(30)
    for now, then in zip(integrator.kineticEnergies(), before, strict=True):
        assert now / then == pytest.approx(np.exp(-2.0 * 0.5 * 0.3), rel=1e-12)


def test_a_thermostat_is_a_class_that_an_integrator_takes():
    names = typed("A thermostat")
    assert names["integrator"].getThermostat() == names["Andersen"](300.0, 5.0)
    integrator = rb.ExactRigidBodyIntegrator(0.01, scheme="V2", thermostat=names["Andersen"](300.0, 1000.0))
    integrator.setRandomNumberSeed(3)
    _context = moving(integrator)
    energies = []
    for _ in range(1000):  # each step forgets the momenta before it
        integrator.step(1)
        energies.append(
            [energy / (unit.MOLAR_GAS_CONSTANT_R * 300.0 * unit.kelvin) for energy in integrator.kineticEnergies()]
        )
    # Means and variances of the kinetic energy of three degrees of freedom, over kT.
    np.testing.assert_allclose(np.mean(energies, axis=0), 1.5, atol=4.0 * np.sqrt(1.5 / 1000))
    np.testing.assert_allclose(np.var(energies, axis=0), 1.5, rtol=0.35)


def test_a_thermostat_without_collisions_changes_no_bit():
    states = []
    for thermostat in (None, typed("A thermostat")["Andersen"](300.0, 0.0)):
        integrator = rb.ExactRigidBodyIntegrator(0.01, scheme="V2", thermostat=thermostat, engine="host")
        _context = moving(integrator)
        integrator.step(10)
        states.append(integrator.fullState()[1])
    for one, other in zip(*states, strict=True):
        np.testing.assert_array_equal(one, other)


def triangle(rng):
    """Return a body of three particles and a state of it in motion."""
    bodies = find_bodies(three_masses.system(), three_masses.POSITIONS)
    rounded = fit(bodies, three_masses.POSITIONS, np.zeros((3, 3)))
    m = 0.01 * rng.standard_normal((3, 1))
    return bodies, State.of(rounded._replace(P=rng.standard_normal((3, 1)), m=m))


def test_a_force_without_openmm_is_a_function_of_a_state(rng):
    advance = typed("A force without OpenMM")["advance"]
    bodies, state = triangle(rng)
    omega, t = np.sqrt(3.0 / bodies.mass), 2.0
    expected = state.R[0] * np.cos(omega * t) + state.P[0] / (bodies.mass * omega) * np.sin(omega * t)
    scheme = rb.SCHEMES["SRKN4_6b"]
    np.testing.assert_allclose(advance(bodies, state, t / 200, 200, scheme).R[0], expected, rtol=0.0, atol=1e-7)
    assert abs(slope(lambda n: advance(bodies, state, t / n, n, scheme).R[0], (4, 6, 8)) - 4.0) < 0.35


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
    on_a_plane = typed("A constraint type")["on_a_plane"]
    begin, plane = pushed(scheme, constraints=[on_a_plane])
    _, space = pushed(scheme, engine="host")
    np.testing.assert_array_equal(plane.R[:, :2], space.R[:, :2])
    np.testing.assert_array_equal(plane.R[:, 2], begin.R[:, 2])
    assert abs(space.R[0, 2] - begin.R[0, 2]) > 1e-3


def test_a_constraint_type_holds_within_inner_steps():
    """Also where the compiled ones, which know distances alone, would be faster."""
    _, system, x = peptide()
    constraints = [typed("A constraint type")["on_a_plane"]]
    integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", fast="bonded", constraints=constraints)
    _context = context_of(system, integrator, x, kelvin=300.0)
    _, begin = integrator.fullState()
    integrator.step(3)
    bodies, end = integrator.fullState()
    free = slice(bodies.clustered.stop, None)
    np.testing.assert_array_equal(end.R[:, 2, free], begin.R[:, 2, free])
    assert np.abs(end.R[0, :2, free] - begin.R[0, :2, free]).min() > 0.0
    assert integrator.timings.fast_evaluations > 0


def test_names_are_in_the_files_that_the_page_gives():
    pairs = re.findall(r"`(\w+)`\s+in\s+`(openmm_exactrb/\S+\.py)`", PAGE)
    assert len(pairs) > 8
    for name, file in pairs:
        assert re.search(rf"\b{name}\b", (ROOT / file).read_text(encoding="utf-8")), (name, file)


def test_an_engine_is_one_record(monkeypatch):
    monkeypatch.setitem(ENGINES, "native", replace(ENGINES["native"], advice=lambda *_: (False, "not here")))
    monkeypatch.setitem(ENGINES, "small", ENGINES["host"])  # what the recipe puts there goes with it
    integrator = typed("An engine")["integrator"]
    _context = moving(integrator)
    integrator.step(1)
    assert integrator.getEngine() == "small"
    assert integrator.engineNote().startswith("the system is small; ")
    large = rb.ExactRigidBodyIntegrator(0.002, "S2_2", engine="small")
    _, system, x = rb.rigid_water(40)
    context = context_of(system, large, x)
    with pytest.raises(ValueError, match=r"at most 100 particles, not 120: use engine='host' instead"):
        large.step(1)
    assert context.getStepCount() == 0


def test_a_reporter_asks_the_integrator():
    out, integrator = io.StringIO(), rb.ExactRigidBodyIntegrator(0.002, "S2_2")
    simulation = simulation_of(*rb.rigid_water(3)[:2], integrator, rb.rigid_water(3)[2], kelvin=300.0)
    simulation.reporters.append(typed("A reporter")["TemperatureReporter"](out, 2))
    simulation.step(4)
    rows = [line.split(",") for line in out.getvalue().splitlines()]
    assert [int(step) for step, *_ in rows] == [2, 4]
    assert [float(T) for T in rows[-1][1:]] == [T._value for T in integrator.temperatures()]


@pytest.mark.opencl
def test_a_kernel_stage_is_one_method_and_moves_as_on_the_host():
    names = typed("A substep")
    names["Friction"].kernel_moves = typed("A kernel stage")["kernel_moves"]
    _, system, positions = rb.rigid_water(3)
    found = []
    for engine in ("host", "native"):
        integrator = rb.ExactRigidBodyIntegrator(0.001, names["damped"], engine=engine)
        platform = device_platform(["OpenCL"])
        context = openmm.Context(copy.deepcopy(system), integrator, platform, {"Precision": "double"})
        context.setPositions(positions)
        integrator.setVelocitiesToTemperature(300.0, 1)
        integrator.step(20)
        assert integrator.getEngine() == engine
        found.append([np.asarray(a) for a in integrator.bodyState()[1]])
    for host, native in zip(*found, strict=True):
        np.testing.assert_allclose(native, host, rtol=0.0, atol=1e-12)


def test_a_substep_without_a_kernel_stage_is_left_to_the_host():
    damped = typed("A substep")["damped"]
    with pytest.raises(ValueError, match="has no kernel"):
        rb.ExactRigidBodyIntegrator(0.001, damped, engine="native")


PARSED = """
from openmm_exactrb.command import main, setup
for given, expected in ((["--inner-steps", "3"], 3), ([], None)):
    args = main._parser().parse_args(["run", *given])
    integrator = setup.integrator_of(args, {"scheme": "S2_2"}, 0.004)
    assert integrator.getMultipleTimeSteps().steps == expected
main.main(["run", "--help"])
"""


def test_a_command_option_is_one_entry(checkout):
    assert "--inner-steps N" in carried_out(checkout, "-c", PARSED)
