"""A script that goes on in another process, and one that is interrupted."""

import os
import signal
import subprocess
import sys
import time

import mdtraj
import numpy as np
import pytest
from boxes import coordinates, quietly, water

# What a user's script does before it steps; it is handed the file to go on from.
SCRIPT = """
import sys
sys.path[:0] = {path!r}
from boxes import coordinates, quietly, water
from openmm import app
import numpy as np
for load, file in zip(("loadCheckpoint", "loadState"), sys.argv[1:], strict=True):
    simulation = water(minimise=0)
    getattr(simulation, load)(file)
    simulation.reporters.append(app.DCDReporter(file + ".dcd", 2, enforcePeriodicBox=False))
    quietly(simulation.step, 6)
    assert simulation.currentStep == 10
    np.save(file, coordinates(simulation))
"""


def python(*arguments):
    return subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, check=False)


def test_a_new_process_continues_with_the_same_bits(tmp_path):
    """From a checkpoint and from an XML file of the state."""
    simulation = water()
    quietly(simulation.step, 4)
    files = [tmp_path / "checkpoint", tmp_path / "state"]
    simulation.saveCheckpoint(str(files[0]))
    simulation.saveState(str(files[1]))
    quietly(simulation.step, 6)
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(path=sys.path))
    done = python(script, *files)
    assert done.returncode == 0, done.stderr
    for file in files:
        np.testing.assert_array_equal(np.load(f"{file}.npy"), coordinates(simulation))


INTERRUPTED = """
import signal
import sys
sys.path[:0] = {path!r}
from boxes import coordinates, quietly, water, energy
from openmm import app
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever began the tests may have it ignored
simulation = water()
simulation.reporters.append(app.DCDReporter(sys.argv[1], 10))  # seldom, so that hardly ever a frame is cut
print("ready", flush=True)
try:
    quietly(simulation.step, 100000)
except KeyboardInterrupt:
    simulation.reporters.clear()
    steps = simulation.context.getStepCount()
    simulation.step(3)
    assert simulation.context.getStepCount() == steps + 3
    assert abs(energy(simulation) - simulation.integrator.totalEnergy()._value) < 1e-6
    print("gone on from", steps)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_leaves_a_state_to_continue_from(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED.format(path=sys.path))
    with subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "run.dcd")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "ready\n"
        while not (tmp_path / "run.dcd").exists() or (tmp_path / "run.dcd").stat().st_size < 5000:
            time.sleep(0.05)
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=600)
    assert "gone on from" in out, errors
    steps = int(out.split()[-1])
    frames = mdtraj.load_dcd(str(tmp_path / "run.dcd"), top=mdtraj.Topology.from_openmm(water().topology))
    assert steps // 10 - 1 <= len(frames) <= steps // 10 + 1
