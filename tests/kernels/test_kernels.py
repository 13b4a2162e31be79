"""Compiled kernels: blocks of bodies, and the cache."""

import shutil
from pathlib import Path

import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.kernels import build
from openmm_exactrb.mathematics import quaternions

PACKAGE = Path(rb.__file__).parent


def test_the_number_of_bodies_is_not_bound_to_blocks(rng):
    for n in (1, 63, 64, 65, 130):
        q, m = quaternions.random(rng, n), rng.standard_normal((n, 3))
        together = rb.free_rotor([0.5, 0.8, 1.0], q, m, 0.1, method="exact_compiled")
        alone = [rb.free_rotor([0.5, 0.8, 1.0], *body, 0.1, method="exact_compiled") for body in zip(q, m, strict=True)]
        for one, many in zip(zip(*alone, strict=True), together, strict=True):
            np.testing.assert_array_equal(np.array(one), many)


def test_another_source_of_the_kernels_is_another_key_of_the_cache(tmp_path, monkeypatch):
    """What is inlined into a function is in files that numba does not look at."""
    copied = shutil.copytree(PACKAGE, tmp_path / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(build, "_PACKAGE", copied)
    keys = []
    for file in ("kernels/compiled/bodies.py", "kernels/compiled/bodies.py", "mathematics/elliptic.py"):
        keys.append(build.sources.__wrapped__())
        (copied / file).write_text((copied / file).read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert len(set(keys)) == 3
