"""benchmarks/README.md lists every script with its question and record; each can be imported, and shares what works."""

import importlib
import re
from functools import partial
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm.unit import nanometer

import openmm_exactrb as rb
from benchmarks.common import proteins, records
from benchmarks.common.clocks import in_turns
from benchmarks.common.energies import spread
from benchmarks.common.starts import R, canonical, context_of, masses_of, positions_and_velocities, thermostat

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"
README = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
SCRIPTS = sorted(str(file.relative_to(BENCHMARKS)) for file in BENCHMARKS.rglob("*.py") if file.name != "__init__.py")
#: Script, question, options, time and record of each row of a table.
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in README.splitlines() if line.startswith("| `")]
WRITTEN = [file for *_, cell in ROWS for file in re.findall(r"`(.*?)`", cell)]


def test_the_readme_lists_every_script_with_its_question():
    assert {len(row) for row in ROWS} == {5}
    assert all(question for _, question, *_ in ROWS)
    listed = [script.strip("`") for script, *_ in ROWS]
    assert sorted(listed) == [
        name for name in SCRIPTS if not name.startswith("common/") and not name.endswith("tables.py")
    ]
    rest = {name.removeprefix("common/") for name in SCRIPTS} - set(listed)
    assert {name for name in rest if f"`{name}`" not in README} == set()


def test_every_record_that_it_names_is_there():
    homes = {True: ROOT, False: BENCHMARKS}
    assert [file for file in WRITTEN if not (homes[file.startswith("docs/")] / file).exists()] == []


def test_every_table_of_the_documentation_has_its_script():
    by_examples = {f"records/{name}.csv" for name in ("ellipsoids", "stockmayer_fluid")}
    found = {f"records/{file.name}" for file in records.RECORDS.iterdir()} - by_examples
    assert found == {file for file in WRITTEN if file.endswith(".csv")}


def test_the_picture_of_a_record_is_among_the_pictures_and_that_of_another_table_next_to_it(tmp_path):
    assert records.picture_of(records.RECORDS / "roundoff.csv") == records.PICTURES / "roundoff.png"
    assert records.picture_of(tmp_path / "roundoff.csv") == tmp_path / "roundoff.png"


def imported(script):
    """Whether other scripts or tests import a script."""
    *folders, name = script.removesuffix(".py").split("/")
    package = ".".join(("benchmarks", *folders))
    line = re.compile(rf"^from {package}(\.{name} import|\s+import\b.*\b{name}\b)", re.MULTILINE)
    files = (file for folder in (BENCHMARKS, ROOT / "tests") for file in folder.rglob("*.py"))
    return any(line.search(file.read_text(encoding="utf-8")) for file in files if file != BENCHMARKS / script)


def test_every_script_has_a_record_or_is_imported():
    without = [script.strip("`") for script, *_, cell in ROWS if not cell]
    assert [script for script in without if not imported(script)] == []


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_can_be_imported(name):
    importlib.import_module("benchmarks." + name.removesuffix(".py").replace("/", "."))


def test_a_record_keeps_what_is_there_and_takes_a_run_again_in_its_place(tmp_path, capsys):
    record = records.Record(tmp_path / "found.csv", ("scheme", "fs"), ("error",), order=lambda row: float(row["fs"]))
    for scheme, fs, error in (("V2", 4, "2e-3"), ("V2", 2, "5e-4"), ("V2", 4, "3e-3")):
        record.add({"error": error, "scheme": scheme, "fs": fs})
    assert {"scheme": "V2", "fs": 2} in record
    assert {"scheme": "S2_2", "fs": 2} not in record
    assert (tmp_path / "found.csv").read_text(encoding="utf-8") == "scheme,fs,error\nV2,2,5e-4\nV2,4,3e-3\n"
    assert capsys.readouterr().out.splitlines() == ["V2  4  2e-3", "V2  2  5e-4", "V2  4  3e-3"]


def test_the_spread_is_that_within_windows():
    """A step between two halves counts in windows as long as the run, and not in shorter ones."""
    energies = np.repeat([1.0, 3.0], 100) + np.tile([0.1, -0.1], 100)
    assert spread([energies], 2.0) == pytest.approx((0.1, np.sqrt(1.01)))
    assert spread([energies, np.full(200, np.inf)], 2.0) == (np.inf, np.inf)


def test_contenders_take_turns():
    calls = []
    times = in_turns({name: partial(calls.append, name) for name in "abc"}, 2)
    assert calls == list("abccba")
    assert {name: len(some) for name, some in times.items()} == {"a": 2, "b": 2, "c": 2}


def test_canonical_starts_have_their_temperature_and_repeat_their_bits():
    def start():
        _, system, positions = rb.rigid_water(27)
        return canonical(context_of(system, thermostat(300.0, seed=3), positions), 300, 50, seed=3)[1]

    (x, v), (again, w) = (positions_and_velocities(start()) for _ in range(2))
    np.testing.assert_array_equal(x, again)
    np.testing.assert_array_equal(v, w)
    masses = masses_of(rb.rigid_water(27)[1])
    assert (masses @ (v * v).sum(axis=1)) / (6 * 27 * R) == pytest.approx(300.0, rel=5.0 * np.sqrt(2.0 / (6 * 27)))


def test_copies_of_a_box_have_so_many_times_its_energy():
    topology, places = proteins.solvated(proteins.PEPTIDE)
    system, counts = proteins.system_of(topology), (1, 2, 1)
    (nonbonded,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    nonbonded.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
    nonbonded.setUseDispersionCorrection(False)  # not proportional to the number of particles, by one in N
    places = np.array(places.value_in_unit(nanometer))
    vectors = np.array([v.value_in_unit(nanometer) for v in system.getDefaultPeriodicBoxVectors()])
    large = proteins.tiled(system, counts), proteins.tiled_positions(places, vectors, counts)
    energies = []
    for box, start in (system, places), large:
        context = context_of(box, thermostat(), start)
        energies.append(context.getState(energy=True).getPotentialEnergy()._value)
    assert energies[1] == pytest.approx(2.0 * energies[0], rel=2e-6)
    assert large[0].getNumConstraints() == 2 * system.getNumConstraints()
