"""benchmarks/README.md lists every script with its question and record; each script can be imported."""

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "benchmarks"
README = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
SCRIPTS = sorted(str(file.relative_to(BENCHMARKS)) for file in BENCHMARKS.rglob("*.py") if file.name != "__init__.py")
#: Script, question, options, time and record of each row of a table.
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in README.splitlines() if line.startswith("| `")]
RECORDS = [record for *_, cell in ROWS for record in re.findall(r"`(.*?)`", cell)]


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
    assert [record for record in RECORDS if not (ROOT / record).exists()] == []


def test_every_table_of_the_documentation_has_its_script():
    by_examples = {"docs/ellipsoids.csv"}
    found = {f"docs/{file.name}" for file in (ROOT / "docs").glob("*.csv")} - by_examples
    assert found == {record for record in RECORDS if record.endswith(".csv")}


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_can_be_imported(name):
    importlib.import_module("benchmarks." + name.removesuffix(".py").replace("/", "."))
