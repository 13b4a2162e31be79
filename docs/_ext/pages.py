"""Run every piece of Python of the README and of the documentation as it is printed, page by page.

What a piece prints is compared with the `{testoutput}` behind it. `make docs` runs README and documentation; the
tests only read them.
"""

from __future__ import annotations

import contextlib
import doctest
import gc
import io
import os
import re
import shutil
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from types import CodeType

ROOT = Path(__file__).resolve().parents[2]
# What pages import from beside a script, or read there.
sys.path += [str(ROOT / "examples"), str(ROOT / "benchmarks" / "constraints")]
DATA = ROOT / "examples" / "data"
DOCS = ROOT / "docs"
# Built pages, copies of the examples, and recipes that have tests of their own (tests/project/test_recipes.py).
ELSEWHERE = {DOCS / "_build", DOCS / "examples", DOCS / "contributing.md"}
PAGES = [ROOT / "README.md", *sorted(p for p in DOCS.rglob("*.md") if not ELSEWHERE & {p, *p.parents})]
PIECE = re.compile(
    r"^```(?:python|\{testcode\})\n(?P<code>.*?)^```$(?:\n+^```\{testoutput\}\n(?P<shown>.*?)^```$)?", flags=re.M | re.S
)


def pieces(page: Path) -> Iterator[tuple[CodeType, str | None]]:
    """Yield the compiled pieces of Python of a page and what it shows that they print; errors name its lines."""
    text = page.read_text(encoding="utf-8")
    for found in PIECE.finditer(text):
        code = re.sub(r"^:\w+:$", "", found["code"], flags=re.M)
        yield compile("\n" * text.count("\n", 0, found.start("code")) + code, str(page), "exec"), found["shown"]


def run(page: Path) -> None:
    """Run the pieces of a page one after the other, in a folder with examples and benchmarks; warnings are errors."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for name in ("examples", "benchmarks"):
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "out"))
        shutil.copytree(DATA, folder, dirs_exist_ok=True)
        stack.enter_context(contextlib.chdir(folder))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ResourceWarning)  # a script ends, and reporters with open files with it
        names = {"__name__": "__page__"}
        for piece, shown in pieces(page):
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(piece, names)
            printed = out.getvalue()
            if shown is not None and not doctest.OutputChecker().check_output(shown, printed, doctest.ELLIPSIS):
                raise AssertionError(f"the page shows\n{shown}but its piece printed\n{printed}")
        names.clear()
        gc.collect()


def failure(page: Path) -> str:
    """Run a page without a word; return the traceback of what went wrong, if anything did."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            run(page)
        except Exception:
            return traceback.format_exc()
    return ""


def main() -> None:
    """Run all pages of the documentation, several at once."""
    import joblib  # the tests, which read the pages, do without

    # Without a screen, on whatever device a machine has: some drivers fail.
    os.environ |= {"MPLBACKEND": "agg", "OPENMM_DEFAULT_PLATFORM": "CPU"}
    os.environ.setdefault("OPENMM_CPU_THREADS", "1")
    failed = 0
    with ProcessPoolExecutor(joblib.cpu_count(), mp_context=get_context("spawn")) as pool:
        runs = {pool.submit(failure, page): page for page in PAGES if DOCS in page.parents and any(pieces(page))}
        for done in as_completed(runs):
            if told := done.result():
                failed += 1
                print(f"{runs[done].relative_to(ROOT)}:\n{told}", file=sys.stderr)
    if failed:
        sys.exit(f"{failed} of {len(runs)} pages with Python do not run as they are printed")


if __name__ == "__main__":
    main()
