"""The cost and the benefit of one changed line of a script: the default integrators compared with those of OpenMM.

The systems are a box of TIP3P and a helix in water, as built by `createSystem` (PME, a CMMotionRemover). They run on
the CPU platform with one thread, through `Simulation.step` with a report every 100 steps. Processor times are the
smallest over several rounds in which the integrators alternate, so that other processes affect all of them equally.
With --energies, the script instead measures the standard deviation of the total energy of a box over 30 ps from the
same starts, with a switch and a tight Ewald tolerance.

With --long, the script measures the time per force evaluation, and the length simulated per hour, of a protein with a
force evaluation every 8 and 10 fs (`W2_3m`, all hydrogens of 3 amu). Results are relative to LangevinMiddleIntegrator
at 4 fs with heavy hydrogens of the solute. That integrator at 8 fs, which needs AllBonds, shows the time that OpenMM
itself needs per evaluation every 8 fs, with twice as many updates of the neighbour list per evaluation. With two
threads, times are wall times, and no other process should run.

    python benchmarks/cost/one_line.py
    python benchmarks/cost/one_line.py --energies --molecules 216 --starts 3
    python benchmarks/cost/one_line.py --molecules 0 --pdb examples/data/alanine_dipeptide.pdb
    python benchmarks/cost/one_line.py --long --pdb villin.pdb
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
from benchmarks.common.clocks import in_turns
from benchmarks.common.energies import along, root_mean_square
from benchmarks.common.proteins import FORCE_FIELD, solvated, solvated_helix
from benchmarks.common.starts import canonical, simulation_of, thermostat

STEP, TEMPERATURE, FRICTION = 0.002, 300.0, 1.0  # ps, K, 1/ps
PAIRS: dict[str, tuple[Callable[[], openmm.Integrator], Callable[[], openmm.Integrator]]] = {
    "constant energy": (lambda: openmm.VerletIntegrator(STEP), lambda: rb.ExactRigidBodyIntegrator(STEP)),
    "constant temperature": (
        lambda: openmm.LangevinMiddleIntegrator(TEMPERATURE, FRICTION, STEP),
        lambda: rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, FRICTION, STEP),
    ),
}
# Of --long: masses and constraints, the integrator, force evaluations per step, and fs between two of them.
LONG: dict[str, tuple[tuple[str, str], Callable[[], openmm.Integrator], int, float]] = {
    "LangevinMiddle, 2 fs": (("plain", "HBonds"), lambda: langevin_middle(0.002), 1, 2.0),
    "LangevinMiddle, 4 fs": (("solute", "HBonds"), lambda: langevin_middle(0.004), 1, 4.0),
    "LangevinMiddle, 8 fs": (("all", "AllBonds"), lambda: langevin_middle(0.008), 1, 8.0),
    "the default, 2 fs": (("plain", "HBonds"), lambda: ours(0.002), 1, 2.0),
    "W2_3m, 8 fs": (("all", "HBonds"), lambda: ours(0.024, scheme="W2_3m"), 3, 8.0),
    "W2_3m, 10 fs": (("all", "HBonds"), lambda: ours(0.030, scheme="W2_3m"), 3, 10.0),
}
REFERENCE = "LangevinMiddle, 4 fs"
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


def start_of(topology, system, positions, seed: int) -> openmm.State:
    """Return a canonical start."""
    made = simulation_of(topology, system, thermostat(TEMPERATURE, seed, STEP))
    made.context.setPositions(positions)
    return canonical(made.context, 2_500, seed=seed, iterations=200)[0]


def costs(topology, system, start, rounds: int) -> None:
    """Print what a step of ours takes over one of OpenMM's, and how many forces."""
    for name, makers in PAIRS.items():
        runs = [simulation_of(topology, system, make(), start) for make in makers]
        for run in runs:
            run.reporters.append(app.StateDataReporter(io.StringIO(), 100, potentialEnergy=True, temperature=True))
            run.step(100)
        runs[1].integrator.timings.reset()
        times = in_turns({k: partial(run.step, 100) for k, run in enumerate(runs)}, rounds)
        theirs, ours = map(min, times.values())
        timings = runs[1].integrator.timings
        evaluations = [count / (100 * rounds) for count in (timings.evaluations, timings.fast_evaluations)]
        print(
            f"{name}: {10 * ours:.2f} ms a step over {10 * theirs:.2f}, ratio {ours / theirs:.3f} "
            f"(median {np.median(times[1]) / np.median(times[0]):.3f}); evaluations a step: all {evaluations[0]:.3f}, "
            f"bonded beside them {evaluations[1]:.1f}"
        )


def compare(name: str, topology, positions, rounds: int) -> None:
    """Print the costs of a System from a canonical start."""
    system = system_of(topology)
    print(f"{name}, {system.getNumParticles()} atoms")
    costs(topology, system, start_of(topology, system, positions, 1), rounds)


def long_steps(topology, positions, rounds: int, threads: int) -> None:
    """Print times per force evaluation of a protein with long steps, and what is simulated per hour."""
    clock = time.process_time if threads == 1 else time.perf_counter
    start, runs = start_of(topology, system_of(topology), positions, 1), {}
    for name, ((masses, constraints), make, evaluations, _) in LONG.items():
        system = system_of(topology, constraints=getattr(app, constraints))
        if masses != "plain":
            rb.heavy_hydrogens(system, topology, water=masses == "all")
        runs[name] = simulation_of(topology, system, make(), start, threads)
        runs[name].context.applyConstraints(1e-8)
        runs[name].context.setVelocitiesToTemperature(TEMPERATURE, 1)
        runs[name].step(12 // evaluations)
    times = in_turns({name: partial(run.step, 24 // LONG[name][2]) for name, run in runs.items()}, rounds, clock)
    for name, spent in times.items():
        ratio = float(np.median(np.array(spent) / times[REFERENCE]))
        print(
            f"{name:22} {1000 * np.median(spent) / 24:6.2f} ms per force evaluation, {ratio:.3f} of {REFERENCE}; "
            f"simulated per hour: {LONG[name][3] / LONG[REFERENCE][3] / ratio:.2f} times as much"
        )


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
    add("--rounds", type=int, default=8)
    add("--long", action="store_true", help="long steps of a protein instead")
    add("--pdb", type=Path, help="a protein instead of the helix; without water a small peptide")
    add("--threads", type=int, default=1, help="of --long (%(default)s)")
    add("--energies", action="store_true", help="energy errors instead of times")
    add("--starts", type=int, default=3)
    add("--picoseconds", type=float, default=30.0)
    args = parser.parse_args()
    if args.long:
        long_steps(*(solvated(args.pdb) if args.pdb else solvated_helix(args.residues)), args.rounds, args.threads)
        return
    if args.energies:
        topology, positions = box(args.molecules)
        smooth = system_of(topology, **SMOOTH, removeCMMotion=False)
        energies(topology, smooth, positions, args.starts, args.picoseconds)
        return
    if args.molecules:
        compare(f"{args.molecules} TIP3P", *box(args.molecules), args.rounds)
    if args.pdb:
        compare(args.pdb.stem, *solvated(args.pdb), args.rounds)
    elif args.residues:
        compare(f"a helix of {args.residues} alanines in water", *solvated_helix(args.residues), args.rounds)


if __name__ == "__main__":
    main()
