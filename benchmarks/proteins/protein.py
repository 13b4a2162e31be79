"""A protein in water: energy error and time relative to OpenMM's Verlet, at equal numbers of force evaluations.

The system has PME on the CPU platform, constrained bonds to hydrogen, and amber14 with TIP3P. The script measures the
standard deviation of the total energy within windows of 0.5 ps, and the processor time (one thread). Both are relative
to OpenMM's VerletIntegrator with the same number of evaluations of the nonbonded forces per ps. Without --pdb, the
protein is a helix of 35 alanines, built and solvated here. --pdb accepts any solvated PDB file with standard residues
and water, such as the villin headpiece of OpenMM's Python examples (input.pdb).

Starts and rows are written to out/benchmarks/protein_*. Rows of the table, or of another one with --record, are not
measured again, so that the same command resumes an interrupted run. --quick runs a short version.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common import records, starts
from benchmarks.common.clocks import in_turns
from benchmarks.common.energies import noise
from benchmarks.common.proteins import FORCE_FIELD, solvated, solvated_helix
from benchmarks.common.provenance import OF_RUN, of_run

#: Scheme and options: bonded forces and pairs three bonds apart are nested unless they say otherwise.
METHODS = {
    "Verlet": None,
    "MTSIntegrator": None,
    "S2_3 plain": ("S2_3", {"fast": None}),
    "S2_2": ("S2_2", {}),
    "S2_3": ("S2_3", {}),
    "W2_4": ("W2_4", {}),
    "W2_1": ("W2_1", {}),
    "S2_3, 9 V2": ("S2_3", {"fast": "bonded", "inner": "V2", "innerSteps": 9}),
}
#: Steps of MTSIntegrator's bonded forces, in ps.
INNER = 0.001


def context_of(system, integrator, start):
    return starts.context_of(system, integrator, start, properties=starts.ONE_THREAD)


def equilibrated(system, positions, picoseconds, n_starts, file):
    """Return canonical starts 0.5 ps apart, from a file or a Langevin run."""
    if not file.exists():
        context, steps = context_of(system, starts.thermostat(), positions), round(picoseconds / 0.002)
        states = starts.canonical(context, steps, *[250] * n_starts, tolerance=50.0, iterations=200)[1:]
        np.save(file, [starts.positions_and_velocities(state) for state in states])
    return list(map(tuple, np.load(file)))


def substeps(rate):
    """Return the bonded evaluations of MTSIntegrator per nonbonded one."""
    return max(2, round(1.0 / rate / INNER))


def prepared(bare, method, rate):
    """Return System and integrator of a method with `rate` evaluations of the nonbonded forces per ps."""
    system = openmm.XmlSerializer.clone(bare)
    bonded = rb.separate_bonded(system)  # which MTSIntegrator needs
    if method == "Verlet":
        integrator = openmm.VerletIntegrator(1.0 / rate)
    elif method == "MTSIntegrator":
        integrator = openmm.MTSIntegrator(1.0 / rate * unit.picosecond, [(0, 1), (bonded, substeps(rate))])
    else:
        scheme, options = METHODS[method]
        integrator = rb.ExactRigidBodyIntegrator(rb.SCHEMES[scheme].forces / rate, scheme=scheme, **options)
        return system, integrator
    integrator.setConstraintTolerance(1e-8)
    return system, integrator


def columns(duration):
    """Return the columns of what is measured: standard deviations in windows and whole runs, and bonded evaluations."""
    return "std_half_ps_kJ_mol", f"std_{duration:g}_ps_kJ_mol", "bonded_per_force"


def measured(bare, begins, duration, method, rate):
    """Return a row of the record."""
    context = starts.context_of(*prepared(bare, method, rate))
    spread, integrator = noise(context, begins, duration), context.getIntegrator()
    bonded = {"MTSIntegrator": substeps(rate)}.get(method, np.nan)
    if isinstance(integrator, rb.ExactRigidBodyIntegrator):
        bonded = integrator.timings.fast_evaluations / integrator.timings.evaluations
    values = (f"{value:.4g}" for value in (spread[0], spread[-1], bonded))
    return {"method": method} | dict(zip(columns(duration), values, strict=True)) | of_run(context)


def seconds_a_ps(bare, start, rate, names, rounds, forces):
    """Return processor times per ps, of some rounds through all methods the least."""
    runs, contexts, made = {}, [], {}
    for method in names:
        system, integrator = prepared(bare, method, rate)
        contexts.append(context_of(system, integrator, start))
        each = integrator.forceEvaluationsPerStep if isinstance(integrator, rb.ExactRigidBodyIntegrator) else 1
        steps = max(1, round(forces / each))
        integrator.step(2)
        runs[method], made[method] = partial(integrator.step, steps), steps * each
    return {method: min(seconds) / made[method] * rate for method, seconds in in_turns(runs, rounds).items()}


def run(name, protein, n_starts, duration, rate, names, rounds=(5, 12), file=None):
    """Measure methods that have no row yet, time all of them, and print them over Verlet."""
    bare = app.ForceField(*FORCE_FIELD).createSystem(
        protein[0],
        nonbondedMethod=app.PME,
        nonbondedCutoff=0.9 * unit.nanometer,
        switchDistance=0.8 * unit.nanometer,
        constraints=app.HBonds,
        removeCMMotion=False,
    )
    bodies = f"{bare.getNumParticles()} atoms, {bare.getNumConstraints()} constraints"
    length = 2.0 if duration >= 1.0 else 0.2
    begins = equilibrated(bare, protein[1], length, n_starts, records.OUT / f"protein_{name}_starts.npy")
    file = file or records.OUT / f"protein_{name}_{n_starts}x{duration:g}ps_{rate}.csv"
    record = records.Record(file, ("method",), (*columns(duration), *OF_RUN))
    for method in names:
        if {"method": method} not in record:
            record.add(measured(bare, begins, duration, method, rate))
    known = {row["method"]: row for row in record.rows().values() if row["method"] in names}
    stable = [method for method in known if np.isfinite(float(known[method]["std_half_ps_kJ_mol"]))]
    seconds = seconds_a_ps(bare, begins[0], rate, stable, *rounds)
    print(f"{name}: {bodies}, {rate} evaluations per ps, {n_starts} starts of {duration:g} ps\n")
    print("| method | std, kJ/mol | Verlet's over it | bonded evaluations per force | time over Verlet's |")
    print("|" + 5 * " --- |")
    base = float(known["Verlet"]["std_half_ps_kJ_mol"])
    for method, row in known.items():
        error, bonded = float(row["std_half_ps_kJ_mol"]), float(row["bonded_per_force"])
        took = f"{seconds[method] / seconds['Verlet']:.2f}" if method in stable else ""
        print(f"| {method} | {error:.3g} | {base / error:.2g} | {bonded:.2g} | {took} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pdb", type=Path, help="a solvated protein (a helix that is built here)")
    parser.add_argument("--starts", type=int, default=2, metavar="N", help="starts (%(default)s)")
    parser.add_argument("--duration", type=float, default=1.0, metavar="PS", help="ps from each start (%(default)s)")
    parser.add_argument("--rate", type=int, default=250, metavar="N", help="evaluations per ps (%(default)s)")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS), metavar="NAME")
    parser.add_argument("--record", type=Path, metavar="CSV", help="the table (in out/benchmarks)")
    parser.add_argument("--quick", action="store_true", help="short runs of a short helix")
    args = parser.parse_args()
    records.OUT.mkdir(parents=True, exist_ok=True)
    if args.quick:
        run("short", solvated_helix(4), 1, 0.5, 250, ["Verlet", "S2_3"], (2, 6))
        return
    name, protein = ("helix", solvated_helix(35)) if args.pdb is None else (args.pdb.stem, solvated(args.pdb))
    run(name, protein, args.starts, args.duration, args.rate, args.methods, file=args.record)


if __name__ == "__main__":
    main()
