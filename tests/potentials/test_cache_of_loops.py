"""The cache of compiled loops."""

import shutil
from pathlib import Path

import openmm_exactrb as rb
from openmm_exactrb.kernels import build

PACKAGE = Path(rb.__file__).parent


def test_another_source_of_the_loops_is_another_key_of_the_cache(tmp_path, monkeypatch):
    """What is inlined into a function is in files that numba does not look at."""
    copied = shutil.copytree(PACKAGE, tmp_path / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(build, "_PACKAGE", copied)
    keys = []
    for file in ("potentials/compiled/pair.py", "potentials/compiled/pair.py", "mathematics/elliptic.py"):
        keys.append(build.sources.__wrapped__())
        (copied / file).write_text((copied / file).read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert len(set(keys)) == 3
