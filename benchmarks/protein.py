"""A protein in water: energy error and time over those of OpenMM's Verlet, at equal evaluations of the forces.

PME on the CPU platform, bonds to hydrogen constrained, amber14 with TIP3P: standard deviation of the total energy
within windows of 0.5 ps, and processor time (one thread), both over those of OpenMM's VerletIntegrator, which gets the
same number of evaluations of the nonbonded forces per ps. Without --pdb it is a helix of 35 alanines, built and
solvated here; any solvated PDB file with standard residues and water will do in its place, such as the villin headpiece
that OpenMM's Python examples come with (input.pdb).

Starts and rows go to out/benchmarks/protein_*; what stands there is not run again, so that the same command goes on
after a break. --quick runs a short version.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from device import FORCE_FIELD
from water import OUT, energy_noise

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
COLUMNS = ("method", "forces_a_ps", "energy_std_half_ps", "energy_std_run", "bonded_per_force")
# Bonds (nm), angles and torsions (degrees) of an ideal helix: C-N, N-CA, CA-C and what each new atom turns about.
BACKBONE = {"N": (0.1329, 116.6, -47.0), "CA": (0.1458, 121.7, 180.0), "C": (0.1525, 111.0, -57.0)}


def placed(a, b, c, bond, angle, torsion):
    """Return the place of an atom by its distance to c, its angle with b and its torsion about b-c."""
    angle, torsion = np.radians(angle), np.radians(torsion)
    along = (c - b) / np.linalg.norm(c - b)
    normal = np.cross(b - a, along)
    normal /= np.linalg.norm(normal)
    frame = np.array([along, np.cross(normal, along), normal])
    turned = np.array([-np.cos(angle), np.sin(angle) * np.cos(torsion), np.sin(angle) * np.sin(torsion)])
    return c + bond * turned @ frame


def helix(residues):
    """Return Topology and positions (nm) of a helix of alanines with charged ends; hydrogens are missing."""
    backbone = [np.array([0.0, 0.0, 0.0]), np.array([0.1458, 0.0, 0.0]), np.array([0.2004, 0.1424, 0.0])]
    for _ in range(residues - 1):
        for geometry in BACKBONE.values():
            backbone.append(placed(*backbone[-3:], *geometry))
    backbone.append(placed(*backbone[-3:], *BACKBONE["N"]))
    topology, places = app.Topology(), []
    chain = topology.addChain()
    carbon, nitrogen, oxygen = (app.element.get_by_symbol(symbol) for symbol in "CNO")
    for i in range(residues):
        n, ca, c, following = backbone[3 * i : 3 * i + 4]
        residue = topology.addResidue("ALA", chain)
        atoms = {
            "N": (nitrogen, n),
            "CA": (carbon, ca),
            "C": (carbon, c),
            "O": (oxygen, placed(following, ca, c, 0.1231, 120.4, 180.0)),
            "CB": (carbon, placed(c, n, ca, 0.153, 110.0, -122.6)),
        }
        if i == residues - 1:
            atoms["OXT"] = (oxygen, following)
        for name, (element, place) in atoms.items():
            topology.addAtom(name, element, residue)
            places.append(place)
    topology.createStandardBonds()
    return topology, np.array(places)


def solvated_helix(residues):
    """Return Topology and positions (nm) of a helix in a box of water."""
    topology, places = helix(residues)
    modeller = app.Modeller(topology, places * unit.nanometer)
    force_field = app.ForceField(*FORCE_FIELD)
    modeller.addHydrogens(force_field, platform=openmm.Platform.getPlatform("CPU"))
    modeller.addSolvent(force_field, padding=0.9 * unit.nanometer)
    return modeller.topology, np.array(modeller.positions.value_in_unit(unit.nanometer))


def context_of(system, integrator):
    return openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"), {"Threads": "1"})


def equilibrated(system, positions, picoseconds, n_starts, file):
    """Return canonical starts, from a file or a Langevin run."""
    if not file.exists():
        langevin = openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.002)
        langevin.setRandomNumberSeed(1)
        context = context_of(system, langevin)
        context.setPositions(positions)
        openmm.LocalEnergyMinimizer.minimize(context, 50.0, 200)
        context.setVelocitiesToTemperature(300.0, 1)
        langevin.step(round(picoseconds / 0.002))
        starts = []
        for _ in range(n_starts):
            langevin.step(250)
            state = context.getState(positions=True, velocities=True)
            starts.append([state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value])
        np.save(file, starts)
    return list(np.load(file))


def prepared(bare, method, rate):
    """Return System and integrator of a method with `rate` evaluations of the nonbonded forces per ps."""
    system = openmm.XmlSerializer.clone(bare)
    bonded = rb.separate_bonded(system)  # which MTSIntegrator needs
    if method == "Verlet":
        integrator = openmm.VerletIntegrator(1.0 / rate)
    elif method == "MTSIntegrator":
        substeps = max(2, round(1.0 / rate / INNER))
        integrator = openmm.MTSIntegrator(1.0 / rate * unit.picosecond, [(0, 1), (bonded, substeps)])
    else:
        scheme, options = METHODS[method]
        integrator = rb.ExactRigidBodyIntegrator(rb.SCHEMES[scheme].forces / rate, scheme=scheme, **options)
        return system, integrator
    integrator.setConstraintTolerance(1e-8)
    return system, integrator


def measured(bare, starts, duration, method, rate):
    """Return a row: standard deviations in windows of 0.5 ps and in whole runs, and bonded evaluations per force."""
    system, integrator = prepared(bare, method, rate)
    try:
        spread = energy_noise(system, integrator, starts, duration, "CPU")
    except openmm.OpenMMException:  # a run that OpenMM itself found to be infinite
        spread = (np.inf,)
    ours = isinstance(integrator, rb.ExactRigidBodyIntegrator) and integrator.timings
    bonded = ours.fast_evaluations / ours.evaluations if ours else np.nan
    return method, rate, spread[0], spread[-1], bonded


def seconds_a_ps(bare, start, rate, names, rounds, forces):
    """Return processor times per ps: of some rounds through all methods the fastest.

    So that all of them meet the same neighbours on the machine, which only add to the times.
    """
    runs = {}
    for method in names:
        system, integrator = prepared(bare, method, rate)
        context = context_of(system, integrator)
        context.setPositions(start[0])
        context.setVelocities(start[1])
        each = integrator.forceEvaluationsPerStep if isinstance(integrator, rb.ExactRigidBodyIntegrator) else 1
        integrator.step(2)
        runs[method] = context, integrator, each, max(1, round(forces / each))
    times = {method: [] for method in names}
    for _ in range(rounds):
        for method, (_context, integrator, each, steps) in runs.items():
            begun = time.process_time()
            integrator.step(steps)
            times[method].append((time.process_time() - begun) / (steps * each) * rate)
    return {method: min(seconds) for method, seconds in times.items()}


def run(name, topology, positions, starts, duration, rate, names, rounds=(5, 12)):
    """Measure methods that have no row yet, time all of them, and print them over Verlet."""
    bare = app.ForceField(*FORCE_FIELD).createSystem(
        topology,
        nonbondedMethod=app.PME,
        nonbondedCutoff=0.9 * unit.nanometer,
        switchDistance=0.8 * unit.nanometer,
        constraints=app.HBonds,
        removeCMMotion=False,
    )
    bodies = f"{bare.getNumParticles()} atoms, {bare.getNumConstraints()} constraints"
    begins = equilibrated(bare, positions, 2.0 if duration >= 1.0 else 0.2, starts, OUT / f"protein_{name}_starts.npy")
    file = OUT / f"protein_{name}_{starts}x{duration:g}ps_{rate}.csv"
    if not file.exists():
        file.write_text(",".join(COLUMNS) + "\n")
    known = {row["method"]: row for row in csv.DictReader(file.read_text().splitlines())}
    for method in names:
        if method not in known:
            row = measured(bare, begins, duration, method, rate)
            with file.open("a") as lines:
                csv.writer(lines).writerow(row)
            known[method] = dict(zip(COLUMNS, row, strict=True))
    stable = [method for method in known if np.isfinite(float(known[method]["energy_std_half_ps"]))]
    seconds = seconds_a_ps(bare, begins[0], rate, stable, *rounds)
    print(f"{name}: {bodies}, {rate} evaluations per ps, {starts} starts of {duration:g} ps\n")
    print("| method | std, kJ/mol | Verlet's over it | bonded evaluations per force | time over Verlet's |")
    print("|" + 5 * " --- |")
    base = float(known["Verlet"]["energy_std_half_ps"])
    for method, row in known.items():
        error, bonded = float(row["energy_std_half_ps"]), float(row["bonded_per_force"])
        took = f"{seconds[method] / seconds['Verlet']:.2f}" if method in stable else ""
        print(f"| {method} | {error:.3g} | {base / error:.2g} | {bonded:.2g} | {took} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pdb", type=Path, help="a solvated protein (a helix that is built here)")
    parser.add_argument("--starts", type=int, default=2, metavar="N", help="starts (%(default)s)")
    parser.add_argument("--duration", type=float, default=1.0, metavar="PS", help="ps from each start (%(default)s)")
    parser.add_argument("--rate", type=int, default=250, metavar="N", help="evaluations per ps (%(default)s)")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS), metavar="NAME")
    parser.add_argument("--quick", action="store_true", help="short runs of a short helix")
    args = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    if args.quick:
        run("short", *solvated_helix(4), 1, 0.5, 250, ["Verlet", "S2_3"], (2, 6))
        return
    if args.pdb is None:
        name, topology, positions = "helix", *solvated_helix(35)
    else:
        pdb = app.PDBFile(str(args.pdb))
        name, topology, positions = args.pdb.stem, pdb.topology, pdb.positions
    run(name, topology, positions, args.starts, args.duration, args.rate, args.methods)


if __name__ == "__main__":
    main()
