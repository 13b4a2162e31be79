"""The cost of processed schemes through `Simulation.step`, and the error of their cheap output.

A run stays in inner coordinates. The state shown to users is a copy transformed by the scheme's output, which is far
cheaper than the exact inverse of the processor, and whose error does not accumulate. Here, both transformations are
applied to the same inner trajectory, for droplets of TIP3P with a CMMotionRemover, in calls of ten steps as in
`Simulation.step`.

A small energy error alone does not show that an output is accurate: an output can cancel the second-order error of the
energy without being a change of coordinates. The mean kinetic energies are therefore compared too, in units of the
standard deviation of the energy with the exact inverse.

Each run is a job of an ensemble, so that an interrupted command can be resumed. The table is written to
records/outputs.csv.

    python benchmarks/schemes/outputs.py --starts 6 --picoseconds 30
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common import droplets
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, Record
from openmm_exactrb import ensemble

MOLECULES, MODEL = 64, "tip3p"
RUNS = (("W2_1", 250), ("W2_1", 500), ("W2_1", 1000), ("W4_4", 500), ("W4_4", 1000))
RUN = ("scheme", "forces per ps", "seed")
FOUND = ("asked per step", "Verlet", "inverse", "output", "shift tr", "shift rot")


def simulation(scheme: str | rb.schemes.Scheme, h: float, seed: int) -> app.Simulation:
    """Return a droplet with a CMMotionRemover, at a canonical start."""
    topology, system, positions = rb.rigid_water(MOLECULES, model=MODEL)
    system.addForce(openmm.CMMotionRemover(1))
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme)
    made = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("CPU"), {"Threads": "1"})
    made.context.setPositions(positions)
    integrator.setBodyState(droplets.start(MOLECULES, MODEL, seed))
    return made


def energies(run: app.Simulation) -> list[float]:
    """Return the total energy and the kinetic energies of translation and rotation per molecule (kJ/mol)."""
    integrator = run.integrator
    total = integrator.totalEnergy()
    return [energy._value / MOLECULES for energy in (total, *integrator.kineticEnergies())]


def row(name: str, rate: int, seed: int, duration: float) -> dict[str, Any]:
    """Return a row of the table: one start."""
    scheme = rb.SCHEMES[name]
    h = scheme.forces / rate
    run, inverse = simulation(scheme, h, seed), simulation(replace(scheme, output=()), h, seed)
    verlet = simulation("V2", 1.0 / rate, seed)
    found: dict[str, list[list[float]]] = {"output": [], "inverse": [], "Verlet": []}
    calls = round(duration / (10 * h))
    run.integrator.timings.reset()
    for _ in range(calls):
        for key, one, steps in (("output", run, 10), ("inverse", inverse, 10), ("Verlet", verlet, 10 * scheme.forces)):
            one.step(steps)
            found[key].append(energies(one))
    asked = run.integrator.timings.evaluations / (10 * calls)
    deviation = {key: float(np.std(np.array(values)[:, 0])) for key, values in found.items()}
    shifts = (np.mean(np.array(found["output"]) - found["inverse"], axis=0) / deviation["inverse"])[1:]
    values = asked, *map(deviation.get, FOUND[1:4]), *map(float, shifts)
    numbers = (f"{value:.5g}" for value in values)
    return dict(zip((*RUN, *FOUND), (name, rate, seed, *numbers), strict=True)) | of_run(run.context)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=6)
    parser.add_argument("--first", type=int, default=21, help="seed of the first start; 1 to 16 chose the outputs")
    parser.add_argument("--picoseconds", type=float, default=30.0)
    parser.add_argument("--rates", type=int, nargs="+", default=[250, 500, 1000], help="forces per ps")
    parser.add_argument("--out", type=Path, default=Path("out/outputs"), metavar="FOLDER")
    parser.add_argument("--record", type=Path, default=RECORDS / "outputs.csv", metavar="CSV", help="%(default)s")
    options = parser.parse_args()
    record = Record(options.record, RUN, (*FOUND, *OF_RUN))
    seeds = range(options.first, options.first + options.starts)
    jobs = [
        ensemble.Job(row, name=name, rate=rate, seed=seed, duration=options.picoseconds)
        for name, rate in RUNS
        if rate in options.rates
        for seed in seeds
    ]
    for result in ensemble.as_completed(jobs, options.out, workers=1):
        if result.error is not None:
            raise SystemExit(result.error)
        record.add(result.value)


if __name__ == "__main__":
    main()
