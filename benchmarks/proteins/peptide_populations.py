"""Dependence of the dihedral populations of a peptide on the step: alanine dipeptide in implicit solvent.

The force field is amber14 with OBC2, bonds to hydrogen are constrained, and hydrogens have 3 amu. An umbrella
potential, a torsion about psi, lowers the barrier between the helical and the extended conformations. Samples are
reweighted, so that the populations are those of the model without the umbrella potential. Temperatures and the energies
of each type are those with the umbrella potential.

OpenMM's integrators simulate one peptide on the Reference platform. Integrators of this package simulate several copies
in one System on the CPU platform, for which Python takes as long as for one copy. The copies are 12 nm apart and do not
interact, because the cutoff is 2 nm. Errors are from a jackknife over blocks in time of each peptide. Runs that
records/peptide_populations.csv contains are not repeated.

    python benchmarks/proteins/peptide_populations.py --integrators LangevinMiddle --fs 1 2 4 --runs 2
    python benchmarks/proteins/peptide_populations.py --integrators W2_3m BAOA --fs 4 6 8 --runs 2
    python benchmarks/proteins/peptide_populations.py --finished
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator
from functools import cache
from operator import itemgetter
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.proteins import PEPTIDE
from benchmarks.common.records import RECORDS, Record, Row
from benchmarks.common.starts import ONE_THREAD, R, context_of, masses_of, positions_and_velocities
from benchmarks.common.structure import backbone, dihedrals, regions
from benchmarks.proteins.protein_steps import HEAVY, KINDS, OPENMM, TEMPERATURE
from openmm_exactrb import ensemble
from openmm_exactrb.schemes import splitting

OUT = Path("out/peptide_populations")
COPIES, APART = 16, 12.0  # how many, and nm between neighbours
BURN, LOOKED, BLOCKS = 100.0, 0.5, 64  # ps that are not counted, ps between two samples, blocks at least
# The umbrella: the sum over n of -k_n (1 + cos n(psi - 75 degrees)), in kJ/mol.
SUMMIT, UMBRELLA = math.radians(75.0), {1: 3.6, 2: 1.8, 3: 0.6}
REGIONS = ("helical", "left", "extended")
MEASURED = (*REGIONS, "T", *KINDS, "changes")
POINT = ("integrator", "fs", "friction", "nanoseconds", "seed")
FOUND = (*MEASURED, *(f"{name} error" for name in MEASURED))


@cache
def peptides(n: int) -> tuple[app.Topology, openmm.System, np.ndarray]:
    """Return n peptides in implicit solvent under the umbrella, each kind of bonded force in a group of its own."""
    content = app.PDBFile(str(PEPTIDE))
    modeller = app.Modeller(content.topology, content.positions)
    for place in places(n)[1:]:
        modeller.add(content.topology, content.positions + place * unit.nanometer)
    system = app.ForceField("amber14-all.xml", "implicit/obc2.xml").createSystem(
        modeller.topology,
        nonbondedMethod=app.NoCutoff if n == 1 else app.CutoffNonPeriodic,
        nonbondedCutoff=2.0 * unit.nanometer,
        constraints=app.HBonds,
        removeCMMotion=False,
    )
    rb.heavy_hydrogens(system, modeller.topology, HEAVY)
    with_native_solvent(system)
    for force in system.getForces():
        force.setForceGroup(next((g for g, kind in enumerate(KINDS.values(), 1) if isinstance(force, kind)), 0))
    about_psi = openmm.PeriodicTorsionForce()
    for psi in torsions_of(modeller.topology, n)["psi"]:
        for k, height in UMBRELLA.items():
            about_psi.addTorsion(*psi, k, k * SUMMIT, -height)
    system.addForce(about_psi)
    return modeller.topology, system, modeller.positions


def places(n: int) -> np.ndarray:
    """Return where n peptides are (n, 3), in nm: a cube, because the CPU platform has positions in single precision."""
    edge = math.ceil(n ** (1 / 3) - 1e-9)
    return APART * np.array([*itertools.islice(itertools.product(range(edge), repeat=3), n)], dtype=float)


def umbrella(psi: np.ndarray) -> np.ndarray:
    """Return the energies of the umbrella, in kJ/mol, at psi in degrees."""
    return sum(-height * (1.0 + np.cos(k * (np.radians(psi) - SUMMIT))) for k, height in UMBRELLA.items())


def with_native_solvent(system: openmm.System) -> None:
    """Put OpenMM's own force in the place of the custom one that ForceField makes for OBC2, which is much slower."""
    index = next(k for k, force in enumerate(system.getForces()) if isinstance(force, openmm.CustomGBForce))
    custom, native = system.getForce(index), openmm.GBSAOBCForce()
    native.setNonbondedMethod(custom.getNonbondedMethod())
    native.setCutoffDistance(custom.getCutoffDistance())
    for i in range(custom.getNumParticles()):
        charge, radius, scaled = custom.getParticleParameters(i)  # the radius less 0.009 nm, and that scaled
        native.addParticle(charge, radius + 0.009, scaled / radius)
    system.addForce(native)
    system.removeForce(index)


def integrator_of(name: str, interval: float, friction: float) -> openmm.Integrator:
    """Return what evaluates the nonbonded forces every `interval` ps."""
    if name in OPENMM:
        return OPENMM[name](TEMPERATURE, friction, interval)
    return rb.ExactRigidBodyLangevinIntegrator(
        TEMPERATURE, friction, splitting(name).forces * interval, scheme=name, fast="bonded"
    )


def torsions_of(topology: app.Topology, n: int) -> dict[str, np.ndarray]:
    """Return the atoms (n, 4) of phi and psi of n peptides."""
    atoms = topology.getNumAtoms() // n
    return {name: np.array(four) + atoms * np.arange(n)[:, None] for name, four in backbone(topology).items()}


def means_of(integrator: str, fs: float, friction: float, nanoseconds: float, seed: int) -> dict[str, float]:
    """Return means over peptides and time, and their errors."""
    n, platform, properties = (1, "Reference", {}) if integrator in OPENMM else (COPIES, "CPU", ONE_THREAD)
    topology, system, positions = peptides(n)
    mover = integrator_of(integrator, 0.001 * fs, friction)
    mover.setRandomNumberSeed(seed)
    step = mover.getStepSize()._value
    context = context_of(system, mover, positions, platform, properties)
    openmm.LocalEnergyMinimizer.minimize(context, 1.0, 200)
    context.setVelocitiesToTemperature(TEMPERATURE, seed)
    every = max(1, round(LOOKED / step))
    try:
        mover.step(round(BURN / step))
        return sampled(context, every, math.ceil(1000.0 * nanoseconds / (n * every * step)), topology, n)
    except (openmm.OpenMMException, rb.IntegrationError):
        return dict.fromkeys(FOUND, math.nan)


def sampled(context: openmm.Context, every: int, samples: int, topology: app.Topology, n: int) -> dict[str, float]:
    """Return means over so many samples of n peptides, and their errors."""
    system, of = context.getSystem(), torsions_of(topology, n)
    mass = masses_of(system).reshape(n, -1)
    freedom = 3 * mass.shape[1] - system.getNumConstraints() // n
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("psi", *MEASURED) if name != "changes"}
    for _ in range(samples):
        context.getIntegrator().step(every)
        x, v = positions_and_velocities(context.getState(positions=True, velocities=True))
        kinetic = (mass * np.square(v).sum(axis=1).reshape(mass.shape)).sum(axis=1)
        phi, psi = (dihedrals(*x[four.T]) for four in of.values())
        helical, left = regions(phi, psi)
        values = {"helical": helical, "left": left, "extended": ~left & ~helical, "T": kinetic / (freedom * R)}
        for group, kind in enumerate(KINDS, 1):  # of all: their scatter is that in time
            values[kind] = [context.getState(energy=True, groups=1 << group).getPotentialEnergy()._value / n]
        for name, value in (values | {"psi": psi}).items():
            rows[name].append(np.array(value, dtype=float))
    series = {name: np.array(value) for name, value in rows.items()}
    weights, result = np.exp(umbrella(series.pop("psi")) / (R * TEMPERATURE)), {}
    for name, value in series.items():
        mean, error = weighted(value, weights if name in REGIONS else np.ones_like(value))
        result |= {name: mean, f"{name} error": error}
    return result | {"changes": np.abs(np.diff(series["helical"], axis=0)).sum(), "changes error": math.nan}


def weighted(values: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Return the weighted mean of samples (time, peptide), and its error by a jackknife over blocks in time of each."""
    parts = math.ceil(BLOCKS / values.shape[1])
    sums = [[block.sum(axis=0) for block in np.array_split(some, parts)] for some in (weights * values, weights)]
    above, below = (np.ravel(some) for some in sums)
    without = (above.sum() - above) / (below.sum() - below)
    blocks = len(without)
    return float(above.sum() / below.sum()), math.sqrt((blocks - 1) * np.var(without))


def order_of(row: Row) -> tuple:
    return row["integrator"], *(float(row[name]) for name in POINT[1:])


def summary(rows: list[Row]) -> Iterator[str]:
    """Yield the means of each point over its runs, with errors."""
    key = itemgetter(*POINT[:-2])
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
    add("--nanoseconds", type=float, default=32.0, help="of a run, over all peptides (%(default)s)")
    add("--runs", type=int, default=1, help="runs a point, each with its own seed (%(default)s)")
    add("--record", type=Path, default=RECORDS / "peptide_populations.csv", metavar="CSV", help="%(default)s")
    add("--finished", action="store_true", help="run nothing: means and errors")
    return parser.parse_args()


def main() -> None:
    args = parse()
    record = Record(args.record, POINT, FOUND, order=order_of)
    if not args.finished:
        points = itertools.product(range(1, args.runs + 1), args.integrators, args.fs, args.friction)
        jobs = {}
        for seed, integrator, fs, friction in points:
            point = {"integrator": integrator, "fs": fs, "friction": friction}
            point |= {"nanoseconds": args.nanoseconds, "seed": seed}
            if point not in record:
                jobs[ensemble.Job(means_of, **point)] = point
        for result in ensemble.as_completed(list(jobs), OUT, workers=1):
            if result.error is not None:
                raise SystemExit(result.error)
            record.add(jobs[result.job] | {name: f"{result.value[name]:.6g}" for name in FOUND})
    print("\n".join(summary(list(record.rows().values()))))


if __name__ == "__main__":
    main()
