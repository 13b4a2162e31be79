"""What a step on the device enqueues: kernels, and nothing that is sent or waited for."""

import collections
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from devices import opencl

import openmm_exactrb as rb

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    """Return a library that says what is enqueued."""
    opencl()
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("launches are counted on Linux with a C compiler")
    library = tmp_path_factory.mktemp("shim") / "launches.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", HERE / "launches.c", "-o", library, "-ldl"], check=True)
    return library


def enqueued(shim, kind, scheme):
    """Return how often each thing is enqueued in a step, from two calls that differ by ten steps."""
    paths = [str(Path(rb.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"LD_PRELOAD": str(shim), "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    done = subprocess.run(
        [sys.executable, HERE / "launching.py", kind, scheme],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    _, few, many, _ = done.stderr.split("steps ")
    few, many = (collections.Counter(line for line in part.splitlines()[1:]) for part in (few, many))
    many.subtract(few)
    return {name.removeprefix("launch "): count / 10.0 for name, count in many.items() if count}


@pytest.mark.parametrize(("kind", "scheme"), [("plain", "S2_2"), ("plain", "PEFRL"), ("langevin", "S2_2")])
def test_three_kernels_a_stage_and_one_a_step_two_sums_and_nothing_sent(shim, kind, scheme):
    counts, stages = enqueued(shim, kind, scheme), rb.SCHEMES[scheme].stages
    assert counts["computePerDof"] == 3 * stages + 1
    assert counts["computeBondedForces"] == 2 * stages
    assert counts["computeNonbonded"] == stages
    assert "upload" not in counts
    assert "read" not in counts


def test_the_remover_of_the_motion_of_the_centre_of_mass_costs_one_sum_a_step(shim):
    counts = enqueued(shim, "remover", "S2_2")
    assert counts["computePerDof"] == 3 * 2 + 1 + 2
    assert counts["computeBondedForces"] == 2 * 2 + 1
    assert "upload" not in counts
    assert "read" not in counts


def test_a_displaced_place_costs_another_stage(shim):
    counts = enqueued(shim, "plain", "Chin4A")
    forces = rb.SCHEMES["Chin4A"].forces
    assert counts["computeNonbonded"] == forces
    assert counts["computePerDof"] == 3 * forces + 1
    assert counts["computeBondedForces"] == 2 * forces
    assert "upload" not in counts
