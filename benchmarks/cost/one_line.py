"""The cost and the benefit of one changed line of a script: the default integrators compared with those of OpenMM.

The systems are a box of TIP3P, a helix and solutes in water, as built by `createSystem` (PME, a CMMotionRemover). They
run on the CPU platform with one thread, through `Simulation.step` with a report at the end of each run. Each row of
records/one_line.csv is the median and the quartiles of the ratios of processor times in rounds in which the integrators
alternate on one core. With --energies, the script instead measures the standard deviation of the total energy of a box
over 30 ps from the same starts, with a switch and a tight Ewald tolerance.

With --long, the script measures the time per force evaluation of a protein with a force evaluation every 8 fs (`BAOA`
and `W2_3m`, all hydrogens of 3 amu), relative to LangevinMiddleIntegrator at 4 fs with heavy hydrogens of the solute.
That integrator at 8 fs, which needs AllBonds, shows the time that OpenMM itself needs per evaluation every 8 fs, with
twice as many updates of the neighbour list per evaluation. With two threads, times are wall times.

    python benchmarks/cost/one_line.py --residues 0
    python benchmarks/cost/one_line.py --molecules 0 --steps 20
    python benchmarks/cost/one_line.py --molecules 0 --pdb examples/data/alanine_dipeptide.pdb
    python benchmarks/cost/one_line.py --long --pdb villin.pdb --threads 2
    python benchmarks/cost/one_line.py --energies --molecules 216 --starts 3
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.clocks import QUARTILES, in_turns, on_one_core, quartiles
from benchmarks.common.energies import along, root_mean_square
from benchmarks.common.proteins import FORCE_FIELD, solvated, solvated_helix
from benchmarks.common.provenance import OF_RUN, of_run, provenance
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import canonical, simulation_of, thermostat

STEP, TEMPERATURE, FRICTION = 0.002, 300.0, 1.0  # ps, K, 1/ps
EQUILIBRATION = 500  # steps before times are measured
RECORD = Record(
    RECORDS / "one_line.csv",
    ("system", "threads", "run", "relative_to"),
    (*QUARTILES, *OF_RUN, "load"),
)
#: Of OpenMM and of this package.
PAIRS: dict[str, tuple[Callable[[], openmm.Integrator], Callable[[], openmm.Integrator]]] = {
    "VerletIntegrator": (lambda: openmm.VerletIntegrator(STEP), lambda: rb.ExactRigidBodyIntegrator(STEP)),
    "LangevinMiddleIntegrator": (
        lambda: openmm.LangevinMiddleIntegrator(TEMPERATURE, FRICTION, STEP),
        lambda: rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, FRICTION, STEP),
    ),
}
REFERENCE = "LangevinMiddleIntegrator, 4 fs"
#: Of --long: masses and constraints, the integrator, and force evaluations per step.
LONG: dict[str, tuple[tuple[str, str], Callable[[], openmm.Integrator], int]] = {
    REFERENCE: (("solute", "HBonds"), lambda: langevin_middle(0.004), 1),
    "LangevinMiddleIntegrator, 8 fs, AllBonds": (("all", "AllBonds"), lambda: langevin_middle(0.008), 1),
    "BAOA, 8 fs": (("all", "HBonds"), lambda: ours(0.008), 1),
    "W2_3m, 8 fs": (("all", "HBonds"), lambda: ours(0.024, scheme="W2_3m"), 3),
}
SMOOTH = {"switchDistance": 0.8 * unit.nanometer, "ewaldErrorTolerance": 1e-5}


def langevin_middle(step: float) -> openmm.Integrator:
    return openmm.LangevinMiddleIntegrator(TEMPERATURE, 5.0, step)


def ours(step: float, **options: str) -> openmm.Integrator:
    return rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, 5.0, step, **options)


def box(molecules: int) -> tuple[app.Topology, unit.Quantity]:
    """Return a box of TIP3P."""
    modeller = app.Modeller(app.Topology(), [] * unit.nanometer)
    modeller.addSolvent(app.ForceField("amber14/tip3p.xml"), numAdded=molecules, model="tip3p")
    return modeller.topology, modeller.positions


def system_of(topology: app.Topology, **options) -> openmm.System:
    """Return the System that a stock script makes."""
    usual = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.9 * unit.nanometer, "constraints": app.HBonds}
    return app.ForceField(*FORCE_FIELD).createSystem(topology, **usual | options)


def start_of(topology, system, positions, seed: int, steps: int = 2_500) -> openmm.State:
    """Return a start after steps with a thermostat."""
    made = simulation_of(topology, system, thermostat(TEMPERATURE, seed, STEP))
    made.context.setPositions(positions)
    return canonical(made.context, steps, seed=seed, iterations=200)[0]


def recorded(simulation: app.Simulation, ratios, **names) -> None:
    """Add a row about a Simulation to the record."""
    RECORD.add({**names, **quartiles(ratios), **provenance(), **of_run(simulation.context)})


def costs(name: str, topology, positions, rounds: int, steps: int) -> None:
    """Measure the processor time of steps of ours over that of steps of OpenMM's integrators."""
    system = system_of(topology)
    start, label = start_of(topology, system, positions, 1, EQUILIBRATION), labelled(name, system)
    for theirs, makers in PAIRS.items():
        runs = [simulation_of(topology, system, make(), start) for make in makers]
        for run in runs:
            run.reporters.append(app.StateDataReporter(io.StringIO(), steps, potentialEnergy=True, temperature=True))
            run.step(steps)
        times = in_turns({k: partial(run.step, steps) for k, run in enumerate(runs)}, rounds)
        ratios = np.array(times[1]) / times[0]
        recorded(runs[1], ratios, system=label, threads=1, run="the default, 2 fs", relative_to=f"{theirs}, 2 fs")


def long_steps(name: str, topology, positions, rounds: int, threads: int) -> None:
    """Measure the time per force evaluation of a protein with long steps."""
    clock = time.process_time if threads == 1 else time.perf_counter
    start, runs = start_of(topology, system_of(topology), positions, 1, EQUILIBRATION), {}
    for method, ((masses, constraints), make, evaluations) in LONG.items():
        system = system_of(topology, constraints=getattr(app, constraints))
        rb.heavy_hydrogens(system, topology, water=masses == "all")
        runs[method] = simulation_of(topology, system, make(), start, threads)
        runs[method].context.applyConstraints(1e-8)
        runs[method].context.setVelocitiesToTemperature(TEMPERATURE, 1)
        runs[method].step(12 // evaluations)
    times = in_turns({method: partial(run.step, 24 // LONG[method][2]) for method, run in runs.items()}, rounds, clock)
    label = labelled(name, system)
    for method in list(LONG)[1:]:
        ratios = np.array(times[method]) / times[REFERENCE]
        recorded(runs[method], ratios, system=label, threads=threads, run=method, relative_to=REFERENCE)


def labelled(name: str, system: openmm.System) -> str:
    """Return the name of a solute in water with its number of atoms, or that of a box of water."""
    return name if "TIP3P" in name else f"{name.replace('_', ' ')} in water, {system.getNumParticles()} atoms"


def energies(topology, system, positions, starts: int, picoseconds: float) -> None:
    """Print the standard deviation of the total energy over whole runs of both integrators."""
    spreads: list[list[float]] = [[], []]
    for seed in range(1, starts + 1):
        start = start_of(topology, system, positions, seed)
        for make, found in zip(PAIRS["constant energy"], spreads, strict=True):
            run = simulation_of(topology, system, make(), start)
            found.append(float(np.std(along(run.context, picoseconds, 50 * STEP)[0])))
        print(f"start {seed}: {spreads[1][-1]:.3f} over {spreads[0][-1]:.3f} kJ/mol", flush=True)
    theirs, ours = map(root_mean_square, spreads)
    print(f"energy over {picoseconds:g} ps, {starts} starts: {ours / theirs:.3f} of VerletIntegrator's")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--molecules", type=int, default=887, help="of water in the box; 0 for no box (%(default)s)")
    add("--residues", type=int, default=35, help="of the helix; 0 for none (%(default)s)")
    add("--rounds", type=int, default=9, help="%(default)s")
    add("--steps", type=int, default=100, help="of a run (%(default)s)")
    add("--long", action="store_true", help="long steps of a protein instead")
    add("--pdb", type=Path, help="a protein instead of the helix; without water a small peptide")
    add("--threads", type=int, default=1, help="of --long (%(default)s)")
    add("--energies", action="store_true", help="energy errors instead of times")
    add("--starts", type=int, default=3)
    add("--picoseconds", type=float, default=30.0)
    args = parser.parse_args()
    if args.long and not args.pdb:
        parser.error("--long needs --pdb")
    if args.threads == 1:
        on_one_core()
    if args.energies:
        topology, positions = box(args.molecules)
        smooth = system_of(topology, **SMOOTH, removeCMMotion=False)
        energies(topology, smooth, positions, args.starts, args.picoseconds)
        return
    if args.long:
        long_steps(args.pdb.stem, *solvated(args.pdb), args.rounds, args.threads)
        return
    if args.molecules:
        costs(f"{args.molecules} TIP3P", *box(args.molecules), args.rounds, args.steps)
    if args.pdb:
        costs(args.pdb.stem, *solvated(args.pdb), args.rounds, args.steps)
    elif args.residues:
        costs(f"a helix of {args.residues} alanines", *solvated_helix(args.residues), args.rounds, args.steps)


if __name__ == "__main__":
    main()
