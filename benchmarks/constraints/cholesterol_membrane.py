"""A Martini 2 membrane with cholesterol at steps of 20 and 30 fs: the temperature of each kind of molecule.

Cholesterol is modelled by two hinged triangles of constraints, for which OpenMM's constraint solver does not converge,
and that of GROMACS does not converge with its default settings. Cholesterol, lipids and water then have different
temperatures (doi:10.1021/acs.jpcb.1c03665, doi:10.1021/acs.jctc.2c01032). The script compares the geodesic flow, at
constant temperature and with a MonteCarloMembraneBarostat, with OpenMM's LangevinMiddleIntegrator, without and with the
dummy torsions of OpenMM's issue 3603.

Runs of DPPC alone (--composition DPPC --per-side 6) measure the area per lipid and the order parameter, which are known
from experiments.

Samples are written every 0.12 ps to CSV files in out/benchmarks/cholesterol_membrane, next to checkpoints, so that the
same command resumes an interrupted run. --table prints the averages of these files and writes records/cholesterol.csv
or records/dppc.csv.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common import starts
from benchmarks.common.pictures import plt
from benchmarks.common.records import OUT, RECORDS, picture_of, write
from benchmarks.common.starts import R, masses_of, positions_and_velocities
from benchmarks.constraints import martini

TEMPERATURE, FRICTION, PRESSURE = 323.0, 1.0, 1.0
COMPOSITIONS = {"DPPC-CHOL": {"DPPC": 0.7, "CHOL": 0.3}, "DPPC": {"DPPC": 1.0}}
METHODS = "exact", "LangevinMiddle", "LangevinMiddle, dummy torsions"
SAMPLE = 0.12  # ps
COLUMNS = ("time_ps", "T_CHOL_K", "T_lipid_K", "T_W_K", "area_nm2", "order", "constraint_nm")

TABLES = {"DPPC-CHOL": RECORDS / "cholesterol.csv", "DPPC": RECORDS / "dppc.csv"}
HEADS = {1: "T of cholesterol, K", 2: "T of lipids, K", 3: "T of water, K", 4: "area a lipid, nm²", 5: "order of tails"}
#: Columns of samples in the tables: with cholesterol the area rises for nanoseconds, and is not shown.
SHOWN = {"DPPC-CHOL": (1, 2, 3), "DPPC": (2, 3, 4, 5)}
#: Samples that are left out, in ps, and blocks of the error.
BURN_IN, BLOCKS = {"DPPC-CHOL": 12.0, "DPPC": 4000.0}, 10


class Membrane:
    """A bilayer, what it is made of, and what is measured in it."""

    def __init__(self, composition, per_side, area_changes=True):
        self.topology, self.system, self.positions = martini.bilayer(COMPOSITIONS[composition], per_side)
        self.molecules = 2 * per_side**2
        names = np.array([atom.residue.name for atom in self.topology.atoms()])
        self.kinds = [names == "CHOL", (names != "CHOL") & (names != "W"), names == "W"]
        self.masses = masses_of(self.system)
        constraints = [self.system.getConstraintParameters(i) for i in range(self.system.getNumConstraints())]
        self.pairs = np.array([c[:2] for c in constraints], dtype=int).reshape(-1, 2)
        self.lengths = np.array([c[2]._value for c in constraints])
        beads = {atom.index: atom.name for atom in self.topology.atoms() if atom.residue.name not in ("CHOL", "W")}
        self.tails = np.array([(i, i + 1) for i, n in beads.items() if n[0] == "C" and n[1] in "123"])
        if area_changes:
            modes = openmm.MonteCarloMembraneBarostat.XYIsotropic, openmm.MonteCarloMembraneBarostat.ZFree
            barostat = openmm.MonteCarloMembraneBarostat(PRESSURE, 0.0, TEMPERATURE, *modes, 15)
        else:
            pressures = openmm.Vec3(PRESSURE, PRESSURE, PRESSURE)
            barostat = openmm.MonteCarloAnisotropicBarostat(pressures, TEMPERATURE, False, False, True, 15)
        barostat.setRandomNumberSeed(5)
        self.system.addForce(barostat)

    def freedom(self, kind):
        """Degrees of freedom of a kind of molecules."""
        constraints = kind[self.pairs[:, 0]].sum() if len(self.pairs) else 0
        return 3 * (kind & (self.masses > 0.0)).sum() - constraints

    def sample(self, context):
        """Return what COLUMNS name: the order of tails is <3 cos² - 1>/2 of their bonds with the normal."""
        state = context.getState(positions=True, velocities=True)
        x, v = positions_and_velocities(state)
        twice = self.masses * (v**2).sum(axis=1)
        temperatures = [twice[kind].sum() / self.freedom(kind) / R if kind.any() else np.nan for kind in self.kinds]
        box = np.diag(state.getPeriodicBoxVectors(asNumpy=True)._value)
        bond = x[self.tails[:, 1]] - x[self.tails[:, 0]]
        order = (1.5 * bond[:, 2] ** 2 / (bond**2).sum(axis=1) - 0.5).mean()
        missed = np.linalg.norm(x[self.pairs[:, 0]] - x[self.pairs[:, 1]], axis=1) - self.lengths
        area = 2.0 * box[0] * box[1] / self.molecules
        return [state.getTime()._value, *temperatures, area, order, np.abs(missed).max(initial=0.0)]


def integrator_of(method, step, seed):
    """Return the integrator of a method."""
    if method == "exact":
        integrator = rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, FRICTION, step, checkDivergence=False)
    else:
        integrator = openmm.LangevinMiddleIntegrator(TEMPERATURE, FRICTION, step)
        integrator.setConstraintTolerance(1e-6)
    integrator.setRandomNumberSeed(seed)
    return integrator


def add_dummy_torsions(membrane):
    """Add torsions and angles of no strength within each cholesterol: they tell OpenMM's solver of coupled angles."""
    angles, torsions = openmm.HarmonicAngleForce(), openmm.PeriodicTorsionForce()
    for residue in membrane.topology.residues():
        if residue.name == "CHOL":
            ROH, _, R2, R3, _, _, C1, _ = (atom.index for atom in residue.atoms())
            torsions.addTorsion(ROH, R2, R3, C1, 1, 0.0, 0.0)
            for triangle in ((ROH, R2, R3), (C1, R2, R3)):
                for k in range(3):
                    a, b, c = np.roll(triangle, k)
                    sides = [np.linalg.norm(membrane.positions[p] - membrane.positions[q]) for p, q in ((a, b), (c, b))]
                    third = np.linalg.norm(membrane.positions[a] - membrane.positions[c])
                    cosine = (sides[0] ** 2 + sides[1] ** 2 - third**2) / (2 * sides[0] * sides[1])
                    angles.addAngle(int(a), int(b), int(c), float(np.arccos(cosine)), 0.0)
    membrane.system.addForce(angles)
    membrane.system.addForce(torsions)


def context_of(membrane, integrator, start=None):
    return starts.context_of(membrane.system, integrator, start, properties=starts.ONE_THREAD)


def save(file, content):
    with rb.written_whole(file, "wb") as out:
        out.write(content)


def equilibrated(membrane, picoseconds, file):
    """Return the XML of a State after a run of the geodesic flow at 30 fs, from a file if it is there."""
    if not file.exists():
        integrator = integrator_of("exact", 0.03, 1)
        context = context_of(membrane, integrator, membrane.positions)
        part = file.with_suffix(".chk")
        if part.exists():
            context.loadCheckpoint(part.read_bytes())
        else:
            integrator.setVelocitiesToTemperature(TEMPERATURE, 1)
            martini.relax(integrator, 0.03, FRICTION)
        integrator.setStepSize(0.03)
        while context.getTime()._value < picoseconds:
            integrator.step(1000)
            save(part, context.createCheckpoint())
            print(file.stem, *(f"{number:.4g}" for number in membrane.sample(context)), flush=True)
        state = context.getState(positions=True, velocities=True, parameters=True)
        save(file, openmm.XmlSerializer.serialize(state).encode())
    return openmm.XmlSerializer.deserialize(file.read_text())


def run(membrane, method, step, seed, start, picoseconds, folder):
    """Sample a method until this time, from where its file ends."""
    name = f"{method}-{1000 * step:g}fs-{seed}".replace(", ", "-").replace(" ", "-")
    rows, checkpoint = folder / f"{name}.csv", folder / f"{name}.chk"
    if "dummy" in method:
        add_dummy_torsions(membrane)
    integrator = integrator_of(method, step, seed)
    context = context_of(membrane, integrator, start)
    context.setTime(0.0)
    if checkpoint.exists():
        context.loadCheckpoint(checkpoint.read_bytes())
        kept = rows.read_text().splitlines()[: 1 + round(context.getTime()._value / SAMPLE)]
        rows.write_text("\n".join(kept) + "\n")
    else:
        rows.write_text(",".join(COLUMNS) + "\n")
    while context.getTime()._value < picoseconds:
        block = []
        for _ in range(100):
            try:
                integrator.step(round(SAMPLE / step))
                if method != "exact":  # velocities at the end of its step have parts along the constraints
                    context.applyVelocityConstraints(1e-8)
                block.append(membrane.sample(context))
            except (openmm.OpenMMException, ValueError, ArithmeticError) as error:
                print(f"{name}: {' '.join(str(error).split())[:150]}", flush=True)
                block.append([context.getTime()._value, *6 * [np.nan]])
            if not np.isfinite(block[-1][2]):
                break
        with rows.open("a") as file:
            file.writelines(",".join(f"{number:.7g}" for number in row) + "\n" for row in block)
        if not np.isfinite(block[-1][2]):
            return
        save(checkpoint, context.createCheckpoint())


def blocked(replicas):
    """Return mean and standard error by blocks of all replicas."""
    means = [block.mean() for values in replicas for block in np.array_split(values, BLOCKS)]
    return f"{np.mean(means):.4g} ± {np.std(means, ddof=1) / len(means) ** 0.5:.2g}"


def line_of(composition, method, step, folder):
    """Return a line of the table from the samples of a method at a step (fs), the first ones left out; or none."""
    columns, name = SHOWN[composition], f"{method}-{step}fs".replace(", ", "-").replace(" ", "-")
    runs = [np.loadtxt(f, delimiter=",", skiprows=1, ndmin=2) for f in sorted(folder.glob(f"{name}-*.csv"))]
    broken = [run[~np.isfinite(run[:, 2]), 0] for run in runs]
    if any(times.size for times in broken):
        first = min(times[0] for times in broken if times.size)
        return method, step, f"nan after {first:g}", *(len(columns) + 1) * ["nan"]
    kept = [run[run[:, 0] > BURN_IN[composition]] for run in runs]
    kept = [run for run in kept if len(run) >= BLOCKS]
    if not kept:
        return None
    numbers = [blocked([run[:, column] for run in kept]) for column in columns]
    missed = max(run[:, 6].max() for run in kept)
    return method, step, f"{sum(map(len, kept)) * SAMPLE:.0f}", *numbers, f"{missed:.1e}"


def tabulate(composition, folder):
    """Write the table of a composition from the samples."""
    heads = (HEADS[column] for column in SHOWN[composition])
    lines = [line_of(composition, method, step, folder) for method, step in itertools.product(METHODS, (20, 30))]
    columns = ("integrator", "step, fs", "length, ps", *heads, "largest constraint error, nm")
    write(TABLES[composition], columns, [line for line in lines if line])
    print(TABLES[composition].read_text())


def draw(composition, folder):
    """Draw the membrane at the end of the first run at 30 fs from the side: one slice of it."""
    membrane = Membrane(composition, 8)
    context = context_of(membrane, integrator_of("exact", 0.03, 1))
    context.loadCheckpoint((folder / "exact-30fs-1.chk").read_bytes())
    state, topology = context.getState(positions=True), membrane.topology
    x = state.getPositions(asNumpy=True)._value
    box = np.diag(state.getPeriodicBoxVectors(asNumpy=True)._value)
    turn = np.exp(2j * np.pi * x[~membrane.kinds[2], 2] / box[2]).mean()
    x[:, 2] += (0.5 - np.angle(turn) / (2.0 * np.pi)) * box[2]  # the bilayer in the middle
    figure, axes = plt.subplots(figsize=(5.6, 7.0), layout="constrained")
    for residue in topology.residues():
        atoms = [atom.index for atom in residue.atoms()]
        places = x[atoms] - box * np.floor(x[atoms].mean(axis=0) / box)
        if places[:, 1].mean() > 0.45 * box[1]:
            continue
        names = [atom.name for atom in residue.atoms()]
        if residue.name == "W":
            axes.plot(*places[0, [0, 2]], "o", color="#9ecae1", ms=7, alpha=0.6, zorder=0)
            continue
        colour = "#D55E00" if residue.name == "CHOL" else "0.45"
        bonds = martini.MOLECULES[residue.name]
        for i, j, *_ in (*bonds.bonds, *bonds.constraints):
            axes.plot(*places[[i, j]][:, [0, 2]].T, color=colour, lw=2.5 if residue.name == "CHOL" else 1.5, zorder=1)
        for name, place in zip(names, places, strict=True):
            if name in ("NC3", "PO4", "ROH"):
                tone = {"NC3": "#0072B2", "PO4": "#CC79A7", "ROH": "#E69F00"}[name]
                axes.plot(*place[[0, 2]], "o", color=tone, ms=6, zorder=2)
    axes.set_aspect("equal")
    axes.set_xlabel("x (nm)")
    axes.set_ylabel("z (nm)")
    axes.set_title(f"{composition} in water after {1e-3 * state.getTime()._value:.1f} ns: cholesterol in orange")
    figure.savefig(picture_of(TABLES[composition]), dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--composition", choices=COMPOSITIONS, default="DPPC-CHOL")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--steps", type=float, nargs="+", default=(20.0, 30.0), help="fs")
    parser.add_argument("--per-side", type=int, default=8, help="molecules along an edge of a leaflet (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the noise: replicas may run side by side (%(default)s)")
    parser.add_argument("--equilibrate", type=float, default=45.0, help="ps (%(default)s)")
    parser.add_argument("--length", type=float, default=3000.0, help="ps (%(default)s)")
    parser.add_argument("--table", action="store_true", help="write the record and its picture from what is there")
    args = parser.parse_args()
    folder = OUT / "cholesterol_membrane" / args.composition
    folder.mkdir(parents=True, exist_ok=True)
    if args.table:
        tabulate(args.composition, folder)
        if args.composition == "DPPC-CHOL":
            draw(args.composition, folder)
        return
    fluid = args.composition == "DPPC"  # whose area the lattice has: the water has to find its density first
    lattice = Membrane(args.composition, args.per_side, area_changes=not fluid)
    start = equilibrated(lattice, args.equilibrate, folder / "start.xml")
    for method in args.methods:
        for step in args.steps:
            membrane = Membrane(args.composition, args.per_side)
            run(membrane, method, step / 1000.0, args.seed, start, args.length, folder)


if __name__ == "__main__":
    main()
