"""Compiled kernels: they agree with numpy, are compiled once, and nobody needs them."""

import os
import subprocess
import sys

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb import bodies as rigid
from openmm_exactrb import kernels, quaternions


def python(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done


def test_the_twins_of_the_rotor_agree(bodies):
    inertia, q, m = bodies
    for t in (0.05, np.linspace(-30.0, 30.0, len(q))):
        q1, m1 = rb.free_rotor(inertia, q, m, t, method="exact_numpy")
        q2, m2 = rb.free_rotor(inertia, q, m, t, method="exact_compiled")
        np.testing.assert_allclose(q2, q1, rtol=0.0, atol=3e-14)
        np.testing.assert_allclose(m2, m1, rtol=0.0, atol=3e-14)


def test_the_number_of_bodies_is_not_bound_to_blocks(rng):
    for n in (1, 63, 64, 65, 130):
        q, m = quaternions.random(rng, n), rng.standard_normal((n, 3))
        together = rb.free_rotor([0.5, 0.8, 1.0], q, m, 0.1, method="exact_compiled")
        alone = [rb.free_rotor([0.5, 0.8, 1.0], *body, 0.1, method="exact_compiled") for body in zip(q, m, strict=True)]
        for one, many in zip(zip(*alone, strict=True), together, strict=True):
            np.testing.assert_array_equal(np.array(one), many)


def test_the_twins_of_particles_agree(rng):
    _, system, x = rb.rigid_water(20, model="tip5p")
    bodies = rigid.find_bodies(system, x)
    state = rigid.BodyState(
        rng.standard_normal((3, 20)),
        np.zeros((3, 20)),
        np.ascontiguousarray(quaternions.random(rng, 20).T),
        np.zeros((3, 20)),
    )
    F = rng.standard_normal(x.shape)
    (kind,) = bodies.kinds
    place, collect = rigid._particle_kernels()
    results = []
    for put, add in ((rigid._place, rigid._collect), (place, collect)):
        y, total, torque = np.zeros_like(x), np.zeros((3, 20)), np.zeros((3, 20))
        put(kind, state, y)
        add(kind, state, F, total, torque)
        results.append((y, total, torque))
    assert place is not rigid._place
    for numpy, compiled in zip(*results, strict=True):
        np.testing.assert_allclose(compiled, numpy, rtol=0.0, atol=2e-15 * np.abs(numpy).max())


def test_importing_the_package_does_not_import_numba():
    python("import sys, openmm_exactrb; assert 'numba' not in sys.modules")


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
    kernels.load.cache_clear()
    assert not kernels.available()
    with pytest.raises(ModuleNotFoundError, match=r'pip install "openmm-exactrb\[fast\]"'):
        rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1, method="exact_compiled")
    q, _ = rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1)
    assert np.isfinite(q).all()


def test_compiled_code_is_kept_between_processes(tmp_path):
    code = (
        "import openmm_exactrb as rb\n"
        "rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1)\n"
        "from openmm_exactrb.rotors.compiled import advance\n"
        "print(sum(advance.stats.cache_hits.values()))"
    )
    runs = [python(code, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)]
    assert [run.stdout.strip() for run in runs] == ["0", "1"]
    assert "compiling kernels" in runs[0].stderr
    assert not runs[1].stderr
