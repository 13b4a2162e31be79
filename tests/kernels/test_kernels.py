"""Compiled kernels: which are taken, that they are compiled once, and that nobody needs them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb import kernels, quaternions

PACKAGE = Path(rb.__file__).parent


def python(code, cwd=None, **environment):
    command, env = [sys.executable, "-c", code], os.environ | environment
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def test_the_number_of_bodies_is_not_bound_to_blocks(rng):
    for n in (1, 63, 64, 65, 130):
        q, m = quaternions.random(rng, n), rng.standard_normal((n, 3))
        together = rb.free_rotor([0.5, 0.8, 1.0], q, m, 0.1, method="exact_compiled")
        alone = [rb.free_rotor([0.5, 0.8, 1.0], *body, 0.1, method="exact_compiled") for body in zip(q, m, strict=True)]
        for one, many in zip(zip(*alone, strict=True), together, strict=True):
            np.testing.assert_array_equal(np.array(one), many)


def test_numba_can_be_refused():
    code = (
        "import sys, openmm_exactrb as rb\n"
        "rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1)\n"
        "rb.rigid_water(4)\n"
        "assert 'numba' not in sys.modules"
    )
    python(code, **{kernels.SWITCH: "0"})


def test_what_is_missing_is_said(monkeypatch):
    monkeypatch.setattr(kernels, "find_spec", lambda name: None)
    assert not kernels.available()
    with pytest.raises(ModuleNotFoundError, match="compiled kernels need numba: python -m pip install numba"):
        rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1, method="exact_compiled")
    q, _ = rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1)
    assert np.isfinite(q).all()


def test_compiled_code_is_kept_between_processes(tmp_path):
    code = (
        "from openmm_exactrb.kernels.compiled.sums import advance\n"  # the smallest one
        "print(sum(advance.stats.cache_hits.values()))"
    )
    runs = [python(code, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)]
    assert [run.stdout.strip() for run in runs] == ["0", "1"]
    assert "compiling kernels" in runs[0].stderr
    assert not runs[1].stderr


def test_another_source_of_the_kernels_is_another_key_of_the_cache(tmp_path):
    """What is inlined into a function is in files that numba does not look at."""
    copied = shutil.copytree(PACKAGE, tmp_path / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__"))
    code = "from openmm_exactrb.kernels.build import sources; print(sources())"
    keys = []
    for file in ("kernels/compiled/sums.py", "kernels/compiled/sums.py", "elliptic.py"):
        keys.append(python(code, tmp_path, PYTHONPATH=str(tmp_path)).stdout)
        (copied / file).write_text((copied / file).read_text() + "\n")
    assert len(set(keys)) == 3
