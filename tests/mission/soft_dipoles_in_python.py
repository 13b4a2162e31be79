"""A process that integrates soft dipoles; its arguments are a scheme, a step size (ps), a number of steps and a folder.

The droplet is that of docs/explanation/trust.md, with fewer dipoles. OpenMM's CustomCompoundBondForce is their
potential, the integrator is OpenMM's CustomIntegrator, and numpy evaluates the exact rotation. The process writes
record.json and run.dcd into the folder.
"""

import json
import sys
from pathlib import Path

import mdtraj
import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.schemes import roundoff
from openmm_exactrb.library.library import of_library
from openmm_exactrb.rotors import closed_form
from places import REFERENCE
from starts import positions_of, simulation_of, topology_of

DIPOLES, RECORDS = 8, 10


def counting(function, calls):
    """Return a function that counts its calls in a list."""

    def counted(*arguments):
        calls.append(arguments[3])
        return function(*arguments)

    return counted


def main(scheme, h, steps, folder):
    calls = []
    closed_form.advance = counting(closed_form.advance, calls)
    system, positions, velocities = roundoff.dipoles_of(1, DIPOLES, "bonds")
    integrator = rb.ExactRigidBodyIntegrator(h, scheme, rotor="exact_numpy")
    simulation = simulation_of(topology_of(system), system, integrator, positions, velocities, platform=REFERENCE)
    simulation.reporters.append(app.DCDReporter(str(folder / "run.dcd"), steps // RECORDS))
    energies, frames = [], []
    for step in range(RECORDS + 1):
        if step:
            simulation.step(steps // RECORDS)
            frames.append(positions_of(simulation.context))
        energies.append(roundoff.in_long_double(simulation.context, integrator)[0])
    simulation.reporters.clear()  # closes the file
    read = mdtraj.load_dcd(str(folder / "run.dcd"), top=mdtraj.Topology.from_openmm(simulation.topology))
    record = {
        "engine": integrator.getEngine(),
        "custom": isinstance(integrator, openmm.CustomIntegrator),
        "of the library": of_library(integrator),
        "forces": [type(force).__name__ for force in system.getForces()],
        "rotations": len(calls),
        "errors": [float(energy / energies[0] - 1.0) for energy in energies[1:]],
        "apart": float(np.abs(read.xyz - frames).max()),
        "moved": float(np.abs(frames - np.array(positions._value)).max()),
    }
    (folder / "record.json").write_text(json.dumps(record), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
