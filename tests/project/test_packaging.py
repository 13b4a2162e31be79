"""What is said about the package in several places is the same in all of them."""

import json
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from publish import publish

from openmm_exactrb.library import compilation
from openmm_exactrb.library.compilation import OPENMM

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RECIPE = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))


def lowest(requirements):
    """Return the lowest version of each requirement that has one, by name."""
    found = (re.fullmatch(r"([\w-]+)(?:\[.*\])? ?>=([\d.]+)(?:,<[\d.]+)?", text) for text in requirements)
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


def test_the_version_of_openmm_is_that_of_the_library():
    """Classes have another layout in every minor version."""
    major, minor = map(int, OPENMM.split("."))
    allowed = f">={OPENMM},<{major}.{minor + 1}"
    assert f"openmm{allowed}" in PROJECT["dependencies"]
    assert f"openmm {allowed}" in RECIPE["requirements"]["run"]
    assert f"openmm {allowed}" in RECIPE["requirements"]["host"]
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    assert f'"openmm{allowed}"' in text


def test_the_versions_of_python_are_those_that_are_tested():
    found = [re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", text) for text in PROJECT["classifiers"]]
    tests = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8"))
    assert [match[1] for match in found if match] == tests["jobs"]["tests"]["strategy"]["matrix"]["python"]


def test_the_library_can_be_compiled_where_only_openmm_is_installed():
    """As in the environments where wheels are built."""
    absent = ("numba", "numpy", "scipy", "openmm_exactrb")
    script = f"""
import openmm, runpy, sys
sys.modules |= dict.fromkeys({absent!r})
print(runpy.run_path({compilation.__file__!r})["openmm_folder"]())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()) == compilation.openmm_folder()


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


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 75


def test_addresses_are_the_same_everywhere():
    """Empty until an owner fills them in: packaging/README.md."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    addresses = tool["hatch"]["metadata"]["hooks"]["custom"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    for name, in_citation in (("repository", "repository-code"), ("documentation", "url")):
        assert RECIPE["about"].get(name, "") == citation.get(in_citation, "") == addresses[name]
    clone = f"git clone {addresses['repository'] or 'ADDRESS-OF-THIS-REPOSITORY'} openmm-exactrb"
    for page in ("README.md", "docs/install.md"):
        assert clone in (ROOT / page).read_text(encoding="utf-8")


def test_a_site_has_all_versions_and_leads_to_the_newest_release(tmp_path):
    html, site = tmp_path / "html", tmp_path / "site"
    html.mkdir()
    (html / "index.html").write_text("first", encoding="utf-8")
    site.mkdir()
    assert publish(html, site, "dev") == ["dev"]
    assert 'url=dev/index.html"' in (site / "index.html").read_text(encoding="utf-8")
    for name in ("v0.9.0", "v0.10.0"):
        publish(html, site, name)
    (html / "index.html").write_text("second", encoding="utf-8")
    assert publish(html, site, "dev") == ["v0.10.0", "v0.9.0", "dev"]
    assert (site / "dev" / "index.html").read_text(encoding="utf-8") == "second"
    assert json.loads((site / "versions.json").read_text(encoding="utf-8")) == ["v0.10.0", "v0.9.0", "dev"]
    assert 'url=v0.10.0/index.html"' in (site / "index.html").read_text(encoding="utf-8")


def test_links_are_absolute_where_the_repository_is_known():
    pytest.importorskip("hatchling", reason="it builds the package, and is not needed to run it")
    hook = runpy.run_path(str(ROOT / "hatch_build.py"))
    text = "![a](docs/a.png) [b](docs/b.md#c) [d](https://e.org) [f](#g) [h](LICENSE)"
    picture, rest = "![a](https://x.org/y/raw/v1/docs/a.png)", "[d](https://e.org) [f](#g)"
    licence = "[h](https://x.org/y/blob/v1/LICENSE)"
    page = "[b](https://x.org/y/blob/v1/docs/b.md#c)"
    assert hook["absolute"](text, "v1", "https://x.org/y") == f"{picture} {page} {rest} {licence}"
    page = "[b](https://p.org/b.html#c)"
    assert hook["absolute"](text, "v1", "https://x.org/y", "https://p.org") == f"{picture} {page} {rest} {licence}"
    assert list(hook["addresses"]("")) == ["Paper"]
    assert list(hook["addresses"]("https://x.org/y", "https://p.org"))[:3] == ["Documentation", "Paper", "Repository"]
