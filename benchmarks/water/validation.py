"""The results of physical_validation for rigid water, and for a peptide with a force evaluation every 8 fs.

physical_validation (P. T. Merz and M. R. Shirts, doi:10.1371/journal.pone.0202764) tests the results of a simulation,
without knowledge of the method:

kinetic energy
    The p-value of a Kolmogorov-Smirnov test for the canonical distribution, and the deviations, in standard errors, of
    the temperatures that follow from the mean and from the width of the distribution of the kinetic energy.
equipartition
    The same for the temperatures of translation and of rotation, computed from positions and velocities of the atoms.
ensemble
    Whether two runs differ as their temperatures (NVT) or pressures (NPT) require, in standard errors. The ratio of
    their distributions of energies or volumes is known exactly, although neither distribution is.
convergence
    At constant energy, whether the fluctuation of the total energy is proportional to the square of the step: the
    largest deviation of a ratio from the expected one, for steps that differ by factors of two.

W2_3m is for alanine dipeptide in water with hydrogens of 3 amu, as in `protein_steps.py`; the others are for water.

A point consists of runs with different seeds. Each run is a file in the folder `--out`, and existing files are not
computed again, so that several commands with different seeds can share the work. At the end, all files of these
settings are tested.

    python benchmarks/water/validation.py --seeds 1 2 3 4 --workers 2 --table benchmarks/records/physical_validation.csv
    python benchmarks/water/validation.py --molecules 64 --length 100  # of the record, and for W2_3m:
    python benchmarks/water/validation.py --integrators W2_3m --interval 8 --seeds 1 2 3 4 --length 100
    python benchmarks/water/validation.py --seeds          # only tests the existing files
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import itertools
import os
import warnings
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common import records
from benchmarks.common.starts import canonical, context_of, masses_of, positions_and_velocities, thermostat
from benchmarks.proteins import protein_steps

MODEL = "tip3p"
BURN, BAROSTAT = 5.0, 0.02  # ps: what is not counted of a run, and the time between two moves of the barostat
#: Apart by about the width of their distributions, where the ratio is known well.
TEMPERATURES, PRESSURES = (298.15, 313.15), (1.0, 800.0)  # K, bar
FRICTION, RELAXATION = 2.0, 0.5  # 1/ps, ps
STEPS = (0.004, 0.002, 0.001)  # ps, of the runs at constant energy
INTEGRATORS = {
    "Langevin": lambda T, interval: rb.ExactRigidBodyLangevinIntegrator(T, FRICTION, forceInterval=interval),
    "Rescaling": lambda T, interval: rb.ExactRigidBodyRescalingIntegrator(T, RELAXATION, forceInterval=interval),
    "NoseHoover": lambda T, interval: rb.ExactRigidBodyNoseHooverIntegrator(T, 1 / RELAXATION, forceInterval=interval),
    "Hybrid": lambda T, interval: rb.ExactRigidBodyHybridIntegrator(T, FRICTION, forceInterval=interval),
    "NVE": lambda _, step: rb.ExactRigidBodyIntegrator(step),
    "W2_3m": lambda T, interval: protein_steps.integrator_of("W2_3m", interval, "5.0", T),
}
OF_WATER = [name for name in INTEGRATORS if name != "W2_3m"]
DRAWS_MOMENTA = "Langevin", "Hybrid"  # the others keep the momentum of the whole, which then belongs to no temperature


class Run(NamedTuple):
    """A run: at constant volume if there is no pressure, at constant energy if the integrator is NVE."""

    integrator: str
    temperature: float  # K
    pressure: float | None  # bar
    interval: float  # ps, between forces
    seed: int
    molecules: int = 125
    length: float = 50.0  # ps
    sampled: float = 0.2  # ps, between two samples

    def file(self, folder: Path) -> Path:
        """Return where its samples are kept."""
        return folder / ("_".join(str(value) for value in self) + ".npz")

    @property
    def title(self) -> str:
        """Its temperature and pressure."""
        return f"{self.temperature:g} K" + ("" if self.pressure is None else f", {self.pressure:g} bar")


def water(run: Run) -> tuple[openmm.System, unit.Quantity]:
    """Return the water of a run, and its positions on a lattice."""
    cutoff = 0.45 * 0.3104 * run.molecules ** (1 / 3)  # of the edge: at 800 bar the box is smaller
    _, system, positions = rb.rigid_water(
        run.molecules,
        model=MODEL,
        nonbondedMethod=app.PME,
        nonbondedCutoff=cutoff,
        switchDistance=0.85 * cutoff,
        ewaldErrorTolerance=1e-5 if run.integrator == "NVE" else 1e-4,
        removeCMMotion=run.integrator not in DRAWS_MOMENTA,
    )
    return system, positions


def system_of(run: Run) -> openmm.System:
    """Return the System of a run: water, or the peptide in water."""
    if run.integrator in OF_WATER:
        return water(run)[0]
    return openmm.XmlSerializer.clone(protein_steps.molecules(None, "all", "HBonds")[1])


@functools.cache
def start_of(run: Run) -> openmm.State:
    """Return water at the temperature of a run that has forgotten its lattice; the peptide starts from its own file."""
    if run.integrator not in OF_WATER:
        return protein_steps.start_of(None)
    system, positions = water(run)
    context = context_of(system, thermostat(run.temperature, run.seed), positions)
    return canonical(context, 5_000, seed=run.seed)[0]


def samples(run: Run) -> dict[str, np.ndarray]:
    """Make a run and return what physical_validation wants of it, by name; the first axis is the sample's."""
    name = "Langevin" if run.integrator in OF_WATER else run.integrator
    start = start_of(Run(name, run.temperature, None, 0.002, run.seed, run.molecules))
    integrator = INTEGRATORS[run.integrator](run.temperature, run.interval)
    integrator.setRandomNumberSeed(run.seed)
    step = integrator.getStepSize()._value
    system = system_of(run)
    if run.pressure is not None:
        barostat = openmm.MonteCarloBarostat(run.pressure, run.temperature, max(1, round(BAROSTAT / step)))
        barostat.setRandomNumberSeed(run.seed)
        system.addForce(barostat)
    context = context_of(system, integrator, start)
    context.applyVelocityConstraints(1e-8)  # otherwise what is not of rigid bodies is taken away without a word
    integrator.step(round(BURN / step))
    every, seen = max(1, round(run.sampled / step)), []
    for _ in range(round(run.length / (every * step))):
        integrator.step(every)
        state = context.getState(energy=True, positions=True, velocities=True)
        x, v = positions_and_velocities(state)
        seen.append(
            {
                "kinetic": state.getKineticEnergy()._value,
                "potential": state.getPotentialEnergy()._value,
                "volume": state.getPeriodicBoxVolume()._value,
                "position": x.astype(np.float32),
                "velocity": v.astype(np.float32),
            }
        )
    found = {name: np.array([one[name] for one in seen]) for name in seen[0]}
    return found | {"freedom": np.array(integrator.degreesOfFreedom())}


def make(run: Run, folder: Path) -> Path:
    """Return the file of a run, which is made if it is not there."""
    file = run.file(folder)
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}.part")
        with part.open("wb") as stream:
            np.savez(stream, **samples(run))
        part.replace(file)
    return file


# -- what physical_validation says -----------------------------------------------------------------------------------


def simulation(run: Run, files: Iterable[Path]) -> Any:
    """Return what physical_validation calls a simulation: the runs of a point, one behind the other."""
    from physical_validation import data

    runs = [dict(np.load(file)) for file in files]
    found = {name: np.concatenate([one[name] for one in runs]) for name in runs[0]}
    system = system_of(run)
    natoms = system.getNumParticles()
    first, constraints = np.transpose([(min(atoms), held) for atoms, held in constraints_by_molecule(system)])
    common = {"natoms": natoms, "temperature": run.temperature}
    if run.integrator == "NVE":
        which = {"ensemble": "NVE", "natoms": natoms, "volume": found["volume"][0]}
    elif run.pressure is None:
        which = {"ensemble": "NVT", "volume": found["volume"][0], **common}
    else:
        which = {"ensemble": "NPT", "pressure": run.pressure, **common}
    return data.SimulationData(
        units=data.UnitData.units("GROMACS"),  # kJ/mol, nm, ps, K and bar are OpenMM's, too
        dt=run.interval,
        ensemble=data.EnsembleData(**which),
        system=data.SystemData(
            natoms=natoms,
            nconstraints=constraints.sum(),
            ndof_reduction_tra=3 * natoms - constraints.sum() - sum(runs[0]["freedom"]),
            ndof_reduction_rot=0,
            mass=masses_of(system),
            molecule_idx=first,
            nconstraints_per_molecule=constraints,
        ),
        observables=data.ObservableData(
            kinetic_energy=found["kinetic"],
            potential_energy=found["potential"],
            total_energy=found["kinetic"] + found["potential"],
            constant_of_motion=found["kinetic"] + found["potential"],
            volume=found["volume"],
        ),
        trajectory=data.TrajectoryData(position=found["position"], velocity=found["velocity"]),
    )


def constraints_by_molecule(system: openmm.System) -> list[tuple[list[int], int]]:
    """Return the atoms of each molecule in order, and how many constraints it has."""
    context = context_of(system, openmm.VerletIntegrator(0.001), platform="Reference")
    held = np.zeros(system.getNumParticles(), int)
    for k in range(system.getNumConstraints()):
        held[system.getConstraintParameters(k)[0]] += 1
    return [(list(atoms), int(held[list(atoms)].sum())) for atoms in sorted(context.getMolecules())]


class Verdict(NamedTuple):
    """What a test says of a point, or of two or more."""

    integrator: str
    point: str
    picoseconds: float
    test: str
    value: float


def verdicts(points: dict[Run, list[Path]]) -> list[Verdict]:
    """Return what all tests say of points; a point is a run with seed 0, and has the files of its seeds."""
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pymbar has no JAX, and tells
        simulations = {run: simulation(run, files) for run, files in points.items()}
        lengths = {run: len(files) * run.length for run, files in points.items()}
        of_one = [verdict for run in points if run.integrator != "NVE" for verdict in alone(run, simulations, lengths)]
        pairs = [pair for pair in itertools.combinations(points, 2) if comparable(*pair)]
        of_two = [compared(*pair, simulations, lengths) for pair in pairs]
        return of_one + of_two + convergence(simulations, lengths)


def alone(run: Run, simulations: dict[Run, Any], lengths: dict[Run, float]) -> Iterable[Verdict]:
    """Yield what is said of the kinetic energies of a point."""
    from physical_validation import kinetic_energy

    data, quiet = simulations[run], {"verbosity": 0, "bootstrap_seed": 1}
    said = functools.partial(Verdict, run.integrator, run.title, lengths[run])
    yield said("kinetic energy, p", float(kinetic_energy.distribution(data, strict=True, **quiet)))
    mean, width = kinetic_energy.distribution(data, **quiet)
    yield said("temperature of the mean", float(mean))
    yield said("temperature of the width", float(width))
    parts = zip(("translation", "rotation"), kinetic_energy.equipartition(data, **quiet)[1:3], strict=True)
    for part, (mean, width) in parts:  # behind those of the whole
        yield said(f"{part}, mean", float(mean))
        yield said(f"{part}, width", float(width))


def comparable(one: Run, other: Run) -> bool:
    """Return whether two points differ in their temperatures at constant volume, or in their pressures, alone."""
    if "NVE" in (one.integrator, other.integrator):
        return False
    if one.pressure is None:
        return one._replace(temperature=other.temperature) == other
    return other.pressure is not None and one._replace(pressure=other.pressure) == other


def compared(one: Run, other: Run, simulations: dict[Run, Any], lengths: dict[Run, float]) -> Verdict:
    """Return by how many standard errors the ratio of two distributions is off."""
    from physical_validation import ensemble
    from physical_validation.util.error import InputError

    try:
        (quantiles,) = ensemble.check(simulations[one], simulations[other], verbosity=0, bootstrap_seed=1)
    except InputError:  # too few samples where the distributions overlap
        quantiles = np.nan
    title, length = f"{one.title} and {other.title}", min(lengths[one], lengths[other])
    return Verdict(one.integrator, title, length, "ensemble", float(quantiles))


def convergence(simulations: dict[Run, Any], lengths: dict[Run, float]) -> list[Verdict]:
    """Return how the fluctuation of the energy falls with the step, if there are runs at constant energy."""
    from physical_validation import integrator

    runs = [run for run in simulations if run.integrator == "NVE"]
    if len(runs) < 2:
        return []
    steps = " ".join(f"{1000 * run.interval:g}" for run in runs)
    deviation = integrator.convergence([simulations[run] for run in runs])
    return [Verdict("NVE", f"steps of {steps} fs", lengths[runs[0]], "convergence", float(deviation))]


# -- the command -----------------------------------------------------------------------------------------------------


def points_of(args: argparse.Namespace) -> list[Run]:
    """Return the points of the settings, with seed 0."""
    more = {"seed": 0, "molecules": args.molecules, "length": args.length}
    states = [(T, None) for T in TEMPERATURES] + [(TEMPERATURES[0], p) for p in PRESSURES]
    canonical = [name for name in args.integrators if name != "NVE"]
    found = [Run(name, *state, args.interval / 1000.0, **more) for name in canonical for state in states]
    if "NVE" in args.integrators:
        found += [Run("NVE", TEMPERATURES[0], None, h, **(more | {"length": 10.0}), sampled=0.02) for h in STEPS]
    return found


def files_of(point: Run, folder: Path) -> list[Path]:
    """Return the files of a point; at constant energy of the first seed, since energies differ from start to start."""
    pattern = "_".join("*" if name == "seed" else str(value) for name, value in point._asdict().items()) + ".npz"
    found = sorted(folder.glob(pattern))
    return found[:1] if point.integrator == "NVE" else found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--integrators", nargs="+", choices=[*INTEGRATORS], default=[*INTEGRATORS])
    add("--seeds", type=int, nargs="*", default=[1])
    add("--molecules", type=int, default=125, help="a cube of a whole number (%(default)s)")
    add("--interval", type=float, default=2.0, metavar="FS", help="between forces (%(default)s)")
    add("--length", type=float, default=50.0, metavar="PS", help="of a run (%(default)s)")
    add("--workers", type=int, default=1)
    add("--out", type=Path, default=Path("out/validation"), metavar="FOLDER")
    add("--table", type=Path, default=None, metavar="FILE", help="of what was found, as CSV")
    args = parser.parse_args()
    points = points_of(args)
    runs = [point._replace(seed=seed) for seed in args.seeds for point in points]
    if any(run.integrator not in OF_WATER for run in runs):
        protein_steps.start_of(None)  # a file, before workers ask for it
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        for file in pool.map(make, runs, itertools.repeat(args.out)):
            print(file, flush=True)
    there = {point: files for point in points if (files := files_of(point, args.out))}
    found = verdicts(there)
    for verdict in found:
        print(f"{verdict.integrator:10} {verdict.point:32} {verdict.picoseconds:6g} ps  {verdict.test:26}", end=" ")
        print(f"{verdict.value:.3f}")
    if args.table is not None:
        rows = (verdict._replace(value=f"{verdict.value:.3g}") for verdict in found)
        records.write(args.table, Verdict._fields, rows)


if __name__ == "__main__":
    main()
