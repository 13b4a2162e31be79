"""A protein in water at long steps: temperatures of groups, energies by type, density and torsions.

The system is alanine dipeptide (amber14) in 212 TIP3P molecules, or a solvated PDB file with --pdb, with PME and a
switch and constrained bonds to hydrogen. Runs use the CPU platform with one thread, or a device. Masses are
unchanged, or hydrogens of the solute, or all hydrogens, have 3 amu. The same temperature estimator is used for all
integrators, and is computed from velocities projected onto the constraints. It gives separate temperatures for the
linear and angular momenta of water molecules, for the solute as a whole, and for the centres and the internal rotation
of its groups X-H, X-H2 and X-H3, which constraints define. "Reported" temperatures are those of the velocities of a
State.

Every point has several runs with different seeds, whose scatter determines the errors. Runs that
records/protein_steps.csv contains are not repeated, so that an interrupted command can be resumed and the record
extended. A run that diverged is recorded as nan.

    python benchmarks/proteins/protein_steps.py --integrators LangevinMiddle --fs 1 2 4 --masses solute --runs 10
    python benchmarks/proteins/protein_steps.py --integrators W2_3m --fs 8 --masses all --runs 10
    python benchmarks/proteins/protein_steps.py --integrators W2_3m --fs 8 --masses all --ensemble NPT
    python benchmarks/proteins/protein_steps.py --integrators W2_3m --fs 8 --masses all --friction 1:10
    python benchmarks/proteins/protein_steps.py --integrators "W2_3m CUDA" --fs 8 --masses all
    python benchmarks/proteins/protein_steps.py --finished
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Iterator, Sequence
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.group_temperatures import Groups
from benchmarks.common.pictures import plt
from benchmarks.common.proteins import FORCE_FIELD, PEPTIDE
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, Record, Row, picture_of
from benchmarks.common.starts import canonical, masses_of, positions_and_velocities, simulation_of, thermostat
from benchmarks.common.structure import (
    CONFORMATIONS,
    EDGES,
    backbone,
    conformations,
    diffusion,
    dihedrals,
    distances,
    peak_of,
)
from openmm_exactrb import ensemble
from openmm_exactrb.schemes import splitting
from openmm_exactrb.support.files import written_whole

OUT = Path("out/protein_steps")
OPENMM = {"LangevinMiddle": openmm.LangevinMiddleIntegrator}
TEMPERATURE, BOX = 300.0, 1.95  # K, nm before the barostat
DALTON = 1.66053906892  # kg/m³ nm³
DENSITY = 993.0  # kg/m³ of the peptide at constant volume: the mean at 1 bar
BURN, LOOKED = 4.0, 0.05  # ps that are not counted, and ps at least between two samples
HEAVY, BAROSTAT = 3.0, 0.02  # amu of heavy hydrogens; ps between two moves of the barostat
#: How createSystem makes the forces.
FORCES = {
    "nonbondedMethod": app.PME,
    "nonbondedCutoff": 0.8 * unit.nanometer,
    "switchDistance": 0.7 * unit.nanometer,
    "ewaldErrorTolerance": 1e-4,
    "removeCMMotion": False,
}
KINDS = {
    "bonds": openmm.HarmonicBondForce,
    "angles": openmm.HarmonicAngleForce,
    "torsions": openmm.PeriodicTorsionForce,
}
TEMPERATURES = ("T_tr", "T_rot", "T_solute", "T_centres", "T_XH", "T_rot reported", "T_solute reported")
MEASURED = (*TEMPERATURES, "U", *KINDS, "density", "peak", "D", *CONFORMATIONS, "ms")
RUN = ("solute", "integrator", "masses", "constraints", "fs", "friction", "ensemble", "picoseconds", "seed")
# Of the picture: points of the peptide at constant volume and 5/ps, with hydrogens of 3 amu, and their temperatures.
SHOWN = {
    ("LangevinMiddle", "HBonds", "2.0"): ("OpenMM, 2 fs", "0.4", "s"),
    ("LangevinMiddle", "AllBonds", "8.0"): ("OpenMM, 8 fs, AllBonds", "#E69F00", "o"),
    ("BAOA", "HBonds", "8.0"): ("BAOA, 8 fs", "#0072B2", "D"),
    ("W2_3m", "HBonds", "8.0"): ("W2_3m, 8 fs", "#56B4E9", "^"),
}
TEMPERATURES = {
    "T_tr": "water,\ntranslation",
    "T_rot reported": "water,\nrotation",
    "T_solute reported": "peptide",
}


def pressed(system: openmm.System, frequency: int, seed: int) -> openmm.System:
    """Return a System with a barostat of 1 bar."""
    system = openmm.XmlSerializer.clone(system)
    barostat = openmm.MonteCarloBarostat(1.0, TEMPERATURE, frequency)
    barostat.setRandomNumberSeed(seed)
    system.addForce(barostat)
    return system


@cache
def molecules(pdb: Path | None, masses: str, constraints: str) -> tuple[app.Topology, openmm.System, unit.Quantity]:
    """Return the solvated solute, with a force group for each kind of bonded force."""
    force_field = app.ForceField(*FORCE_FIELD)
    content = app.PDBFile(str(pdb or PEPTIDE))
    modeller = app.Modeller(content.topology, content.positions)
    if pdb is None:
        modeller.addSolvent(force_field, boxSize=openmm.Vec3(BOX, BOX, BOX) * unit.nanometer)
    system = force_field.createSystem(modeller.topology, constraints=getattr(app, constraints), **FORCES)
    if masses != "plain":
        rb.heavy_hydrogens(system, modeller.topology, HEAVY, water=masses == "all")
    for force in system.getForces():
        force.setForceGroup(next((n for n, kind in enumerate(KINDS.values(), 1) if isinstance(force, kind)), 0))
    return modeller.topology, system, modeller.positions


def equilibrated(
    topology: app.Topology, system: openmm.System, positions: np.ndarray, box: np.ndarray, steps: int
) -> openmm.State:
    """Return the State after so many steps of 2 fs from the nearest minimum; positions and box are in nm."""
    run = simulation_of(topology, system, thermostat(TEMPERATURE))
    run.context.setPeriodicBoxVectors(*box)
    run.context.setPositions(positions)
    return canonical(run.context, steps, iterations=200)[0]


def at_density(state: openmm.State, system: openmm.System, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and box (nm) at a density (kg/m³): molecules move as wholes, as a barostat moves them."""
    x, box = (get(asNumpy=True)._value for get in (state.getPositions, state.getPeriodicBoxVectors))
    mass = masses_of(system)
    scale = (mass.sum() * DALTON / density / np.linalg.det(box)) ** (1 / 3)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001))
    for atoms in map(list, context.getMolecules()):
        x[atoms] += (scale - 1.0) * np.average(x[atoms], axis=0, weights=mass[atoms])
    return x, scale * box


@cache
def start_of(pdb: Path | None) -> openmm.State:
    """Return a start, kept in a file: after 15 ps in its own box, of the peptide at DENSITY after 30 ps at 1 bar."""
    file = OUT / f"start_{'peptide' if pdb is None else pdb.stem}.xml"
    if not file.exists():
        topology, system, positions = molecules(pdb, "plain", "HBonds")
        positions, box = (
            value.value_in_unit(unit.nanometer) for value in (positions, topology.getPeriodicBoxVectors())
        )
        if pdb is None:
            at_pressure = equilibrated(topology, pressed(system, 10, 1), positions, box, 15_000)
            positions, box = at_density(at_pressure, system, DENSITY)
        state = equilibrated(topology, system, positions, box, 7_500)
        file.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(file) as out:
            out.write(openmm.XmlSerializer.serialize(state))
    return openmm.XmlSerializer.deserialize(file.read_text())


def frictions(text: str) -> str:
    """Return the friction (1/ps) of all molecules, or those of water and solute, as the record has them."""
    return ":".join(str(float(part)) for part in text.split(":", 1))


def integrator_of(name: str, interval: float, friction: str, temperature: float = TEMPERATURE) -> openmm.Integrator:
    """Return what evaluates the nonbonded forces every `interval` ps, with the frictions that a record has."""
    scheme = name.partition(" ")[0]
    of_all, *of_solute = map(float, friction.split(":"))
    if scheme in OPENMM:
        if of_solute:
            raise SystemExit(f"{scheme} has one friction for all molecules, not {friction}")
        return OPENMM[scheme](temperature, of_all, interval)
    step, own = splitting(scheme).forces * interval, of_solute[0] if of_solute else None
    return rb.ExactRigidBodyLangevinIntegrator(temperature, of_all, step, scheme=scheme, flexibleFriction=own)


def means_of(
    pdb: Path | None,
    integrator: str,
    masses: str,
    constraints: str,
    fs: float,
    friction: str,
    ensemble: str,
    picoseconds: float,
    seed: int,
) -> dict[str, Any]:
    """Return the means over a run, and where they come from.

    Temperatures are in K, U in kJ/mol per molecule of water, energies by kind in kJ/mol, densities in kg/m³, and ms of
    processor time are those of a nonbonded force.
    """
    topology, system, _ = molecules(pdb, masses, constraints)
    mover = integrator_of(integrator, 0.001 * fs, friction)
    mover.setRandomNumberSeed(seed)
    step = mover.getStepSize()._value
    if ensemble == "NPT":
        system = pressed(system, max(1, round(BAROSTAT / step)), seed)
    run = simulation_of(topology, system, mover, start_of(pdb), device=integrator.partition(" ")[2])
    run.context.applyConstraints(1e-9)
    run.context.setVelocitiesToTemperature(TEMPERATURE, seed)
    try:
        run.step(max(1, round(BURN / step)))
        found = sampled(run, Groups(topology, system), backbone(topology), picoseconds, 0.001 * fs)
    except (openmm.OpenMMException, rb.IntegrationError, np.linalg.LinAlgError):
        found = dict.fromkeys(MEASURED, math.nan)
    return found | of_run(run.context)


def bonded(system: openmm.System, kinds: Sequence[type[openmm.Force]]) -> openmm.System:
    """Return a System of the same particles with some kinds of bonded forces, in groups 1, 2, ..."""
    own = openmm.System()
    for i in range(system.getNumParticles()):
        own.addParticle(system.getParticleMass(i))
    for group, kind in enumerate(kinds, 1):
        for force in system.getForces():
            if isinstance(force, kind):
                copied = openmm.XmlSerializer.clone(force)
                copied.setForceGroup(group)
                own.addForce(copied)
    return own


def looking_at(run: app.Simulation) -> openmm.Context:
    """Return a Context whose bonded forces have a group for each kind, which on a device share one in the run."""
    platform = run.context.getPlatform()
    if platform.getName() == "CPU":
        return run.context
    own = bonded(run.system, [*KINDS.values()])
    return openmm.Context(own, openmm.VerletIntegrator(0.001), platform, {"Precision": "mixed"})


def sampled(
    run: app.Simulation, groups: Groups, torsions: dict[str, list[int]] | None, picoseconds: float, interval: float
) -> dict[str, float]:
    """Return the means over a run from its present state on; NonFiniteError if something is not finite."""
    step = run.integrator.getStepSize()._value
    every = max(1, math.ceil(LOOKED / step - 1e-9))
    n, often = len(groups.water), max(1, round(1.0 / (every * step)))  # samples a look at all of the water
    total = groups.mass.sum() * DALTON
    samples, angles, centres, counts, spent = [], [], [], np.zeros(len(EDGES) - 1), 0.0
    seen = looking_at(run)
    for k in range(max(1, round(picoseconds / (every * step)))):
        begin = time.process_time()
        run.step(every)
        spent += time.process_time() - begin
        state = run.context.getState(positions=True, velocities=True, energy=True)
        x, v = positions_and_velocities(state)
        volume = state.getPeriodicBoxVolume()._value
        sample = groups(x, v) | {"U": state.getPotentialEnergy()._value / n, "density": total / volume}
        if seen is not run.context:
            seen.setPositions(state.getPositions())
        for group, kind in enumerate(KINDS, 1):
            sample[kind] = seen.getState(energy=True, groups=1 << group).getPotentialEnergy()._value
        if not np.isfinite([sample["U"], sample["T_tr"], sample["T_solute"]]).all():
            raise rb.NonFiniteError("a temperature or the energy is not finite")
        samples.append(sample)
        if torsions is not None:
            angles.append((dihedrals(*x[torsions["phi"]]), dihedrals(*x[torsions["psi"]])))
        if k % often == 0:
            centres.append(np.einsum("k,nki->ni", groups.mass[groups.water[0]], x[groups.water]))
            counts += distances(x[groups.water[:, 0]], state.getPeriodicBoxVectors()[0][0]._value)
    means = {name: float(np.mean([sample[name] for sample in samples])) for name in samples[0]}
    of_water = float(groups.mass[groups.water[0]].sum())
    still = len({sample["density"] for sample in samples}) == 1  # a barostat moves what diffuses
    return {
        **means,
        "peak": peak_of(counts, len(centres), n, total / means["density"]),
        "D": diffusion([x / of_water for x in centres], often * every * step) if still else math.nan,
        **conformations(angles),
        "ms": 1000.0 * spent / (len(samples) * every * step / interval),
    }


def record_of(file: Path) -> Record:
    return Record(file, RUN, (*MEASURED, *OF_RUN), order=itemgetter(*RUN))


def summary(rows: dict[tuple[str, ...], Row]) -> Iterator[str]:
    """Yield means and errors of each point, from the scatter of its runs, those that diverged left out."""
    for point, some in itertools.groupby(sorted(rows.values(), key=itemgetter(*RUN)), itemgetter(*RUN[:-1])):
        runs = list(some)
        held = [row for row in runs if math.isfinite(float(row["U"]))]
        yield f"{' '.join(point)} ps, {len(runs)} runs" + (
            f", {len(runs) - len(held)} diverged" if len(held) < len(runs) else ""
        )
        for name in MEASURED:
            values = np.array([float(row[name]) for row in held])
            if len(values) and np.isfinite(values).all():
                error = values.std(ddof=1) / math.sqrt(len(values)) if len(values) > 1 else math.nan
                yield f"    {name:18} {values.mean():10.4f} +- {error:.4f}"


def draw(rows: dict[tuple[str, ...], Row], file: Path) -> None:
    """Draw temperatures as a State has them, and the energy of a molecule of water."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 3.8), layout="constrained", width_ratios=(2.6, 1.0))
    of_peptide = {"solute": "peptide", "masses": "all", "friction": "5.0", "ensemble": "NVT"}
    places = np.arange(len(TEMPERATURES))
    for k, ((integrator, constraints, fs), (label, colour, marker)) in enumerate(SHOWN.items()):
        point = of_peptide | {"integrator": integrator, "constraints": constraints, "fs": fs}
        runs = [row for row in rows.values() if all(row[name] == value for name, value in point.items())]
        runs = [row for row in runs if math.isfinite(float(row["U"]))]
        if len(runs) < 2:
            continue
        style = {"fmt": marker, "color": colour, "capsize": 3, "ms": 7}
        values = np.array([[float(row[name]) for name in (*TEMPERATURES, "U")] for row in runs])
        means, errors = values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(len(runs))
        left.errorbar(places + 0.16 * (k - 1.5), means[:-1], errors[:-1], label=label, **style)
        right.errorbar([k], means[-1:], errors[-1:], **style)
    left.axhline(TEMPERATURE, color="0.5", lw=1, zorder=0)
    left.set_xticks(places, TEMPERATURES.values())
    left.set_ylabel("temperature as reported (K)")
    left.legend(frameon=False, loc="upper left")
    right.set_xlim(-1, len(SHOWN))
    right.set_xticks([])
    right.set_ylabel("potential energy (kJ/mol per water)")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=150)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--pdb", type=Path, help="a solvated protein, instead of alanine dipeptide")
    which = 'LangevinMiddle, or splittings; "W2_3m CUDA" runs on that platform'
    add("--integrators", nargs="+", default=["LangevinMiddle", "W2_3m"], help=which)
    add("--masses", nargs="+", choices=["plain", "solute", "all"], default=["all"], help="whose hydrogens have 3 amu")
    add("--constraints", choices=["HBonds", "AllBonds"], default="HBonds", help="%(default)s")
    add("--fs", nargs="+", type=float, default=[2.0, 4.0, 6.0, 8.0, 10.0], help="between two nonbonded forces")
    of_two = "of all molecules, or those of water and solute (%(default)s)"
    add("--friction", nargs="+", type=frictions, default=["5.0"], metavar="1/PS[:1/PS]", help=of_two)
    add("--ensemble", choices=["NVT", "NPT"], default="NVT", help="NPT at 1 bar (%(default)s)")
    add("--runs", type=int, default=10, help="runs a point, each with its own seed (%(default)s)")
    add("--picoseconds", type=float, default=100.0, help="length of a run (%(default)s)")
    add("--workers", type=int, default=1, help="processes (%(default)s)")
    add("--record", type=Path, default=RECORDS / "protein_steps.csv", metavar="CSV", help="%(default)s")
    add("--finished", action="store_true", help="run nothing: means, errors and a picture")
    return parser.parse_args()


def main() -> None:
    args = parse()
    record = record_of(args.record)
    if args.finished:
        print("\n".join(summary(record.rows())))
        draw(record.rows(), picture_of(args.record))
        return
    axes = itertools.product(range(1, args.runs + 1), args.integrators, args.masses, args.fs, args.friction)
    jobs = {}
    for seed, integrator, masses, fs, friction in axes:
        point = {"integrator": integrator, "masses": masses, "constraints": args.constraints, "fs": fs}
        point |= {"friction": friction, "ensemble": args.ensemble, "picoseconds": args.picoseconds, "seed": seed}
        job = ensemble.Job(means_of, pdb=args.pdb, **point)
        jobs[job] = {"solute": "peptide" if args.pdb is None else args.pdb.stem} | point
    start_of(args.pdb)  # before workers ask for it
    known = record.rows()
    new = [job for job, row in jobs.items() if record.key_of(row) not in known]
    for result in ensemble.as_completed(new, OUT, workers=args.workers):
        if result.error is not None:
            raise SystemExit(result.error)
        record.add(jobs[result.job] | result.value | {name: f"{result.value[name]:.7g}" for name in MEASURED})
    wanted = {record.key_of(row)[:-1] for row in jobs.values()}
    print("\n".join(summary({key: row for key, row in record.rows().items() if key[:-1] in wanted})))


if __name__ == "__main__":
    main()
