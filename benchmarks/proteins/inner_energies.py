"""Errors of inner steps: energies of bonds, angles and torsions, and the energy drift, for several inner splittings.

`peptide` is alanine dipeptide, many copies in one System that do not interact, because they are 12 nm apart and the
cutoff is 2 nm; with --pdb, the solute is the protein of that file. Both are in vacuum, where they move as fast as in
water, so that the means of bonded energies are precise. `water` is the peptide in water. All hydrogens have 3 amu. Each
run differs from a run with many inner steps only in its inner steps, so that the difference of their means is the error
of the inner steps. An inner splitting is named, or "b=0.197" for a kick of b, a half drift, a kick of 1 - 2b, a half
drift and a kick of b, whose error in the frequency is smallest near the b of S2_2.

With a friction of 0, the energy is conserved, and `drift` is its slope in kJ/mol/ps. Runs use the CPU platform with one
thread. Runs that the record contains are not repeated, so that an interrupted command can be resumed.

    python benchmarks/proteins/inner_energies.py peptide --inner S2_2:12 S2_2:4 S2_2:2 b=0.198:2 :
    python benchmarks/proteins/inner_energies.py --pdb villin.pdb --inner S2_2:12 :
    python benchmarks/proteins/inner_energies.py peptide --integrator W2_3m --inner S2_2:40 :
    python benchmarks/proteins/inner_energies.py water --friction 0 --picoseconds 200
    python benchmarks/proteins/inner_energies.py --finished
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Iterable, Iterator
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.proteins import FORCE_FIELD, PEPTIDE
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, Record, Row
from benchmarks.common.starts import R, masses_of, simulation_of
from benchmarks.proteins import protein_steps
from benchmarks.proteins.peptide_populations import places
from benchmarks.proteins.protein_steps import HEAVY, KINDS, TEMPERATURE
from openmm_exactrb import ensemble
from openmm_exactrb.schemes import Scheme, splitting
from openmm_exactrb.schemes.scheme import symmetric

OUT = Path("out/inner_energies")
COPIES = 27
BURN, LOOKED = 10.0, 0.04  # ps that are not counted, ps between two samples
MEASURED = (*KINDS, "T", "drift", "ms")
RUN = ("solute", "constraints", "integrator", "fs", "friction", "inner", "picoseconds", "seed")


@cache
def molecules(solute: str, constraints: str) -> tuple[app.Topology, openmm.System, Any]:
    """Return a solute with a force group for each kind of bonded force, and its start: positions or a State."""
    if solute == "water":
        topology, system, _ = protein_steps.molecules(None, "all", constraints)
        return topology, system, protein_steps.start_of(None)
    file = PEPTIDE if solute == "peptide" else Path(solute)
    content = app.PDBFile(str(file))
    modeller = app.Modeller(content.topology, content.positions)
    modeller.delete([residue for residue in content.topology.residues() if residue.name in ("HOH", "NA", "CL")])
    one = modeller.topology, modeller.positions
    if solute == "peptide":
        for place in places(COPIES)[1:]:
            modeller.add(one[0], one[1] + place * unit.nanometer)
    system = app.ForceField(*FORCE_FIELD).createSystem(
        modeller.topology,
        constraints=getattr(app, constraints),
        nonbondedMethod=app.CutoffNonPeriodic if solute == "peptide" else app.NoCutoff,
        nonbondedCutoff=2.0 * unit.nanometer,
        removeCMMotion=False,
    )
    rb.heavy_hydrogens(system, modeller.topology, HEAVY)
    for force in system.getForces():
        force.setForceGroup(next((n for n, kind in enumerate(KINDS.values(), 1) if isinstance(force, kind)), 0))
    return modeller.topology, system, modeller.positions


def inner_of(name: str) -> Scheme:
    """Return an inner splitting."""
    if name.startswith("b="):
        return symmetric(name, order=2, stages=2, first="kick", b=(float(name.removeprefix("b=")),))
    return splitting(name)


def means_of(
    solute: str,
    constraints: str,
    integrator: str,
    fs: float,
    friction: float,
    inner: str,
    picoseconds: float,
    seed: int,
) -> dict[str, Any]:
    """Return the means over a run, and where they come from.

    Energies are in kJ/mol, the temperature in K, the drift in kJ/mol/ps, and ms of processor time are those of a
    nonbonded force. `inner` is a splitting and, after a colon, the number of inner steps in a step; ":" is the default.
    """
    topology, system, start = molecules(solute, constraints)
    outer, (name, steps) = splitting(integrator), inner.split(":")
    step = 0.001 * fs * outer.forces
    each = {"inner": inner_of(name), "innerSteps": int(steps)} if steps else {}
    mover = rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, friction or 5.0, step, scheme=integrator, **each)
    mover.setRandomNumberSeed(seed)
    run = simulation_of(topology, system, mover, start if isinstance(start, openmm.State) else None)
    if not isinstance(start, openmm.State):
        run.context.setPositions(start)
        run.minimizeEnergy()
    run.context.applyConstraints(1e-9)
    run.context.setVelocitiesToTemperature(TEMPERATURE, seed)
    run.step(round(BURN / step))
    mover.setFriction(friction)
    found = sampled(run, system, picoseconds, 0.001 * fs, friction == 0.0)
    return found | of_run(run.context)


def sampled(
    run: app.Simulation, system: openmm.System, picoseconds: float, interval: float, conserves: bool
) -> dict[str, float]:
    """Return the means over a run from its present state on."""
    step, mass = run.integrator.getStepSize()._value, masses_of(system)
    freedom = 3 * np.count_nonzero(mass) - system.getNumConstraints()
    every, samples, spent = max(1, round(LOOKED / step)), [], 0.0
    for _ in range(round(picoseconds / (every * step))):
        begin = time.process_time()
        run.step(every)
        spent += time.process_time() - begin
        state = run.context.getState(velocities=True, energy=conserves)
        v = state.getVelocities(asNumpy=True)._value
        sample = {"T": float(mass @ (v * v).sum(axis=1)) / (freedom * R)}
        for group, kind in enumerate(KINDS, 1):
            sample[kind] = run.context.getState(energy=True, groups=1 << group).getPotentialEnergy()._value
        if conserves:
            sample["total"] = (state.getPotentialEnergy() + state.getKineticEnergy())._value
        samples.append(sample)
    means = {name: float(np.mean([sample[name] for sample in samples])) for name in ("T", *KINDS)}
    if not all(map(math.isfinite, means.values())):
        raise rb.NonFiniteError("an energy is not finite")
    times = every * step * np.arange(len(samples))
    drift = float(np.polyfit(times, [sample["total"] for sample in samples], 1)[0]) if conserves else math.nan
    return {**means, "drift": drift, "ms": 1000.0 * spent / (len(samples) * every * step / interval)}


def summary(rows: Iterable[Row]) -> Iterator[str]:
    """Yield the deviations of each point from that with the most inner steps, and the energy drifts."""
    for point, name, runs, changes in deviations(rows):
        found = "  ".join(f"{kind} {change:+.2f} +- {error:.2f} %" for kind, (change, error) in changes.items())
        drift, its_error = mean_of(runs, "drift")
        yield f"{' '.join(point)} {name}, {len(runs)} runs: {found}  drift {drift:.4f} +- {its_error:.4f}"


def deviations(
    rows: Iterable[Row],
) -> Iterator[tuple[tuple[str, ...], str, list[Row], dict[str, tuple[float, float]]]]:
    """Yield point, inner splitting, runs, and deviations of means in % from the most inner steps, with errors."""
    for point, some in itertools.groupby(sorted(rows, key=itemgetter(*RUN)), itemgetter(*RUN[:5])):
        by_inner = {name: [*runs] for name, runs in itertools.groupby(some, itemgetter("inner"))}
        most = by_inner[max(by_inner, key=lambda name: int(name.split(":")[1] or 0))]
        for name, runs in by_inner.items():
            if runs is most and len(by_inner) > 1:
                continue
            changes = {}
            for kind in (*KINDS, "T"):
                (mean, error), (true, its_error) = mean_of(runs, kind), mean_of(most, kind)
                changes[kind] = 100.0 * (mean / true - 1.0), 100.0 * math.hypot(error, its_error) / true
            yield point, name, runs, changes


def mean_of(rows: list[Row], name: str) -> tuple[float, float]:
    """Return the mean over runs and its error from their scatter."""
    values = np.array([float(row[name]) for row in rows])
    return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("solutes", nargs="*", choices=["peptide", "water", []], help="solutes that are built here")
    add("--pdb", nargs="*", default=[], help="proteins, whose water is left out")
    add("--constraints", default="HBonds", choices=["HBonds", "HAngles"], help="%(default)s")
    add("--integrator", default="BAOA", help="(%(default)s)")
    add("--fs", type=float, default=8.0, help="between two nonbonded forces (%(default)s)")
    add("--friction", type=float, default=5.0, help="1/ps; 0 for the energy drift (%(default)s)")
    add(
        "--inner",
        nargs="+",
        default=["S2_2:12", ":"],
        help='splitting and inner steps in a step; ":" is the default',
    )
    add("--runs", type=int, default=8, help="runs a point, each with its own seed (%(default)s)")
    add("--picoseconds", type=float, default=100.0, help="length of a run (%(default)s)")
    add("--workers", type=int, default=1, help="processes (%(default)s)")
    add("--record", type=Path, default=RECORDS / "inner_energies.csv", metavar="CSV", help="%(default)s")
    add("--finished", action="store_true", help="run nothing: means and errors")
    return parser.parse_args()


def main() -> None:
    args = parse()
    record = Record(args.record, RUN, (*MEASURED, *OF_RUN), order=itemgetter(*RUN))
    jobs = {}
    for seed, solute, inner in itertools.product(range(1, args.runs + 1), [*args.solutes, *args.pdb], args.inner):
        point = {"constraints": args.constraints, "integrator": args.integrator, "fs": args.fs}
        point |= {"friction": args.friction, "inner": inner, "picoseconds": args.picoseconds, "seed": seed}
        jobs[ensemble.Job(means_of, solute=solute, **point)] = {"solute": Path(solute).stem} | point
    known = record.rows()
    new = [job for job, row in jobs.items() if record.key_of(row) not in known]
    for result in ensemble.as_completed([] if args.finished else new, OUT, workers=args.workers):
        if result.error is not None:
            raise SystemExit(result.error)
        record.add(jobs[result.job] | result.value | {name: f"{result.value[name]:.7g}" for name in MEASURED})
    print("\n".join(summary(record.rows().values())))


if __name__ == "__main__":
    main()
