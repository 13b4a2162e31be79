"""What each command of the Makefile installs is what its scripts import."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest
from pages import PAGES, PIECE

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RULES = re.findall(r"^([^\s#:]+): (.*)\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
EXAMPLES = sorted((ROOT / "examples").rglob("*.py"))
#: Our modules by the names by which they are imported.
LOCAL = {
    name: path
    for folder, home in (("benchmarks", "."), ("docs/_ext", "docs/_ext"), ("examples", "examples"), ("tests", "tests"))
    for path in (ROOT / folder).rglob("*.py")
    for name in (path.stem, ".".join(path.relative_to(ROOT / home).with_suffix("").parts))
}
#: Modules that another name brings, or which a requirement has among its own.
COMES_WITH = {
    "PIL": "matplotlib",
    "cloudpickle": "dask",
    "distributed": "dask",
    "docutils": "sphinx",
    "llvmlite": "numba",
    "mpl_toolkits": "matplotlib",
    "openmm_exactrb": "openmm-exactrb",
    "physical_validation": "physical-validation",
    "yaml": "dask",
}


@cache
def imported(script: Path) -> set[str]:
    """Return what a script imports, and what our modules that it imports do at once; not what tests are skipped for."""
    found, seen, todo = set(), set(), [script]
    while todo:
        path = todo.pop()
        tree = tree_of(path)
        seen.add(path)
        new = set(names(tree, at_once=path != script))
        found |= top(new) - top(skipped_without(path))
        todo += [LOCAL[name] for name in new & set(LOCAL) if LOCAL[name] not in seen]
    return found


def top(modules: Iterable[str]) -> set[str]:
    """Return the packages of modules that are not ours."""
    return {name.split(".")[0] for name in modules} - {name.split(".")[0] for name in LOCAL}


@cache
def tree_of(path: Path) -> ast.Module:
    """Return a file as a syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


def skipped_without(path: Path) -> list[str]:
    """Return the modules without which `pytest.importorskip` skips a test."""
    return re.findall(r'pytest\.importorskip\("([\w.]+)"', path.read_text(encoding="utf-8"))


def names(node: ast.AST, at_once: bool = False) -> Iterator[str]:
    """Yield the modules that a piece of code imports: all that it cannot do without, or those of its top level."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and not node.level:
        yield node.module
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    for child in ast.iter_child_nodes(node):
        tried = isinstance(node, ast.Try) and child in node.body
        if not (tried or isinstance(child, ast.expr) or (at_once and isinstance(child, ast.FunctionDef))):
            yield from names(child, at_once)


def distributions(modules: set[str]) -> set[str]:
    """Return the packages on PyPI that have modules."""
    return {COMES_WITH.get(name, name) for name in modules if name not in sys.stdlib_module_names}


def installed(requirements: list[str]) -> set[str]:
    """Return the names of requirements, with those of the extras of this project."""
    found = set()
    for requirement in requirements:
        name, extras = re.match(r"([\w-]+|\.)(?:\[(.*?)\])?", requirement).groups()
        found.add("openmm-exactrb" if name == "." else name)
        if name in (".", "openmm-exactrb"):
            found |= installed(PROJECT["dependencies"])
            for extra in (extras or "").split(",") if extras else ():
                found |= installed(PROJECT["optional-dependencies"][extra])
    return found


def recipe(target: str) -> list[str]:
    """Return the commands of a target and of all that it needs."""
    lines = []
    for name, needs, commands in RULES:
        if name == target:
            lines += [line for need in needs.split() for line in recipe(need)]
            lines += commands.splitlines()
    return lines


def scripts(commands: list[str]) -> Iterator[Path]:
    """Yield the scripts of this project that commands run."""
    for command in commands:
        yield from (ROOT / path for path in re.findall(r"\$\(BIN\)/python ([\w/]+\.py)", command))
        if "-m pytest" in command:
            yield from sorted((ROOT / "tests").rglob("*.py"))
        if "-m sphinx" in command:
            yield from [ROOT / "docs" / "conf.py", *EXAMPLES]


def pip_installs(commands: list[str]) -> list[str]:
    """Return the requirements that commands install."""
    words = [word.strip('"') for line in commands for word in line.partition("pip install ")[2].split()]
    return [word for word in words if not word.startswith(("-", "constraints/"))]


TARGETS = ("run", "test", "coverage", "lowest", "lint", "docs", "browse", "validate", "benchmarks", "paper")


@pytest.mark.parametrize("target", TARGETS, ids="make {}".format)
def test_a_command_installs_what_its_scripts_import(target):
    commands = recipe(target)
    ours = list(scripts(commands))
    assert ours
    needed = {name for script in ours for name in distributions(imported(script))}
    assert needed - installed(pip_installs(commands)) == set()


def test_pages_import_what_the_documentation_installs():
    pieces = [piece["code"] for page in PAGES for piece in PIECE.finditer(page.read_text(encoding="utf-8"))]
    found = {name for piece in pieces for name in names(ast.parse(re.sub(r"^:\w+:$", "", piece, flags=re.M)))}
    needed = distributions(top(found))
    assert "numpy" in needed
    assert needed - installed(["openmm-exactrb[docs]"]) == set()


def test_notebooks_install_what_the_examples_import():
    requirement = re.search(r'%pip install --quiet "\.\.\[(.*)\]"', (ROOT / "docs/conf.py").read_text(encoding="utf-8"))
    needed = {name for script in EXAMPLES for name in distributions(imported(script))}
    assert needed - installed([f"openmm-exactrb[{requirement[1]}]"]) == set()
