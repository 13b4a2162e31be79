"""A peptide in rigid water: energy error against cost for OpenMM's integrators and ours, without and with nesting.

Alanine dipeptide (amber14) in a droplet of 32 TIP3P molecules without a cutoff runs on the Reference platform. Bonds to
hydrogen are constrained or, with --constraints None, only those of water. The script measures the standard deviation of
the total energy within windows of 0.5 ps and within whole runs, against evaluations of the nonbonded forces per ps,
from the same starts with fixed seeds. Nested schemes and OpenMM's MTSIntegrator evaluate the bonded forces in inner
steps; "with 1-4" includes the pairs three bonds apart. Evaluations of these forces per ps are counted separately. The
output of a processed scheme, here every 20 fs, needs `Scheme.output_forces` further evaluations, which are not counted.
Names ending with ", exact inverse" use the inverse of the processor instead of the scheme's output.

A survey with short runs is followed by long runs of the best methods of each family at each rate. With --leave, the
long runs begin at other starts than those of the survey. --methods runs the given methods instead: "Verlet", "W2_4",
"W2_4 nested", "W2_4 nested with 1-4", or "W2_4 nested: S2_2 x 8", which gives an inner scheme and its number of inner
steps per step. Rows, which include the processor time (one thread) per ps, and pictures are written to
out/benchmarks/peptide_*. Rows that exist are not measured again, so that the same command resumes an interrupted run.
--quick runs a short version.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common import records
from benchmarks.common.energies import noise
from benchmarks.common.pictures import STYLES, plt
from benchmarks.common.proteins import FORCE_FIELD, PEPTIDE
from benchmarks.common.starts import context_of
from benchmarks.water.droplet import equilibrated

CONSTRAINTS = {"HBonds": app.HBonds, "AllBonds": app.AllBonds, "None": None}
RATES = (250, 500, 1000, 2000)
SCHEMES = ("S2_2", "S2_3", "W2_4", "W2_5", "W4_5", "W4_6", "SRKN4_6b", "SRKN6_14a", "ABA_8_6_4")
#: How our schemes are run; names of methods end so.
PLAIN, NESTED, WITH_PAIRS = "", " nested", " nested with 1-4"
INVERSE = ", exact inverse"
#: Families, and the names of ours in pictures and tables.
FAMILIES = {
    "Verlet": "",
    "MTSIntegrator": "",
    "plain": "this package, plain",
    "nested": "bonds, angles and torsions nested",
    "nested with 1-4": 'nested with fast="bonded"',
    "processed, nested with 1-4": 'processed, nested with fast="bonded"',
}
#: Steps of MTSIntegrator's bonded forces, in ps.
INNER = 0.0005
#: Starts and length (ps) of the survey, and how many of a family at a rate are then run for long.
SURVEY, BEST = (2, 0.5), 1
COLUMNS = ("method", "nonbonded_a_ps", "energy_std_half_ps", "energy_std_run", "bonded_a_ps", "cpu_s_a_ps")


def droplet(waters, constraints):
    """Return System and positions (nm) of the peptide and the molecules of water next to it."""
    pdb = app.PDBFile(str(PEPTIDE))
    force_field = app.ForceField(*FORCE_FIELD)
    modeller = app.Modeller(pdb.topology, pdb.positions)
    modeller.addSolvent(force_field, padding=0.8 * unit.nanometer)
    x = np.array(modeller.positions.value_in_unit(unit.nanometer))
    first = {residue: next(residue.atoms()).index for residue in modeller.topology.residues()}
    water = [residue for residue in first if residue.name == "HOH"]
    centre = x[: pdb.topology.getNumAtoms()].mean(axis=0)
    water.sort(key=lambda residue: float(np.linalg.norm(x[first[residue]] - centre)))
    modeller.delete(water[waters:])
    modeller.topology.setPeriodicBoxVectors(None)
    system = force_field.createSystem(
        modeller.topology, nonbondedMethod=app.NoCutoff, constraints=CONSTRAINTS[constraints], removeCMMotion=False
    )
    return system, np.array(modeller.positions.value_in_unit(unit.nanometer))


def methods():
    """Return the names of all methods."""
    return ["Verlet", "MTSIntegrator", *(name + how for name in SCHEMES for how in (PLAIN, NESTED, WITH_PAIRS))]


def nesting(method):
    """Return what is nested in a method of ours: "plain", "nested" or "nested with 1-4"."""
    return method.removesuffix(INVERSE).partition(":")[0].partition(" ")[2] or "plain"


def family(method):
    """Return the family of a method."""
    if method in FAMILIES:
        return method
    processed = rb.SCHEMES[method.partition(":")[0].split()[0]].processor
    return ("processed, " if processed else "") + nesting(method)


def inner(method):
    """Return what an integrator is told of the inner steps of a method."""
    scheme, _, steps = method.partition(": ")[2].partition(" x ")
    return {"inner": scheme or None, "innerSteps": int(steps) if steps else None}


def substeps(rate):
    """Return how many steps of the bonded forces MTSIntegrator makes."""
    return max(2, round(1.0 / rate / INNER))


def prepared(bare, method, rate):
    """Return System and integrator of a method with `rate` evaluations of the nonbonded forces per ps."""
    system = openmm.XmlSerializer.clone(bare)
    bonded = rb.separate_bonded(system)
    if family(method) == "Verlet":
        integrator = openmm.VerletIntegrator(1.0 / rate)
    elif family(method) == "MTSIntegrator":
        integrator = openmm.MTSIntegrator(1.0 / rate * unit.picosecond, [(0, 1), (bonded, substeps(rate))])
    else:
        scheme = rb.SCHEMES[method.partition(":")[0].split()[0]]
        exact = {"output": ()} if method.endswith(INVERSE) else {"output_of_rigid": False}
        scheme = replace(scheme, **exact)
        fast = {"plain": None, NESTED.strip(): (bonded,), WITH_PAIRS.strip(): "bonded"}[nesting(method)]
        within = {} if fast is None else inner(method)
        return system, rb.ExactRigidBodyIntegrator(scheme.forces / rate, scheme=scheme, fast=fast, **within)
    integrator.setConstraintTolerance(1e-10)
    return system, integrator


def measured(bare, starts, duration, method, rate):
    """Return errors in kJ/mol of the whole droplet, evaluations of bonded forces per ps, and seconds per ps."""
    system, integrator = prepared(bare, method, rate)
    start = time.process_time()
    spread = noise(context_of(system, integrator, platform="Reference"), starts, duration)
    seconds = (time.process_time() - start) / (duration * len(starts))
    bonded = rate
    if family(method) == "MTSIntegrator":
        bonded = rate * substeps(rate)
    elif "nested" in family(method) and integrator.timings.evaluations:
        bonded = rate * integrator.timings.fast_evaluations / integrator.timings.evaluations
    return spread[0], spread[-1], bonded, seconds


class Table:
    """Rows in a file: those that stand there already are not measured again."""

    def __init__(self, file):
        self.file = file
        self.rows = {
            (row["method"], int(row["nonbonded_a_ps"])): [float(row[name]) for name in COLUMNS[2:]]
            for row in records.read(file)
        }

    def add(self, bare, starts, duration, method, rate):
        """Measure a method at a rate."""
        if (method, rate) in self.rows:
            return
        self.rows[method, rate] = numbers = measured(bare, starts, duration, method, rate)
        records.write(self.file, COLUMNS, [(*key, *row) for key, row in self.rows.items()])
        print(f"{rate:5d} per ps {method:>26}: " + ", ".join(f"{x:.2g}" for x in numbers), flush=True)

    def best(self, rate, kind, n):
        """Return the n methods of a family with the least energy error at a rate, the best one first."""
        found = [method for method, at in self.rows if at == rate and family(method) == kind]
        found.sort(key=lambda method: self.rows[method, rate][0])
        return [method for method in found[:n] if np.isfinite(self.rows[method, rate][0])]


def run(constraints, waters, n_starts, leave, duration, rates, survey, named, record=None):
    """Survey all methods and run the best ones for long, or run the named ones; print a table and draw it."""
    system, positions = droplet(waters, constraints)
    starts = equilibrated(system, positions, 5.0, leave + n_starts)
    apart = f"_after_{leave}" if leave else ""
    long = Table(record or records.OUT / f"peptide_{constraints}_{n_starts}x{duration:g}ps{apart}.csv")
    for method in named or ():
        for rate in rates:
            long.add(system, starts[leave:], duration, method, rate)
    if not named:
        short = Table(records.OUT / f"peptide_{constraints}_survey.csv")
        for rate in rates:
            for method in methods():
                short.add(system, starts[: survey[0]], survey[1], method, rate)
        for rate in rates:
            for kind in FAMILIES:
                for method in short.best(rate, kind, BEST):
                    long.add(system, starts[leave:], duration, method, rate)
    for column, what in ((0, "windows of 0.5 ps"), (1, f"whole runs of {duration:g} ps")):
        print_table(long, rates, column, what)
    draw(long, rates, constraints, waters)


def print_table(table, rates, column, what):
    """Print the errors of the best of each family."""
    print(f"\nstandard deviation in {what}, kJ/mol\n\n| per ps | " + " | ".join(FAMILIES) + " |")
    print("|" + (1 + len(FAMILIES)) * " --- |")
    for rate in rates:
        cells = []
        for kind in FAMILIES:
            best = table.best(rate, kind, 1)
            named = f" ({best[0].split()[0]})" if best and best[0] != kind else ""
            tried = any(at == rate and family(method) == kind for method, at in table.rows)
            none = "blows up" if tried else ""
            cells.append(f"{table.rows[best[0], rate][column]:.2g}{named}" if best else none)
        print(f"| {rate} | " + " | ".join(cells) + " |")


def draw(table, rates, constraints, waters):
    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    for (kind, label), (colour, marker) in zip(FAMILIES.items(), STYLES, strict=False):
        points = [(rate, table.rows[best[0], rate][0]) for rate in rates if (best := table.best(rate, kind, 1))]
        style = {"color": colour, "marker": marker, "ls": "-" if label else "--", "mec": "black", "mew": 0.4}
        axes.loglog(*zip(*points, strict=True), label=label or kind, **style)
    axes.set_xlabel("evaluations of the nonbonded forces per ps")
    axes.set_ylabel("std of total energy within 0.5 ps (kJ/mol)")
    axes.set_xticks(rates, map(str, rates))
    axes.xaxis.set_minor_formatter("")
    axes.tick_params(which="minor", length=0)
    axes.grid(True, alpha=0.3)
    axes.legend(fontsize=8)
    axes.set_title(f"Alanine dipeptide and {waters} TIP3P, {constraints}, constant energy", fontsize=10)
    figure.savefig(records.OUT / f"peptide_{constraints}.png", dpi=150)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--constraints", choices=CONSTRAINTS, default="HBonds", help="of the peptide (%(default)s)")
    parser.add_argument("--waters", type=int, default=32, metavar="N", help="molecules of water (%(default)s)")
    parser.add_argument("--starts", type=int, default=6, metavar="N", help="starts (%(default)s)")
    parser.add_argument("--duration", type=float, default=10.0, metavar="PS", help="ps from each start (%(default)s)")
    parser.add_argument(
        "--leave", type=int, default=0, metavar="N", help="starts that long runs leave out (%(default)s)"
    )
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="methods to run instead of a survey")
    parser.add_argument("--rates", type=int, nargs="+", default=RATES, metavar="N", help="evaluations per ps")
    parser.add_argument("--record", type=Path, metavar="CSV", help="where the long runs go, if not to out/benchmarks")
    parser.add_argument("--quick", action="store_true", help="short runs")
    args = parser.parse_args()
    if args.quick:
        run(args.constraints, 4, 1, 0, 0.5, (500, 1000), (1, 0.5), args.methods)
    else:
        run(
            args.constraints,
            args.waters,
            args.starts,
            args.leave,
            args.duration,
            args.rates,
            SURVEY,
            args.methods,
            args.record,
        )


if __name__ == "__main__":
    main()
