"""Energy error and stability of the default integrator and of VerletIntegrator, run through an ordinary Simulation.

Both integrators have the same step, and evaluate forces once per step. The energy error is the standard deviation over
a run of the total energy that a StateDataReporter writes, every 100 steps for water and every 10 steps for solutes.

`water` is a box of TIP3P with smooth forces (a switch, an Ewald tolerance of 1e-5), from canonical starts. `peptide` is
alanine dipeptide in water, and `protein` is the protein of --pdb or a helix of 35 alanines in water. Both have the
default forces of createSystem and constrained bonds to hydrogen, and start either directly from the file or after
minimisation and equilibration. All runs use the CPU platform with one thread. Results are written to
records/default_energies.csv. Each run is a job of an ensemble, so that an interrupted command can be resumed.

    python benchmarks/proteins/default_energies.py water
    python benchmarks/proteins/default_energies.py peptide protein --pdb input.pdb --steps 1 2 3 4 --starts 2
"""

from __future__ import annotations

import argparse
import io
import itertools
import math
from functools import cache
from operator import itemgetter
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.proteins import PEPTIDE, solvated, solvated_helix
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import simulation_of
from benchmarks.cost.one_line import SMOOTH, TEMPERATURE, box, start_of, system_of
from openmm_exactrb import ensemble

MAKERS = {"Verlet": openmm.VerletIntegrator, "default": rb.ExactRigidBodyIntegrator}
REPORTED = {"water": 100, "peptide": 10, "protein": 10}  # steps
STARTS = {"equilibrated": False, "file": True}
RUN = ("system", "atoms", "start", "seed", "fs", "picoseconds", "integrator")
FOUND = ("evaluations_per_ps", "std_kJ_mol")


@cache
def prepared(kind: str, source: str | int) -> tuple[app.Topology, openmm.System, unit.Quantity]:
    """Return a System and its positions; the source is a number of molecules, a file or ""."""
    if kind == "water":
        topology, positions = box(int(source))
        return topology, system_of(topology, **SMOOTH, removeCMMotion=False), positions
    if kind == "peptide" or source:
        topology, positions = solvated(source or PEPTIDE, padding=0.9 * unit.nanometer)
    else:
        topology, positions = solvated_helix(35)
    return topology, system_of(topology), positions


@cache
def equilibrated(kind: str, source: str | int, seed: int) -> openmm.State:
    """Return a canonical start."""
    return start_of(*prepared(kind, source), seed)


def energies_of(
    kind: str, source: str | int, method: str, step: float, seed: int, picoseconds: float, raw: bool
) -> dict[str, float | list[float] | dict[str, str]]:
    """Return the reported total energies in kJ/mol, force evaluations per ps, and where they come from."""
    topology, system, positions = prepared(kind, source)
    integrator = MAKERS[method](step)
    run = simulation_of(topology, system, integrator, None if raw else equilibrated(kind, source, seed))
    if raw:
        run.context.setPositions(positions)
        run.context.setVelocitiesToTemperature(TEMPERATURE, seed)
    text = io.StringIO()
    run.reporters.append(app.StateDataReporter(text, REPORTED[kind], totalEnergy=True))
    steps, evaluations = round(picoseconds / step), float(round(1.0 / step))
    try:
        run.step(steps)
        if method == "default":
            evaluations = integrator.timings.evaluations / (steps * step)
    except (openmm.OpenMMException, rb.IntegrationError):
        text.write("nan\n")
    energies = [float(line) for line in text.getvalue().splitlines() if not line.startswith("#")]
    found = {"atoms": system.getNumParticles(), "energies": energies, "evaluations": evaluations}
    return found | {"origin": of_run(run.context)}


def row_of(job: ensemble.Job, value: dict) -> dict:
    """Return a line of the table; the standard deviation of a run that diverged is nan."""
    what = job.arguments
    energies = np.array(value["energies"])
    std = float(np.std(energies)) if np.isfinite(energies).all() else math.nan
    name = Path(what["source"]).stem if isinstance(what["source"], str) and what["source"] else what["kind"]
    start = "file" if what["raw"] else "equilibrated"
    run = (1000.0 * what["step"], what["picoseconds"], what["method"])
    known = (name, value["atoms"], start, what["seed"], *run, f"{value['evaluations']:.1f}", f"{std:.4g}")
    return dict(zip((*RUN, *FOUND), known, strict=True)) | value["origin"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("systems", nargs="+", choices=["water", "peptide", "protein"])
    add("--molecules", type=int, default=887, help="of water in the box (%(default)s)")
    add("--pdb", default="", help="a solvated protein")
    add("--steps", type=float, nargs="+", default=[2.0], metavar="FS")
    add("--starts", type=int, default=3, help="(%(default)s)")
    add("--from", dest="kinds", nargs="+", choices=STARTS, default=[*STARTS], help="of solutes (%(default)s)")
    add("--methods", nargs="+", choices=MAKERS, default=[*MAKERS])
    add("--first", type=int, default=101, help="seed of the first start (%(default)s)")
    add("--picoseconds", type=float, default=30.0, help="length of a run (%(default)s)")
    add("--out", type=Path, default=Path("out/default_energies"), metavar="FOLDER")
    add("--record", type=Path, default=RECORDS / "default_energies.csv", metavar="CSV", help="%(default)s")
    args = parser.parse_args()
    record = Record(args.record, RUN, (*FOUND, *OF_RUN), order=itemgetter(*RUN))
    sources = {"water": args.molecules, "peptide": "", "protein": args.pdb}
    seeds = range(args.first, args.first + args.starts)
    jobs = []
    for kind in args.systems:
        raws = [False] if kind == "water" else [STARTS[name] for name in args.kinds]
        shared = {"kind": kind, "source": sources[kind], "picoseconds": args.picoseconds}
        jobs += [
            ensemble.Job(energies_of, **shared, method=method, step=fs / 1000.0, seed=seed, raw=raw)
            for seed, raw, fs, method in itertools.product(seeds, raws, args.steps, args.methods)
        ]
    for result in ensemble.as_completed(jobs, args.out, workers=1):
        if result.error is not None:
            raise SystemExit(result.error)
        record.add(row_of(result.job, result.value))


if __name__ == "__main__":
    main()
