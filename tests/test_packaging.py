"""What is said about the package in several places is the same in all of them."""

import re
import runpy
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RECIPE = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))


def lowest(requirements):
    """Return the lowest version of each requirement that has one, by name."""
    found = (re.fullmatch(r"([\w-]+)(?:\[.*\])? ?>=([\d.]+)", text) for text in requirements)
    return {match[1]: tuple(map(int, match[2].split("."))) for match in found if match}


def test_the_lowest_versions_are_those_that_are_tested():
    text = (ROOT / "constraints" / "lowest.txt").read_text(encoding="utf-8")
    pinned = {
        name: tuple(map(int, version.split("."))) for name, version in re.findall(r"^([\w-]+)==(.*)$", text, re.M)
    }
    extras = PROJECT["optional-dependencies"]
    tested = [
        *PROJECT["dependencies"],
        *(r for e in ("ensemble", "examples", "plot", "test") for r in extras[e]),
    ]
    allowed = lowest(tested)
    assert set(pinned) == set(allowed)
    for name, version in allowed.items():
        assert pinned[name][: len(version)] == version
        assert not any(pinned[name][len(version) :]), "the first one of its row"


def test_the_conda_recipe_says_what_the_project_says():
    needed = lowest(RECIPE["requirements"]["run"])
    assert needed.pop("python") == lowest([f"python{PROJECT['requires-python']}"])["python"]
    assert needed == lowest(PROJECT["dependencies"])
    assert RECIPE["context"]["version"] == PROJECT["version"]
    commands = [f"{name} = {target}" for name, target in PROJECT["scripts"].items()]
    assert RECIPE["build"]["python"]["entry_points"] == commands
    assert RECIPE["about"]["summary"] == PROJECT["description"]


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["license"]) == (PROJECT["version"], PROJECT["license"])


def test_links_of_the_readme_lead_to_files():
    targets = re.findall(r"\]\((?![a-z]+:|#)([^)]+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert targets
    assert [target for target in targets if not (ROOT / target.partition("#")[0]).exists()] == []


def test_links_are_absolute_where_the_repository_is_known():
    pytest.importorskip("hatchling", reason="it builds the package, and is not needed to run it")
    hook = runpy.run_path(str(ROOT / "hatch_build.py"))
    text = "![a](docs/a.png) [b](docs/b.md#c) [d](https://e.org) [f](#g)"
    assert hook["absolute"](text, "https://x.org/y", "v1") == (
        "![a](https://x.org/y/raw/v1/docs/a.png) [b](https://x.org/y/blob/v1/docs/b.md#c) [d](https://e.org) [f](#g)"
    )
    assert list(hook["addresses"]("")) == ["Paper"]
