"""The Python in the README and on the pages compiles, and takes names that exist; `make docs` runs it as printed."""

import ast
import doctest
import importlib
import re
import sys
from importlib.util import find_spec

import matplotlib as mpl
import pytest
from pages import PAGES, PIECE, ROOT, pieces, run

import openmm_exactrb

PATH = re.compile(r"`((?:tests|benchmarks|examples|docs|openmm_exactrb)/[\w./-]*\w)`")
WITH_PYTHON = [page for page in PAGES if any(pieces(page))]
MODULES = sorted((ROOT / "openmm_exactrb").rglob("*.py"))
WITH_EXAMPLES = [
    ".".join(p.relative_to(ROOT).with_suffix("").parts) for p in MODULES if ">>> " in p.read_text(encoding="utf-8")
]


def name_of(page):
    return str(page.relative_to(ROOT))


@pytest.mark.validate
@pytest.mark.parametrize("page", WITH_PYTHON, ids=name_of)
def test_pieces_run_as_they_are_printed(page, monkeypatch):
    monkeypatch.setenv("OPENMM_DEFAULT_PLATFORM", "CPU")  # on whatever device a machine has, some drivers fail
    with mpl.rc_context({"backend": "agg"}):
        run(page)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_in_docstrings_print_what_they_show(module):
    assert doctest.testmod(importlib.import_module(module), extraglobs=vars(openmm_exactrb)).failed == 0


def imported(tree):
    """Yield the modules and names that pieces import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.module, alias.name) for alias in node.names)


def test_names_that_pages_take_from_the_package_exist():
    """Imports of every page, and attributes of `rb`, without running anything."""
    rb, missing = importlib.import_module("openmm_exactrb"), []
    for page in WITH_PYTHON:
        code = "".join(code for code, _ in PIECE.findall(page.read_text(encoding="utf-8")))
        tree = ast.parse(re.sub(r"^:\w+:$", "", code, flags=re.M))
        for module, name in imported(tree):
            if name is None or hasattr(importlib.import_module(module), name):
                continue
            if not hasattr(sys.modules[module], "__path__") or find_spec(f"{module}.{name}") is None:
                missing.append((name_of(page), module, name))
        missing += [
            (name_of(page), "rb", node.attr)
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rb"
            if not hasattr(rb, node.attr)
        ]
    assert missing == []


#: Files that a reader of a recipe makes.
MADE = {"benchmarks/schemes/stable_steps.py"}


def test_files_that_pages_name_exist():
    missing = [
        (name_of(page), name)
        for page in (*PAGES, ROOT / "docs" / "contributing.md", ROOT / "CONTRIBUTING.md")
        for name in PATH.findall(page.read_text(encoding="utf-8"))
        if not (ROOT / name).exists() and name not in MADE
    ]
    assert missing == []


LINK = re.compile(r"\]\((?![a-z]+:|#)([^)#\s]+)")
MARKDOWN = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), *(ROOT / "packaging").rglob("*.md")]


def test_links_lead_to_files_of_the_repository():
    """As a forge shows the pages: nothing that only a build makes, and no substitutions of Sphinx."""
    wrong, made = [], {ROOT / "docs" / "examples", ROOT / "docs" / "_build"}
    left_out = () if (ROOT / ".github").exists() else (".png", ".gif", ".svg", ".yml")  # of an sdist
    for page in (page for page in MARKDOWN if not made & {*page.parents}):
        text = re.sub(r"^(```+).*?^\1$|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        targets = {target: (page.parent / target).resolve() for target in LINK.findall(text)}
        targets = {name: target for name, target in targets.items() if not name.endswith(left_out)}
        wrong += [(name_of(page), name) for name, t in targets.items() if not t.exists() or made & {t, *t.parents}]
        wrong += [(name_of(page), name) for name in re.findall(r"\{\{ \w+ \}\}", text)]
    assert wrong == []


def test_the_root_of_the_pages_has_no_records_and_pictures():
    files = [file for file in (ROOT / "docs").iterdir() if file.is_file()]
    assert {file.suffix for file in files} == {".md", ".py"}
    assert len(files) <= 16
