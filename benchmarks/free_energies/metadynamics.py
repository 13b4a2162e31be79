"""Does a long step change a free energy profile? Metadynamics of alanine dipeptide, at equal numbers of forces.

OpenMM's `app.Metadynamics` (well-tempered) biases phi and psi of alanine dipeptide, in amber14 with the implicit
solvent OBC2, at 300 K with bonds to hydrogen constrained. All runs evaluate the forces equally often, so that a run
with a longer step is longer. The free energy of each run is the mean of the estimates at ten times in its second half.
Profiles of phi and of psi follow by integration over the other angle, each relative to its mean over the angles at
which the profile of the reference is below 15 kJ/mol.

Each finished run is a file in the folder, and runs that are there are not made again. The record has the profiles of
all runs.

    python benchmarks/free_energies/metadynamics.py out/metadynamics --seeds 1 2 3
    python benchmarks/free_energies/metadynamics.py out/metadynamics --table
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.proteins import PEPTIDE
from benchmarks.common.records import RECORDS, write
from benchmarks.common.starts import R
from benchmarks.common.structure import backbone
from benchmarks.free_energies.tables import ANGLES, metadynamics
from benchmarks.proteins.peptide_populations import integrator_of, with_native_solvent
from benchmarks.proteins.protein_steps import TEMPERATURE
from openmm_exactrb.support.files import written_whole

KELVIN, FRICTION = TEMPERATURE, 5.0
WIDTH, HEIGHT, FACTOR, EVERY = 0.35, 1.0, 8.0, 0.96  # of a Gaussian: rad, kJ/mol; bias factor; ps between two
ESTIMATES = 10  # of the free energy, in the second half of a run
BINS = 24  # of a profile


class Kind(NamedTuple):
    """An integrator, and the fs between two forces."""

    integrator: str
    fs: float


#: The reference first, which is four times as long as its equal in cost.
KINDS = {
    "LangevinMiddle 2 fs, four times the forces": Kind("LangevinMiddle", 2.0),
    "LangevinMiddle 2 fs": Kind("LangevinMiddle", 2.0),
    "LangevinMiddle 4 fs": Kind("LangevinMiddle", 4.0),
    "BAOA 8 fs": Kind("BAOA", 8.0),
}
REFERENCE = next(iter(KINDS))


def system_of() -> tuple[app.Topology, openmm.System, unit.Quantity]:
    """Return the peptide in implicit solvent, all hydrogens of 3 amu."""
    content = app.PDBFile(str(PEPTIDE))
    system = app.ForceField("amber14-all.xml", "implicit/obc2.xml").createSystem(
        content.topology, nonbondedMethod=app.NoCutoff, constraints=app.HBonds, removeCMMotion=False
    )
    rb.heavy_hydrogens(system, content.topology)
    with_native_solvent(system)
    return content.topology, system, content.positions


def variable(atoms: tuple[int, ...]) -> app.BiasVariable:
    """Return a torsion as a variable."""
    angle = openmm.CustomTorsionForce("theta")
    angle.addTorsion(*atoms, [])
    return app.BiasVariable(angle, -math.pi, math.pi, WIDTH, periodic=True)


def free_energy(kind: Kind, seed: int, forces: int) -> np.ndarray:
    """Return the free energy (psi, phi) in kJ/mol that a run with so many forces finds."""
    topology, system, positions = system_of()
    torsions = backbone(topology)
    integrator = integrator_of(kind.integrator, 0.001 * kind.fs, FRICTION)
    integrator.setRandomNumberSeed(seed)
    step = integrator.getStepSize()._value
    bias = app.Metadynamics(
        system, [variable(torsions[name]) for name in ANGLES], KELVIN, FACTOR, HEIGHT, round(EVERY / step)
    )
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    simulation.minimizeEnergy(maxIterations=200)
    simulation.context.setVelocitiesToTemperature(KELVIN, seed)
    steps = round(forces * 0.001 * kind.fs / step)
    bias.step(simulation, steps // 2)
    found = []
    for _ in range(ESTIMATES):
        bias.step(simulation, steps // (2 * ESTIMATES))
        found.append(bias.getFreeEnergy()._value)
    return np.mean(found, axis=0)


def profile(energies: np.ndarray, axis: int) -> np.ndarray:
    """Return the profile in kJ/mol of one angle, over bins that begin at -180 degrees."""
    weights = np.exp(-(energies - energies.min()) / (R * KELVIN)).sum(axis=axis)
    edges = np.arange(len(weights)) * BINS // len(weights)
    return -R * KELVIN * np.log(np.bincount(edges, weights) / np.bincount(edges))


def file_of(folder: Path, name: str, seed: int) -> Path:
    """Return the file of the free energy of a run."""
    return folder / f"{name.replace(' ', '_').replace(',', '')}_{seed}.npz"


def made(folder: Path, seeds: list[int], kinds: list[str], forces: int) -> None:
    """Make the runs that are missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in itertools.product(seeds, kinds):
        file = file_of(folder, name, seed)
        if not file.exists():
            begin = time.process_time()
            energies = free_energy(KINDS[name], seed, forces * (4 if name == REFERENCE else 1))
            seconds = time.process_time() - begin
            with written_whole(file, "wb") as out:
                np.savez(out, energies=energies, forces=forces, seconds=seconds)
            print(f"{name}, seed {seed}: {seconds:.0f} s", flush=True)


def rows_of(folder: Path) -> list[dict[str, str]]:
    """Return the profiles of all finished runs."""
    rows = []
    for name in KINDS:
        for file in sorted(folder.glob(f"{file_of(folder, name, 0).stem[:-1]}[0-9]*.npz")):
            content = np.load(file)
            for axis, angle in enumerate(ANGLES):
                run = {"kind": name, "seed": file.stem.rsplit("_", 1)[1], "forces": f"{content['forces']}"}
                for k, energy in enumerate(profile(content["energies"], axis)):
                    degrees = -180.0 + (k + 0.5) * 360.0 / BINS
                    rows.append(run | {"angle": angle, "degrees": f"{degrees:g}", "energy": f"{energy:.6g}"})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("folder", type=Path, help="of free energies")
    add("--kinds", nargs="+", choices=KINDS, default=[*KINDS], help="%(default)s")
    add("--seeds", nargs="+", type=int, default=[1, 2, 3], help="%(default)s")
    add("--forces", type=int, default=2_500_000, help="of a run, four times for the reference (%(default)s)")
    add("--record", type=Path, default=RECORDS / "metadynamics.csv", metavar="CSV", help="%(default)s")
    add("--table", action="store_true", help="print the differences, and make nothing")
    args = parser.parse_args()
    if not args.table:
        made(args.folder, args.seeds, args.kinds, args.forces)
        write(args.record, ("kind", "seed", "forces", "angle", "degrees", "energy"), rows_of(args.folder))
    print(metadynamics(args.record))


if __name__ == "__main__":
    main()
