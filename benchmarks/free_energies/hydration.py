"""Does a long step change a hydration free energy? Methane in 216 TIP3P, in windows whose interactions fade.

The charges of methane are switched off first, then its Lennard-Jones interactions with water, which are soft. Methane
has no interactions within itself except for bonds and angles, so that the free energy of the windows, by MBAR, is the
hydration free energy, at 298.15 K and 1 bar. Its parameters are those of FreeSolv (examples/data/methane.xml), which
has 2.45(1) kcal/mol with TIP3P, a switch from 0.9 to 1.0 nm, and 2 fs (doi:10.1021/acs.jced.7b00104).

Each window has noise of its own, and begins at the same equilibrated box of its seed. Windows are made in turns of all
kinds, so that these can be compared at any time. Each finished window is a file of energies and a row of windows.csv in
the folder: after an interruption, even by SIGKILL, the same command continues with the first window that is missing. A
window that fails begins anew with other noise, and counts as a failure. Tables need pymbar.

    python benchmarks/free_energies/hydration.py out/hydration --seeds 1 2 3
    python benchmarks/free_energies/hydration.py out/hydration --table
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, ROOT, Record, write
from benchmarks.common.starts import R, masses_of, simulation_of
from benchmarks.free_energies.tables import hydration
from openmm_exactrb.support.files import written_whole

MOLECULES, SOLUTE = 216, range(5)  # of water; the atoms of methane
KELVIN, BAR, FRICTION = 298.15, 1.0, 1.0  # friction per ps
CUTOFF, SWITCH = 0.85, 0.75  # nm
BAROSTAT, SAMPLED = 0.2, 0.4  # ps between two changes of the volume, and between two samples
EQUILIBRATION, BURN = 100.0, 20.0  # ps of the start of a seed, and of each window
KCAL = 4.184  # kJ
#: Parameters of the Context by window: methane in water first, without interactions last.
WINDOWS = [{"charges": charges, "sterics": 1.0} for charges in (1.0, 0.5, 0.0)]
WINDOWS += [{"charges": 0.0, "sterics": sterics} for sterics in (0.85, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)]
ATTEMPTS = 5


class Kind(NamedTuple):
    """An integrator, the fs of a step, which hydrogens have 3 amu, and the constraints."""

    integrator: str
    fs: float
    masses: str
    constraints: str


KINDS = {
    "2fs": Kind("LangevinMiddle", 2.0, "plain", "HBonds"),
    "4fs": Kind("LangevinMiddle", 4.0, "solute", "HBonds"),
    "8fs AllBonds": Kind("LangevinMiddle", 8.0, "all", "AllBonds"),
    "BAOA 8fs": Kind("BAOA", 8.0, "all", "HBonds"),
}
SUMMED = "failures", "simulated", "forces", "seconds"
RECORDED = ("picoseconds", "samples", *SUMMED, "density", *OF_RUN)
RESULTS = ("kind", "seed", "windows", "picoseconds", "value", "error", "overlap", *SUMMED, "density", *OF_RUN)


@cache
def methane_in_water() -> tuple[app.Topology, unit.Quantity, app.ForceField]:
    """Return methane in a box of water, and the force field."""
    data = ROOT / "examples" / "data"
    pdb = app.PDBFile(str(data / "methane.pdb"))
    force_field = app.ForceField(str(data / "methane.xml"), "amber14/tip3p.xml")
    modeller = app.Modeller(pdb.topology, pdb.positions)
    modeller.addSolvent(force_field, numAdded=MOLECULES)
    return modeller.topology, modeller.positions, force_field


def system_of(kind: Kind, alchemical: bool = True) -> openmm.System:
    """Return the System of a kind, with a barostat; forces that fade are alone in groups 1 (charges) and 2."""
    topology, _, force_field = methane_in_water()
    system = force_field.createSystem(
        topology,
        nonbondedMethod=app.PME,
        nonbondedCutoff=CUTOFF,
        switchDistance=SWITCH,
        constraints=getattr(app, kind.constraints),
        removeCMMotion=False,
    )
    if kind.masses != "plain":
        rb.heavy_hydrogens(system, topology, water=kind.masses == "all")
    if alchemical:
        fade(system)
    system.addForce(openmm.MonteCarloBarostat(BAR, KELVIN, round(1000.0 * BAROSTAT / kind.fs)))
    return system


def fade(system: openmm.System) -> None:
    """Let parameters of the Context scale the charges of methane and its Lennard-Jones interactions with water."""
    (coulomb,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    soft = openmm.CustomNonbondedForce(
        "4*sterics*sqrt(epsilon1*epsilon2)*x*(x-1); x=1/((r/sigma)^6+0.5*(1-sterics)); sigma=(sigma1+sigma2)/2"
    )
    soft.addGlobalParameter("sterics", 1.0)
    for name in ("sigma", "epsilon"):
        soft.addPerParticleParameter(name)
    soft.setNonbondedMethod(soft.CutoffPeriodic)
    soft.setCutoffDistance(CUTOFF)
    soft.setUseSwitchingFunction(True)
    soft.setSwitchingDistance(SWITCH)
    soft.setUseLongRangeCorrection(True)
    soft.addInteractionGroup(SOLUTE, range(len(SOLUTE), system.getNumParticles()))
    coulomb.addGlobalParameter("charges", 1.0)
    for i in range(system.getNumParticles()):
        charge, sigma, epsilon = coulomb.getParticleParameters(i)
        soft.addParticle([sigma, epsilon])
        if i in SOLUTE:
            coulomb.setParticleParameters(i, 0.0, sigma, 0.0)
            coulomb.addParticleParameterOffset("charges", i, charge, 0.0, 0.0)
    for k in range(coulomb.getNumExceptions()):
        soft.addExclusion(*coulomb.getExceptionParameters(k)[:2])
    coulomb.setForceGroup(1)
    soft.setForceGroup(2)
    system.addForce(soft)


def integrator_of(kind: Kind, seed: int) -> openmm.Integrator:
    """Return the integrator of a kind."""
    if kind.integrator == "LangevinMiddle":
        integrator = openmm.LangevinMiddleIntegrator(KELVIN, FRICTION, 0.001 * kind.fs)
    else:
        integrator = rb.ExactRigidBodyLangevinIntegrator(KELVIN, FRICTION, 0.001 * kind.fs, scheme=kind.integrator)
    integrator.setRandomNumberSeed(seed)
    return integrator


def started(kind: Kind, start: openmm.State | None, window: dict[str, float], seed: int) -> app.Simulation:
    """Return a Simulation of a kind at a start; its noise, velocities and volumes follow from the seed."""
    topology, system = methane_in_water()[0], system_of(kind)
    system.getForce(system.getNumForces() - 1).setRandomNumberSeed(seed)
    simulation = simulation_of(topology, system, integrator_of(kind, seed), start)
    for name, value in window.items():
        simulation.context.setParameter(name, value)
    if start is not None:
        simulation.context.applyConstraints(1e-9)
        simulation.context.setVelocitiesToTemperature(KELVIN, seed)
    return simulation


def start_of(folder: Path, seed: int) -> openmm.State:
    """Return the equilibrated box of a seed, from a file if there is one."""
    file = folder / f"start_{seed}.xml"
    if not file.exists():
        simulation = started(KINDS["2fs"], None, WINDOWS[0], seed)
        simulation.context.setPositions(methane_in_water()[1])
        simulation.minimizeEnergy(maxIterations=200)
        simulation.context.setVelocitiesToTemperature(KELVIN, seed)
        simulation.step(round(1000.0 * EQUILIBRATION / 2.0))
        with written_whole(file) as out:
            out.write(openmm.XmlSerializer.serialize(simulation.context.getState(positions=True, velocities=True)))
    return openmm.XmlSerializer.deserialize(file.read_text(encoding="utf-8"))


class Energies:
    """Reduced energies (kT) of positions in all windows, up to a constant, from a Context of their own."""

    def __init__(self, kind: Kind) -> None:
        system = system_of(kind)
        system.removeForce(system.getNumForces() - 1)  # the barostat
        self._context = simulation_of(methane_in_water()[0], system, openmm.VerletIntegrator(0.001)).context

    def __call__(self, state: openmm.State) -> list[float]:
        """Return those of a State."""
        self._context.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
        self._context.setPositions(state.getPositions())
        parts = {
            (name, value): self._energy(name, value, group)
            for group, name in enumerate(WINDOWS[0], 1)
            for value in dict.fromkeys(window[name] for window in WINDOWS)
        }
        return [sum(parts[part] for part in window.items()) / (R * KELVIN) for window in WINDOWS]

    def _energy(self, name: str, value: float, group: int) -> float:
        self._context.setParameter(name, value)
        return self._context.getState(energy=True, groups=1 << group).getPotentialEnergy()._value


def sampled(simulation: app.Simulation, kind: Kind, ps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the reduced energies (samples, windows) and volumes (nm^3) of a run; NonFiniteError if one is not."""
    energies, reduced, volumes = Energies(kind), [], []
    simulation.step(round(1000.0 * BURN / kind.fs))
    for _ in range(round(ps / SAMPLED)):
        simulation.step(round(1000.0 * SAMPLED / kind.fs))
        state = simulation.context.getState(positions=True, energy=True)
        found = [*energies(state), state.getPotentialEnergy()._value]
        if not np.isfinite(found).all():
            raise rb.NonFiniteError("an energy is not finite")
        reduced.append(found[:-1])
        volumes.append(state.getPeriodicBoxVolume()._value)
    return np.array(reduced), np.array(volumes)


def noise(name: str, seed: int, window: int, attempt: int) -> int:
    """Return the seed of one run."""
    return 1 + ((seed * 100 + [*KINDS].index(name)) * 100 + window) * 10 + attempt


def made(folder: Path, name: str, seed: int, window: int, ps: float) -> dict[str, Any]:
    """Make a window: write its energies, and return its row."""
    kind, start = KINDS[name], start_of(folder, seed)
    begin, failures, simulated, forces = time.process_time(), 0, 0.0, 0
    reduced, volumes = np.empty((0, len(WINDOWS))), np.array([math.nan])
    while not len(reduced) and failures < ATTEMPTS:
        simulation = started(kind, start, WINDOWS[window], noise(name, seed, window, failures))
        try:
            reduced, volumes = sampled(simulation, kind, ps)
        except (openmm.OpenMMException, rb.IntegrationError):
            failures += 1
        simulated += 0.001 * kind.fs * simulation.currentStep
        forces += forces_of(simulation)
    with written_whole(file_of(folder, name, seed, window), "wb") as out:
        np.savez(out, reduced=reduced, volumes=volumes)
    density = masses_of(simulation.system).sum() / (0.602214076 * volumes.mean())  # kg/m^3
    return {
        **{"kind": name, "seed": seed, "window": window, "picoseconds": ps, "samples": len(reduced)},
        **{"failures": failures, "simulated": f"{simulated:.6g}", "forces": forces, "density": f"{density:.6g}"},
        "seconds": f"{time.process_time() - begin:.5g}",
        **of_run(simulation.context),
    }


def forces_of(simulation: app.Simulation) -> int:
    """Return how often a run has evaluated the forces for its steps."""
    integrator = simulation.integrator
    return integrator.timings.evaluations if hasattr(integrator, "timings") else simulation.currentStep


def file_of(folder: Path, name: str, seed: int, window: int) -> Path:
    """Return the file of the energies of a window."""
    return folder / f"{name.replace(' ', '_')}_{seed}_{window}.npz"


def record_of(folder: Path) -> Record:
    """Return the record of the windows that are finished."""
    return Record(folder / "windows.csv", ("kind", "seed", "window"), RECORDED)


def missing(record: Record, kinds: list[str], seeds: list[int], windows: list[int]) -> Iterator[tuple[int, int, str]]:
    """Yield seed, window and kind of the windows to make: those of all kinds in turns."""
    for seed, window, kind in itertools.product(seeds, windows, kinds):
        if {"kind": kind, "seed": seed, "window": window} not in record:
            yield seed, window, kind


# -- analysis --------------------------------------------------------------------------------------------------------


class Found(NamedTuple):
    """A free energy of hydration with its error (kcal/mol), and the smallest overlap of two neighbours."""

    value: float
    error: float
    overlap: float


def free_energy(reduced: list[np.ndarray]) -> Found:
    """Return what MBAR finds from the reduced energies (samples, windows) of the samples of each window."""
    from pymbar import MBAR, timeseries

    last, independent = len(reduced) - 1, []
    for k, energies in enumerate(reduced):
        work = energies[:, k + 1] - energies[:, k] if k < last else energies[:, k] - energies[:, k - 1]
        independent.append(energies[timeseries.subsample_correlated_data(work)])
    mbar = MBAR(np.concatenate(independent).T, [len(energies) for energies in independent])
    differences, overlap = mbar.compute_free_energy_differences(), mbar.compute_overlap()["matrix"]
    unit_of_energy = R * KELVIN / KCAL
    return Found(
        unit_of_energy * differences["Delta_f"][last, 0],
        unit_of_energy * differences["dDelta_f"][last, 0],
        min(overlap[k, k + 1] for k in range(last)),
    )


def windows_of(folder: Path, name: str, seed: int) -> list[np.ndarray]:
    """Return the reduced energies of the windows of a run."""
    files = [file_of(folder, name, seed, window) for window in range(len(WINDOWS))]
    return [np.load(file)["reduced"] for file in files]


def results(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield a row for each kind and seed all windows of which were made, of nan if one of them has no samples."""
    rows = record_of(folder).rows()
    for kind, seed in dict.fromkeys((kind, seed) for kind, seed, _ in rows):
        some = [rows.get((kind, seed, f"{window}")) for window in range(len(WINDOWS))]
        if all(some):
            failed = any(int(row["samples"]) < 2 for row in some)
            found = Found(*[math.nan] * 3) if failed else free_energy(windows_of(folder, kind, int(seed)))
            sums = {name: sum(float(row[name]) for row in some) for name in SUMMED}
            yield {
                **{"kind": kind, "seed": seed, "windows": len(WINDOWS), "picoseconds": some[0]["picoseconds"]},
                **{name: f"{value:.5g}" for name, value in found._asdict().items()},
                **{name: f"{value:.10g}" for name, value in sums.items()},
                "density": f"{np.mean([float(row['density']) for row in some]):.6g}",
                **{name: " ".join(dict.fromkeys(row[name] for row in some)) for name in OF_RUN},
            }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("folder", type=Path, help="of starts, energies and windows.csv")
    add("--kinds", nargs="+", choices=KINDS, default=[*KINDS], help="%(default)s")
    add("--seeds", nargs="+", type=int, default=[0], help="%(default)s")
    add("--windows", nargs="+", type=int, choices=range(len(WINDOWS)), default=[*range(len(WINDOWS))], metavar="N")
    add("--picoseconds", type=float, default=200.0, help="of a window, after its equilibration (%(default)s)")
    add("--record", type=Path, default=RECORDS / "hydration.csv", metavar="CSV", help="of --table (%(default)s)")
    add("--table", action="store_true", help="write and print the free energies of finished seeds, and make nothing")
    args = parser.parse_args()
    if args.table:
        write(args.record, RESULTS, results(args.folder))
        print(hydration(args.record))
        return
    args.folder.mkdir(parents=True, exist_ok=True)
    record = record_of(args.folder)
    for seed, window, kind in missing(record, args.kinds, args.seeds, args.windows):
        record.add(made(args.folder, kind, seed, window, args.picoseconds))


if __name__ == "__main__":
    main()
