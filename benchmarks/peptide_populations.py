"""How the dihedral populations of a peptide depend on the step: alanine dipeptide in implicit solvent.

Many copies in one System, 12 nm apart and with a cutoff of 2 nm, do not see each other, and cost hardly more than one:
amber14 with OBC2, bonds to hydrogen held, hydrogens of 3 amu, CPU platform. Copies begin in one conformation; what they
do before `BURN` is not counted. Errors are from the scatter between copies, which are independent. Runs that
docs/peptide_populations.csv has are not run again.

    python benchmarks/peptide_populations.py --integrators LangevinMiddle --fs 1 2 4 --runs 2
    python benchmarks/peptide_populations.py --integrators W2_3m BAOA --fs 4 6 8 --runs 2
    python benchmarks/peptide_populations.py --finished
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb import ensemble
from openmm_exactrb.files import written_whole
from openmm_exactrb.schemes import splitting
from peptide import PEPTIDE
from protein_steps import HEAVY, KINDS, OPENMM, TEMPERATURE, backbone, dihedrals, regions

TABLE = Path(__file__).resolve().parents[1] / "docs" / "peptide_populations.csv"
OUT = Path("out/peptide_populations")
COPIES, APART = 64, 12.0  # how many, and nm between neighbours
BURN, LOOKED = 100.0, 0.5  # ps that are not counted, and ps between two samples
REGIONS = ("helical", "left", "extended")
MEASURED = (*REGIONS, "T", *KINDS, "changes")
POINT = ("integrator", "fs", "friction", "nanoseconds", "seed")
COLUMNS = (*POINT, *MEASURED, *(f"{name} error" for name in MEASURED))
R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


@cache
def copies() -> tuple[app.Topology, openmm.System, np.ndarray]:
    """Return copies of the peptide in implicit solvent, each kind of bonded force in a group of its own."""
    content = app.PDBFile(str(PEPTIDE))
    modeller = app.Modeller(content.topology, content.positions)
    edge = math.ceil(COPIES ** (1 / 3))
    for place in itertools.islice(itertools.product(range(edge), repeat=3), 1, COPIES):
        modeller.add(content.topology, content.positions + APART * np.array(place) * unit.nanometer)
    force_field = app.ForceField("amber14-all.xml", "implicit/obc2.xml")
    system = force_field.createSystem(
        modeller.topology,
        nonbondedMethod=app.CutoffNonPeriodic,
        nonbondedCutoff=2.0 * unit.nanometer,
        constraints=app.HBonds,
        removeCMMotion=False,
    )
    rb.heavy_hydrogens(system, modeller.topology, HEAVY)
    for force in system.getForces():
        force.setForceGroup(next((n for n, kind in enumerate(KINDS.values(), 1) if isinstance(force, kind)), 0))
    return modeller.topology, system, modeller.positions


def integrator_of(name: str, interval: float, friction: float) -> openmm.Integrator:
    """Return what evaluates the nonbonded forces every `interval` ps."""
    if name in OPENMM:
        return OPENMM[name](TEMPERATURE, friction, interval)
    return rb.ExactRigidBodyLangevinIntegrator(
        TEMPERATURE, friction, splitting(name).forces * interval, scheme=name, fast="bonded"
    )


def torsions_of(topology: app.Topology) -> dict[str, np.ndarray]:
    """Return the atoms (copies, 4) of phi and psi."""
    n = topology.getNumAtoms() // COPIES
    return {name: np.array(four) + n * np.arange(COPIES)[:, None] for name, four in backbone(topology).items()}


def means_of(integrator: str, fs: float, friction: float, nanoseconds: float, seed: int) -> dict[str, float]:
    """Return means over copies, and their errors."""
    topology, system, positions = copies()
    mover = integrator_of(integrator, 0.001 * fs, friction)
    mover.setRandomNumberSeed(seed)
    step = mover.getStepSize()._value
    context = openmm.Context(system, mover, openmm.Platform.getPlatform("CPU"), {"Threads": "1"})
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 1.0, 200)
    context.setVelocitiesToTemperature(TEMPERATURE, seed)
    every = max(1, round(LOOKED / step))
    try:
        mover.step(round(BURN / step))
        return sampled(context, mover, every, math.ceil(1000.0 * nanoseconds / COPIES / (every * step)), topology)
    except (openmm.OpenMMException, rb.IntegrationError):
        return dict.fromkeys(COLUMNS[len(POINT) :], math.nan)


def sampled(
    context: openmm.Context, mover: openmm.Integrator, every: int, samples: int, topology: app.Topology
) -> dict[str, float]:
    """Return means over so many samples of all copies."""
    system, of = context.getSystem(), torsions_of(topology)
    mass = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())]).reshape(COPIES, -1)
    freedom = 3 * mass.shape[1] - system.getNumConstraints() // COPIES
    rows: dict[str, list[np.ndarray]] = {name: [] for name in MEASURED if name != "changes"}
    for _ in range(samples):
        mover.step(every)
        state = context.getState(positions=True, velocities=True)
        x, v = (get(asNumpy=True)._value for get in (state.getPositions, state.getVelocities))
        kinetic = (mass * np.square(v).sum(axis=1).reshape(mass.shape)).sum(axis=1)
        helical, left = regions(*(dihedrals(*x[four.T]) for four in of.values()))
        values = {"helical": helical, "left": left, "extended": ~left & ~helical, "T": kinetic / (freedom * R)}
        for group, kind in enumerate(KINDS, 1):  # of all copies: their scatter is that in time
            energy = context.getState(energy=True, groups=1 << group).getPotentialEnergy()._value / COPIES
            values[kind] = np.full(1, energy)
        for name, value in values.items():
            rows[name].append(value.astype(float))
    result = {}
    for name, value in rows.items():
        series = np.array(value)
        if series.shape[1] == 1:  # blocks in time
            parts = np.array([part.mean() for part in np.array_split(series[:, 0], 20)])
        else:
            parts = series.mean(axis=0)
        result |= {name: series.mean(), f"{name} error": parts.std(ddof=1) / math.sqrt(len(parts))}
    jumps = np.abs(np.diff(np.array(rows["helical"]), axis=0)).sum(axis=0)
    return result | {"changes": jumps.sum(), "changes error": math.nan}


Row = dict[str, str]


def read(file: Path) -> list[Row]:
    """Return the rows of the record."""
    if not file.exists():
        return []
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def write(file: Path, rows: list[Row]) -> None:
    with written_whole(file) as out:
        table = csv.DictWriter(out, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(sorted(rows, key=lambda row: (row["integrator"], *(float(row[k]) for k in POINT[1:]))))


def summary(rows: list[Row]) -> Iterator[str]:
    """Yield the means of each point over its runs, with errors."""
    key = lambda row: tuple(row[name] for name in POINT[:-2])  # noqa: E731
    for point, some in itertools.groupby(sorted(rows, key=key), key):
        runs = list(some)
        yield f"{' '.join(point)}: {len(runs)} runs of {runs[0]['nanoseconds']} ns"
        for name in MEASURED:
            mean = np.mean([float(row[name]) for row in runs])
            error = math.hypot(*(float(row[f"{name} error"]) for row in runs)) / len(runs)
            yield f"    {name:10} {mean:9.4f} +- {error:.4f}"


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--integrators", nargs="+", default=["LangevinMiddle", "W2_3m"])
    add("--fs", nargs="+", type=float, default=[2.0, 4.0, 8.0], help="between two nonbonded forces")
    add("--friction", nargs="+", type=float, default=[5.0], metavar="1/PS")
    add("--nanoseconds", type=float, default=32.0, help="of a run, over all copies (%(default)s)")
    add("--runs", type=int, default=1, help="runs a point, each with its own seed (%(default)s)")
    add("--record", type=Path, default=TABLE, metavar="CSV", help="%(default)s")
    add("--finished", action="store_true", help="run nothing: means and errors")
    return parser.parse_args()


def main() -> None:
    args = parse()
    rows = read(args.record)
    if not args.finished:
        points = itertools.product(range(1, args.runs + 1), args.integrators, args.fs, args.friction)
        jobs = {}
        for seed, integrator, fs, friction in points:
            point = {"integrator": integrator, "fs": fs, "friction": friction}
            point |= {"nanoseconds": args.nanoseconds, "seed": seed}
            job = ensemble.Job(means_of, **point)
            jobs[job] = {name: f"{value}" for name, value in point.items()}
        known = {tuple(row[name] for name in POINT) for row in rows}
        new = [job for job, row in jobs.items() if tuple(row.values()) not in known]
        for result in ensemble.as_completed(new, OUT, workers=1):
            if result.error is not None:
                raise SystemExit(result.error)
            rows = [*read(args.record), jobs[result.job] | {k: f"{v:.6g}" for k, v in result.value.items()}]
            write(args.record, rows)
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
