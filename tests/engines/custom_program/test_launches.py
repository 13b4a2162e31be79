"""What a step on the device enqueues: kernels, and nothing that is sent or waited for."""

import collections
import itertools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from devices import opencl

import openmm_exactrb as rb

HERE = Path(__file__).parent
pytestmark = pytest.mark.opencl


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


RIGID = (("langevin", "S2_2"), ("plain", "Chin4A"))
RUNS = (*RIGID, ("nested", "S2_3"))


@pytest.fixture(scope="module")
def enqueued(shim):
    """Return how often each thing is enqueued in a step of each run, from two calls that differ by ten steps."""
    paths = [str(Path(rb.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"LD_PRELOAD": str(shim), "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = [sys.executable, HERE / "launching.py", *itertools.chain(*RUNS)]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    calls, found = done.stderr.split("steps ")[1:], {}
    for run, few, many in zip(RUNS, calls[0::3], calls[1::3], strict=True):
        few, many = (collections.Counter(line for line in call.splitlines()[1:]) for call in (few, many))
        many.subtract(few)
        found[run] = {name.removeprefix("launch "): count / 10.0 for name, count in many.items() if count}
    return found


@pytest.mark.parametrize("run", RIGID, ids="-".join)
def test_three_kernels_and_two_sums_for_each_force_one_kernel_a_step_and_nothing_sent(enqueued, run):
    """Beside the thermostat a remover of the motion of the centre of mass costs a sum, and two kernels for it."""
    counts, (kind, scheme) = enqueued[run], run
    forces, removes = rb.SCHEMES[scheme].forces, kind == "langevin"
    assert counts["computePerDof"] == 3 * forces + 1 + 2 * removes
    assert counts["computeBondedForces"] == 2 * forces + removes
    assert counts["computeNonbonded"] == forces
    assert "upload" not in counts
    assert "read" not in counts


def test_an_inner_step_takes_seven_kernels_and_nothing_is_sent(enqueued):
    """Of a peptide in water; what is read is the size of the neighbour list, once an evaluation as in Verlet's steps.

    S2_3 has 13 kicks by bonded forces in the six inner steps of three evaluations, the two at the ends of a step apart.
    """
    counts, forces = dict(enqueued["nested", "S2_3"]), 3
    bonded = counts["applyShakeToPositions"]
    assert bonded == 13.0
    assert counts["computeNonbonded"] == forces
    assert counts.pop("read") == forces
    assert "upload" not in counts
    assert sum(counts.values()) / forces <= 66.0
    for name in ("applySettleToPositions", "applyShakeToPositions", "applyPositionDeltas"):
        assert counts[name] == bonded
    for name in ("clearFourBuffers", "computeBondedForces", "reduceForces"):  # two sums for each of the other forces
        assert counts[name] == bonded + 3 * forces
    # Behind a drift, two sums and a kick, and the rotation; a first kick, images, and two for what is shown.
    assert counts["computePerDof"] == bonded + 5 * forces + 4
