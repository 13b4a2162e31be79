"""A peptide in rigid water: energy error against cost for OpenMM's own integrators and ours, plain and nested.

Alanine dipeptide (amber14) in a droplet of 32 TIP3P molecules without cutoff, on Reference, with bonds to hydrogen
constrained or, with --constraints None, with none but those of water. Standard deviation of the total energy within
windows of 0.5 ps and within whole runs, against evaluations of the nonbonded forces a ps, all from the same starts,
which are made here with fixed seeds. Nested schemes and OpenMM's MTSIntegrator have the bonded forces in steps of their
own; of these, the evaluations a ps are counted beside.

Raw data go to out/benchmarks/peptide_*.csv and a picture beside them. --quick runs a short version.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from water import OUT, STYLES, energy_noise, equilibrated

mpl.use("Agg")
import matplotlib.pyplot as plt

PEPTIDE = Path(__file__).parent.parent / "examples" / "data" / "alanine_dipeptide.pdb"
CONSTRAINTS = {"HBonds": app.HBonds, "AllBonds": app.AllBonds, "None": None}
RATES = (250, 500, 1000, 2000)
SCHEMES = ("S2_2", "S2_3", "W2_4", "W4_5", "SRKN4_6b")
#: Steps of MTSIntegrator's bonded forces, in ps.
INNER = 0.0005


def droplet(waters, constraints):
    """Return System and positions (nm) of the peptide and the molecules of water next to it; bonded forces apart."""
    pdb = app.PDBFile(str(PEPTIDE))
    force_field = app.ForceField("amber14-all.xml", "amber14/tip3p.xml")
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
    rb.separate_bonded(system)
    return system, np.array(modeller.positions.value_in_unit(unit.nanometer))


def integrators(rate, bonded):
    """Return the integrators of one row by name, with `rate` evaluations of the nonbonded forces a ps."""
    verlet = openmm.VerletIntegrator(1.0 / rate)
    substeps = max(2, round(1.0 / rate / INNER))
    mts = openmm.MTSIntegrator(1.0 / rate * unit.picosecond, [(0, 1), (bonded, substeps)])
    found = {"Verlet": verlet, "MTSIntegrator": mts}
    for name in SCHEMES:
        h = rb.SCHEMES[name].stages / rate
        found[name] = rb.ExactRigidBodyIntegrator(h, scheme=name)
        found[f"{name} nested"] = rb.ExactRigidBodyIntegrator(h, scheme=name, fast="bonded")
    for other in (verlet, mts):
        other.setConstraintTolerance(1e-10)
    return found


def measured(system, starts, duration, rate, name, integrator):
    """Return a row: errors in kJ/mol of the whole droplet, evaluations of bonded forces a ps, seconds a ps."""
    start = time.process_time()
    try:
        swing, whole = energy_noise(system, integrator, starts, duration, "Reference")
    except openmm.OpenMMException:  # a run that OpenMM itself found to be infinite
        swing = whole = np.inf
    seconds = (time.process_time() - start) / (duration * len(starts))
    bonded = rate
    if isinstance(integrator, rb.ExactRigidBodyIntegrator):
        timings = integrator.timings
        bonded = rate * (timings.fast_evaluations / timings.evaluations if "nested" in name else 1.0)
    elif name == "MTSIntegrator":
        bonded = rate * max(2, round(1.0 / rate / INNER))
    return name, rate, swing, whole, bonded, seconds


def run(constraints, waters, n_starts, duration, rates):
    """Measure all integrators at all rates, write the rows, print the best of each family and draw them."""
    system, positions = droplet(waters, constraints)
    bonded = next(f.getForceGroup() for f in system.getForces() if isinstance(f, openmm.HarmonicAngleForce))
    starts = equilibrated(system, positions, "Reference", 5.0, n_starts)
    rows = []
    with (OUT / f"peptide_{constraints}.csv").open("w") as file:
        file.write("method,nonbonded_a_ps,energy_std_half_ps,energy_std_run,bonded_a_ps,cpu_s_a_ps\n")
        for rate in rates:
            for name, integrator in integrators(rate, bonded).items():
                rows.append(measured(system, starts, duration, rate, name, integrator))
                file.write(",".join(map(str, rows[-1])) + "\n")
                file.flush()
                print(f"{rate:5d} a ps {name:>16}: " + ", ".join(f"{x:.2g}" for x in rows[-1][2:]), flush=True)
    families = table(rows, rates)
    draw(families, constraints, waters)


def table(rows, rates):
    """Print and return the errors of each family: OpenMM's integrators, and the best of ours, plain and nested."""
    families = {"Verlet": [], "MTSIntegrator": [], "best plain": [], "best nested": []}
    for rate in rates:
        here = {row[0]: row for row in rows if row[1] == rate}
        ours = [row for row in here.values() if row[0] not in families]
        plain = min((row for row in ours if "nested" not in row[0]), key=lambda row: row[2])
        nested = min((row for row in ours if "nested" in row[0]), key=lambda row: row[2])
        for family, row in zip(families, (here["Verlet"], here["MTSIntegrator"], plain, nested), strict=True):
            families[family].append(row)
    print("\n| a ps | " + " | ".join(families) + " |\n|" + 5 * " --- |")
    for i, rate in enumerate(rates):
        cells = [family[i] for family in families.values()]
        texts = [f"{row[2]:.2g}" + f" ({row[0]})" * (k > 1) for k, row in enumerate(cells)]
        print(f"| {rate} | " + " | ".join(texts) + " |")
    return families


def draw(families, constraints, waters):
    figure, axes = plt.subplots(figsize=(7.0, 4.6), layout="constrained")
    for (family, rows), (colour, marker) in zip(families.items(), STYLES, strict=False):
        points = [(row[1], row[2]) for row in rows if np.isfinite(row[2])]
        line = "-" if family.startswith("best") else "--"
        axes.loglog(
            *zip(*points, strict=True), color=colour, marker=marker, ls=line, label=family, mec="black", mew=0.4
        )
    axes.set_xlabel("evaluations of the nonbonded forces per ps")
    axes.set_ylabel("std of total energy within 0.5 ps (kJ/mol)")
    axes.set_title(f"Alanine dipeptide and {waters} TIP3P, constraints={constraints}, NVE")
    axes.set_xticks([row[1] for row in rows], [str(row[1]) for row in rows])
    axes.minorticks_off()
    axes.grid(True, alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(OUT / f"peptide_{constraints}.png", dpi=150)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--constraints", choices=CONSTRAINTS, default="HBonds", help="of the peptide (%(default)s)")
    parser.add_argument("--waters", type=int, default=32, metavar="N", help="molecules of water (%(default)s)")
    parser.add_argument("--starts", type=int, default=2, metavar="N", help="starts (%(default)s)")
    parser.add_argument("--duration", type=float, default=1.0, metavar="PS", help="ps from each start (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="short runs")
    args = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    if args.quick:
        run(args.constraints, 4, 1, 0.5, (500, 1000))
    else:
        run(args.constraints, args.waters, args.starts, args.duration, RATES)


if __name__ == "__main__":
    main()
