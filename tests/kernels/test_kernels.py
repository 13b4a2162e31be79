"""Compiled kernels: which are taken, that they are compiled once, and that nobody needs them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb import kernels
from openmm_exactrb.kernels import build
from openmm_exactrb.mathematics import quaternions

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


#: A process in which numba cannot be imported, or is not to be used; `step` makes two steps of a System.
STEP = """
import sys
import numpy as np, openmm, openmm_exactrb as rb

def step(system, positions):
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    integrator.setVelocitiesToTemperature(100.0, 1)
    integrator.step(2)
    assert np.isfinite(integrator.totalEnergy()._value)
"""
RIGID = """
rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1)
_, system, positions = rb.rigid_water(4)
step(system, positions)
_, system, positions = rb.dipole_fluid(4, trap=0.5)
step(system, positions)
"""
FLEXIBLE = """
system = openmm.System()
for mass in (12.0, 1.0, 1.0):
    system.addParticle(mass)
system.addConstraint(0, 1, 0.1)
system.addConstraint(0, 2, 0.1)
"""


def test_rigid_bodies_need_no_numba_and_flexible_molecules_without_it_are_refused_before_the_first_step():
    positions = "[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]"
    code = f"""
try:
    step(system, {positions})
except ModuleNotFoundError as error:
    assert error.name == "numba"
    print(error)
"""
    done = python("import sys; sys.modules['numba'] = None" + STEP + RIGID + FLEXIBLE + code)
    assert done.stdout.strip() == (
        'flexible molecules with constraints need numba: python -m pip install "openmm-exactrb[fast]"'
    )


def test_numba_can_be_refused_but_for_flexible_molecules():
    refused = STEP + RIGID + "assert 'numba' not in sys.modules"
    taken = FLEXIBLE + "step(system, [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])\nassert 'numba' in sys.modules"
    python(refused + taken, **{kernels.SWITCH: "0"})


def test_what_is_missing_is_said(monkeypatch):
    monkeypatch.setattr(kernels, "find_spec", lambda name: None)
    assert not kernels.available()
    with pytest.raises(
        ModuleNotFoundError, match=r"compiled kernels need numba: python -m pip install .openmm-exactrb\[fast\]"
    ):
        rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1, method="exact_compiled")
    q, _ = rb.free_rotor([1, 2, 3], [1, 0, 0, 0], [1, 1, 1], 0.1)
    assert np.isfinite(q).all()


def test_another_source_of_the_kernels_is_another_key_of_the_cache(tmp_path, monkeypatch):
    """What is inlined into a function is in files that numba does not look at."""
    copied = shutil.copytree(PACKAGE, tmp_path / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(build, "_PACKAGE", copied)
    keys = []
    for file in ("kernels/compiled/bodies.py", "kernels/compiled/bodies.py", "mathematics/elliptic.py"):
        keys.append(build.sources.__wrapped__())
        (copied / file).write_text((copied / file).read_text() + "\n")
    assert len(set(keys)) == 3
