"""
Runs that survive accidents
===========================

All longer examples have the options ``--checkpoint``, ``--resume`` and ``--overwrite``, which
:class:`openmm_exactrb.Run` also provides for your scripts. After Ctrl-C, SIGTERM, ``kill -9`` or a full disk, the same
command with ``--resume`` continues the run, and no frame and no line is lost or duplicated.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb


def make_simulation():
    topology, system, positions = rb.dipole_fluid(n=8, trap=0.5)
    integrator = rb.ExactRigidBodyIntegrator(0.02, "SRKN4_6b")
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    return simulation


# %%
# A ``Run`` has a folder, reporters and an interval between checkpoints. ``advance`` performs the steps up to a given
# step number, from the start or, with ``resume=True``, from the last checkpoint. For a command line,
# :meth:`Run.add_options <openmm_exactrb.Run.add_options>` and
# :meth:`Run.from_options <openmm_exactrb.Run.from_options>` provide the same settings as options.


def go(folder, until, resume=False):
    run = rb.Run(folder, resume=resume)
    run.add_reporter(app.DCDReporter, "trajectory.dcd", 10)
    run.add_reporter(rb.EnergyReporter, "energies.csv", 10)
    run.advance(make_simulation(), until)
    return (Path(folder) / "energies.csv").read_bytes()


# %%
# One run is not interrupted. The other run stops before its end and is resumed with a new Simulation, as it would be in
# a new process.

with tempfile.TemporaryDirectory() as folder:
    undisturbed = go(folder, 300)
with tempfile.TemporaryDirectory() as folder:
    before = go(folder, 140)
    resumed = go(folder, 300, resume=True)
print("the same bytes:", resumed == undisturbed)

# %%
# On the Reference platform, as here, the files of both runs are identical byte for byte, except for the date in the DCD
# file. On other platforms, the resumed run continues from the same state, but then diverges from the other run, because
# forces are summed in a different order. If a checkpoint is damaged or belongs to another run, an error with a message
# of one line is raised, and no file is changed. ``tests/runs/test_accidents.py`` kills real runs at random moments.


def potential(table):
    return np.loadtxt(table.decode().splitlines(), delimiter=",", skiprows=1, usecols=(1, 5)).T


figure, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
axes.plot(*potential(undisturbed), color="0.6", lw=4, label="undisturbed")
axes.plot(*potential(resumed), "--", color="#D55E00", label="resumed")
axes.plot(*potential(before), "o", color="#0072B2", ms=4, label="before the accident")
axes.set_xlabel("time (ps)")
axes.set_ylabel("potential energy (kJ/mol)")
axes.set_title("8 soft dipoles: an interrupted run and an undisturbed one")
axes.legend()
plt.show()
