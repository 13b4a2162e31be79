"""Constrained Martini rings, cholesterol and a dodecahedron: temperatures and constraint errors at 20 and 30 fs.

Copies of one molecule that do not interact, with the bonds, angles and impropers of the force field, are coupled to a
Langevin thermostat with a friction of 5/ps at 310 K. Errors of a constraint solver change the temperature, which is
computed from the velocities of the beads and the degrees of freedom. Martini 2: doi:10.1021/ct700324x with the rings of
doi:10.1021/ct300646g; Martini 3: doi:10.1038/s41592-021-01098-3; cholesterol as in `martini`. Each molecule is also
simulated with OpenMM's LangevinMiddleIntegrator, tolerance 1e-6. Every run has a separate seed, so that rows are
independent.

Rows are added to records/martini_rings.csv as runs finish; runs that the file contains are not repeated.
"""

from __future__ import annotations

import argparse
import itertools
import zlib

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import R, context_of, positions_and_velocities
from benchmarks.constraints import martini

RUN = ("molecule", "step_fs", "integrator")
TABLE = Record(RECORDS / "martini_rings.csv", RUN, ("seed", "T_K", "error_K", "largest_constraint_error_nm"))
TEMPERATURE, FRICTION, SAMPLE, BLOCKS = 310.0, 5.0, 0.3, 20


def ring(first_bond, sides, angles, impropers, masses):
    """Return a side chain on its backbone bead 0: masses, bond to bead 1, constraints, angles and impropers."""
    return {
        "masses": (72.0, *masses),
        "bonds": (first_bond,),
        "constraints": sides,
        "angles": angles,
        "impropers": impropers,
    }


def _triangle(length, strength, sides, mass, angle, improper):
    a, b, c = sides
    return ring(
        (0, 1, length, strength),
        ((1, 2, a), (1, 3, b), (2, 3, c)),
        ((0, 1, 2, angle, 50.0), (0, 1, 3, angle, 50.0)),
        ((0, 2, 3, 1, 0.0, 50.0),) if improper else (),
        3 * [mass],
    )


def _dodecahedron():
    """Return twenty beads at the corners, thirty edges of 0.3 nm constrained."""
    golden = (1 + 5**0.5) / 2
    signs = [(a, b) for a in (-1, 1) for b in (-1, 1)]
    x = [(a, b, c) for a, b in signs for c in (-1, 1)]
    for a, b in signs:
        x += [(0, a / golden, b * golden), (a / golden, b * golden, 0), (a * golden, 0, b / golden)]
    x = np.array(x) * 0.3 * golden / 2
    edges = [(i, j, 0.3) for i in range(20) for j in range(i) if abs(np.linalg.norm(x[i] - x[j]) - 0.3) < 1e-9]
    return {"masses": 20 * [72.0], "bonds": (), "constraints": edges, "angles": (), "impropers": (), "places": x}


_FIVE = ((1, 2), (2, 3), (1, 3), (2, 4), (3, 4))
_M3_TRP = ((1, 2, 0.335), (2, 4, 0.412), (3, 4, 0.293), (1, 3, 0.404), (2, 3, 0.470))
_M3_TYR = ((1, 2, 0.3), (1, 3, 0.3), (2, 4, 0.285), (3, 4, 0.285), (2, 3, 0.3))
_CHOL = martini.MOLECULES["CHOL"]
MOLECULES = {
    "Martini 2 PHE": _triangle(0.31, 7500.0, (0.27, 0.27, 0.27), 45.0, 150.0, True),
    "Martini 2 TYR": _triangle(0.32, 5000.0, (0.27, 0.27, 0.27), 45.0, 150.0, True),
    "Martini 2 HIS": _triangle(0.32, 7500.0, (0.27, 0.27, 0.27), 45.0, 150.0, True),
    "Martini 2 TRP": ring(
        (0, 1, 0.30, 5000.0),
        tuple((i, j, 0.27) for i, j in _FIVE),
        ((0, 1, 2, 210.0, 50.0), (0, 1, 3, 90.0, 50.0)),
        ((0, 2, 3, 1, 0.0, 50.0), (1, 2, 4, 3, 0.0, 200.0)),
        4 * [45.0],
    ),
    "Martini 3 PHE": _triangle(0.325, 7500.0, (0.34, 0.34, 0.29), 36.0, 120.0, False),
    "Martini 3 HIS": _triangle(0.336, 7500.0, (0.32, 0.30, 0.27), 36.0, 120.0, False),
    "Martini 3 TYR": ring(
        (0, 1, 0.325, 5000.0),
        _M3_TYR,
        ((0, 1, 2, 120.0, 60.0), (0, 1, 3, 120.0, 60.0)),
        ((4, 2, 3, 1, 180.0, 50.0),),
        4 * [36.0],
    ),
    "Martini 3 TRP": ring(
        (0, 1, 0.315, 5000.0),
        _M3_TRP,
        ((0, 1, 2, 120.0, 60.0), (0, 1, 3, 130.0, 60.0)),
        ((4, 3, 2, 1, 180.0, 100.0),),
        4 * [36.0],
    ),
    "cholesterol": {
        "masses": [77.22, 38.69, 159.65, 39.44, 72.0],  # its virtual sites do nothing here
        "bonds": ((3, 4, 0.425, 1250.0),),
        "constraints": ((0, 1, 0.4904), (0, 2, 0.6019), (1, 2, 0.2719), (3, 1, 0.7237), (3, 2, 0.5376)),
        "angles": ((2, 3, 4, 180.0, 25.0),),
        "impropers": ((0, 1, 2, 3, -179.7, 50.0),),
        "places": _CHOL.places[[0, 2, 3, 6, 7]],
    },
    "dodecahedron": _dodecahedron(),
}


def places_of(molecule):
    """Return places (n, 3) in nm: a flat ring from its distances, the backbone beside it."""
    if "places" in molecule:
        return molecule["places"]
    lengths = {frozenset((i, j)): d for i, j, d in molecule["constraints"]}
    x = np.zeros((len(molecule["masses"]), 3))
    x[2, 0] = lengths[frozenset((1, 2))]
    # Each further bead of the ring by two known ones, on the other side of their line than the one before.
    known = [1, 2]
    for bead in range(3, len(x)):
        i, j = [k for k in known if frozenset((bead, k)) in lengths][-2:]
        a, b, c = lengths[frozenset((i, bead))], lengths[frozenset((j, bead))], np.linalg.norm(x[j] - x[i])
        along = (a * a - b * b + c * c) / (2 * c)
        forward = (x[j] - x[i]) / c
        aside = np.array([-forward[1], forward[0], 0.0])
        third = next((k for k in known if k not in (i, j)), None)
        side = 1.0 if third is None else -np.sign((x[third] - x[i]) @ aside)
        x[bead] = x[i] + along * forward + side * np.sqrt(a * a - along * along) * aside
        known.append(bead)
    centre = x[1:].mean(axis=0)
    length = molecule["bonds"][0][2]
    x[0] = x[1] + length * (x[1] - centre) / np.linalg.norm(x[1] - centre) + [0.0, 0.0, 0.01]
    return x


def system_of(molecule, copies):
    """Return System and positions of copies that do not meet."""
    system, n, x = openmm.System(), len(molecule["masses"]), places_of(molecule)
    bonds, angles = openmm.HarmonicBondForce(), openmm.CustomAngleForce("0.5*k*(cos(theta) - cos0)^2")
    impropers = openmm.CustomTorsionForce(
        "0.5*k*d*d; d = t - 6.283185307179586*floor(t/6.283185307179586 + 0.5); t = theta - t0"
    )
    for parameter in ("k", "cos0"):
        angles.addPerAngleParameter(parameter)
    for parameter in ("k", "t0"):
        impropers.addPerTorsionParameter(parameter)
    for first in range(0, n * copies, n):
        for mass in molecule["masses"]:
            system.addParticle(mass)
        for i, j, length in molecule["constraints"]:
            system.addConstraint(first + i, first + j, length)
        for i, j, length, k in molecule["bonds"]:
            bonds.addBond(first + i, first + j, length, k)
        for i, j, l, angle, k in molecule["angles"]:
            angles.addAngle(first + i, first + j, first + l, [k, np.cos(np.radians(angle))])
        for *four, angle, k in molecule["impropers"]:
            impropers.addTorsion(*(first + i for i in four), [k, np.radians(angle)])
    for force in (bonds, angles, impropers):
        system.addForce(force)
    edge = int(np.ceil(copies ** (1 / 3)))
    lattice = 3.0 * (np.argwhere(np.ones(3 * (edge,)))[:copies] - 0.5 * (edge - 1))
    return system, (lattice[:, None] + x).reshape(-1, 3)


def seed_of(name, step_fs, kind):
    """Return the seed of a run, another one for every row of the table."""
    return zlib.crc32(f"{name} {step_fs} {kind}".encode()) % 2**30 + 1  # OpenMM takes 0 for any seed


def measured(name, step, kind, copies, picoseconds, seed):
    """Return mean temperature, its error, and the largest error of a constraint; nan where it blows up."""
    molecule = MOLECULES[name]
    system, x = system_of(molecule, copies)
    if kind == "exact":
        integrator = rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, FRICTION, step)
    else:
        integrator = openmm.LangevinMiddleIntegrator(TEMPERATURE, FRICTION, step)
        integrator.setConstraintTolerance(1e-6)
    integrator.setRandomNumberSeed(seed)
    context = context_of(system, integrator, x, "Reference")
    (integrator if kind == "exact" else context).setVelocitiesToTemperature(TEMPERATURE, seed)
    pairs = np.array([(i, j) for i, j, _ in molecule["constraints"]])
    lengths = np.array([length for *_, length in molecule["constraints"]])
    freedom = (3 * len(molecule["masses"]) - len(pairs)) * copies
    masses = np.tile(molecule["masses"], copies)
    temperatures, missed = [], 0.0
    try:
        integrator.step(round(3.0 / step))
        for _ in range(round(picoseconds / SAMPLE)):
            integrator.step(round(SAMPLE / step))
            if kind != "exact":
                context.applyVelocityConstraints(1e-8)  # those of the end of its step have parts along the constraints
            X, v = positions_and_velocities(context.getState(positions=True, velocities=True))
            X = X.reshape(copies, -1, 3)
            temperatures.append((masses @ (v * v).sum(axis=1)) / freedom / R)
            error = np.abs(np.linalg.norm(X[:, pairs[:, 0]] - X[:, pairs[:, 1]], axis=2) - lengths).max()
            missed = max(missed, error) if np.isfinite(error) else np.nan
            if not np.isfinite(missed):
                return np.nan, np.nan, np.nan
    except openmm.OpenMMException:
        return np.nan, np.nan, np.nan
    means = [block.mean() for block in np.array_split(np.array(temperatures), BLOCKS)]
    return np.mean(means), np.std(means, ddof=1) / BLOCKS**0.5, missed


def print_means():
    """Print the mean temperature over the molecules of the table, for each integrator and step."""
    rows = [row for row in TABLE.rows().values() if row["T_K"] != "nan"]
    for kind, step in sorted({(row["integrator"], row["step_fs"]) for row in rows}):
        found = [row for row in rows if (row["integrator"], row["step_fs"]) == (kind, step)]
        T, weights = (np.array([float(row[column]) for row in found]) for column in ("T_K", "error_K"))
        weights = weights**-2.0
        mean, error = weights @ T / weights.sum(), weights.sum() ** -0.5
        print(f"{kind}, {step} fs, {len(found)} molecules: {mean:.2f} +- {error:.2f} K")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--copies", type=int, default=300)
    parser.add_argument("--length", type=float, default=45.0, help="ps (%(default)s)")
    parser.add_argument("--molecules", nargs="+", choices=MOLECULES, default=MOLECULES)
    args = parser.parse_args()
    for name, step, kind in itertools.product(args.molecules, (20, 30), ("exact", "LangevinMiddle")):
        run = dict(zip(RUN, (name, step, kind), strict=True))
        if run not in TABLE:
            seed = seed_of(name, step, kind)
            T, error, missed = measured(name, step / 1000.0, kind, args.copies, args.length, seed)
            found = {"T_K": f"{T:.2f}", "error_K": f"{error:.2f}", "largest_constraint_error_nm": f"{missed:.2g}"}
            TABLE.add(run | {"seed": seed} | found)
    print_means()


if __name__ == "__main__":
    main()
