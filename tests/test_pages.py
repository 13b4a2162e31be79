"""Every piece of Python in the README and in the documentation runs as it is printed, page by page."""

import gc
import re
import warnings
from pathlib import Path

import matplotlib as mpl
import pytest

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
# Built pages, copies of the examples, and recipes that have tests of their own.
ELSEWHERE = {DOCS / "_build", DOCS / "examples", DOCS / "contributing.md"}
PAGES = [ROOT / "README.md", *sorted(p for p in DOCS.rglob("*.md") if not ELSEWHERE & {p, *p.parents})]
PIECE = re.compile(r"^```(?:python|\{testcode\})\n(.*?)^```$", flags=re.M | re.S)
PATH = re.compile(r"`((?:tests|benchmarks|examples|docs|openmm_exactrb)/[\w./-]*\w)`")


def pieces(page):
    """Yield the pieces of Python of a page, each with the line where it begins."""
    text = page.read_text(encoding="utf-8")
    for found in PIECE.finditer(text):
        yield text.count("\n", 0, found.start(1)), re.sub(r"^:\w+:$", "", found[1], flags=re.M)


@pytest.mark.parametrize("page", [p for p in PAGES if any(pieces(p))], ids=lambda p: str(p.relative_to(ROOT)))
def test_pieces_run_as_they_are_printed(page, tmp_path, monkeypatch):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENMM_DEFAULT_PLATFORM", "CPU")  # on whatever device a machine has, some drivers fail
    names = {"__name__": "__page__"}
    with mpl.rc_context({"backend": "agg"}), warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # a script ends, and reporters with open files with it
        for line, code in pieces(page):
            exec(compile("\n" * line + code, str(page), "exec"), names)
        names.clear()
        gc.collect()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_that_a_page_names_exist(page):
    missing = [name for name in PATH.findall(page.read_text(encoding="utf-8")) if not (ROOT / name).exists()]
    assert missing == []
