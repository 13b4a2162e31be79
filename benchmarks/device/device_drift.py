"""The energy drift in single, mixed and double precision: the native engine, the host engine, and OpenMM's integrators.

The system is a periodic box of TIP3P with PME and a switched cutoff, a droplet without a cutoff, or a peptide in water
with heavy hydrogens and inner steps for its bonded forces. All runs begin at one start at 300 K and have the same time
between two force evaluations. For each run the script writes the slope of a line through the total energy per molecule,
its standard error from four parts of the run, and the standard deviation about that line. The potential energy is that
of a Context in double precision at the positions of the bodies, so that the precision of the Context affects the
dynamics but not the measurement. LangevinMiddle has no friction here; the energy at the ends of its steps has errors of
first order. Starts, samples and checkpoints are stored in a folder next to the CSV file, so that the same command
resumes an interrupted run; a command with other settings needs another file.

    python benchmarks/device/device_drift.py --platform OpenCL --molecules 64 --ps 6 --samples 60
    python benchmarks/device/device_drift.py --platform OpenCL --system droplet --molecules 27 --fs 0.4 --ps 0.4 \
        --samples 25 --integrators S6_10:native S6_10:host
    python benchmarks/device/device_drift.py --platform OpenCL --system peptide --fs 4 --precisions mixed \
        --integrators W2_1:native W2_1:host
"""

from __future__ import annotations

import argparse
import csv
import sys
import warnings
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.proteins import PEPTIDE, solvated, system_of

PRECISIONS = ("single", "mixed", "double")
COLUMNS = (
    *("integrator", "engine", "precision", "molecules", "fs_a_force", "ps"),
    *("drift_kJ_per_mol_ns_molecule", "drift_error", "spread_kJ_per_mol_molecule"),
)


def start_of(which, molecules):
    """Return a System and positions."""
    if which == "peptide":
        topology, positions = solvated(PEPTIDE)
        system = system_of(topology)
        rb.heavy_hydrogens(system, topology, 3.0, water=True)
        rb.separate_bonded(system)
        return system, positions
    cutoff = min(0.9, 0.45 * 0.3104 * molecules ** (1 / 3))
    made = {"nonbondedMethod": app.PME, "nonbondedCutoff": cutoff, "switchDistance": cutoff - 0.1}
    return rb.rigid_water(molecules, **({} if which == "droplet" else made | {"ewaldErrorTolerance": 1e-5}))[1:]


def integrator_of(name, engine, h, inner):
    """Return an integrator with a force evaluation every h (ps), and with inner steps."""
    if engine == "openmm":
        return openmm.VerletIntegrator(h) if name == "Verlet" else openmm.LangevinMiddleIntegrator(300.0, 0.0, h)
    forces = rb.SCHEMES[name].forces
    return rb.ExactRigidBodyIntegrator(forces * h, name, engine=engine, checkDivergence=False, **inner)


class Energies:
    """Total energies of runs of a System, their potential part in double precision."""

    def __init__(self, system, platform):
        self.system, self.platform = system, platform
        self.double = self.context_of(openmm.VerletIntegrator(0.001), "double")

    def context_of(self, integrator, precision):
        """Return a Context of a copy of the System."""
        system = openmm.XmlSerializer.clone(self.system)
        return openmm.Context(system, integrator, self.platform, {"Precision": precision})

    def start(self, positions, inner):
        """Return a State at 300 K."""
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, "BAOA", **inner)
        system = openmm.XmlSerializer.clone(self.system)
        context = openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"))
        context.setPositions(positions)
        integrator.minimizeEnergy(maxIterations=100)
        integrator.setVelocitiesToTemperature(300.0, 1)
        integrator.step(2500)
        return context.getState(positions=True, velocities=True)

    def present(self, context):
        """Return the total energy (kJ/mol) of a Context."""
        integrator, state = context.getIntegrator(), context.getState(positions=True, energy=True)
        x, kinetic = state.getPositions(asNumpy=True)._value, state.getKineticEnergy()._value
        if isinstance(integrator, rb.ExactRigidBodyIntegrator):
            bodies, held = integrator.bodyState()
            x, kinetic = (
                bodies.positions(held, np.array(x)),
                sum(energy._value for energy in integrator.kineticEnergies()),
            )
        self.double.setPositions(x)
        return kinetic + self.double.getState(energy=True).getPotentialEnergy()._value

    def run(self, integrator, precision, start, ps, samples, file):
        """Return times (ns) and total energies of a run from a State; what a file has of it is not made again."""
        context, found = self.context_of(integrator, precision), []
        context.setState(start)
        if file.exists():
            kept = np.load(file)
            found = kept["found"].tolist()
            context.loadCheckpoint(kept["checkpoint"].tobytes())
        steps = round(ps / samples / integrator.getStepSize()._value)
        while len(found) < samples:
            integrator.step(steps)
            found.append((1e-3 * context.getTime()._value, self.present(context)))
            with rb.written_whole(file, "wb") as out:
                np.savez(out, found=found, checkpoint=np.frombuffer(context.createCheckpoint(), dtype=np.uint8))
        return np.array(found).T


def folder_of(options):
    """Return the folder of what is kept; an error if it is that of another command."""
    folder = options.csv.with_suffix("")
    what = f"{options.molecules} {options.system} {options.fs} {options.ps} {options.samples}"
    folder.mkdir(exist_ok=True)
    settings = folder / "settings.txt"
    if settings.exists() and settings.read_text(encoding="utf-8") != what:
        sys.exit(f"{folder} has runs of another command: remove it, or name another file with --csv")
    settings.write_text(what, encoding="utf-8")
    return folder


def slopes(times, energies):
    """Return the slope of all energies, its standard error by four parts, and the deviation from the line."""
    line = np.polyfit(times, energies, 1)
    parts = [np.polyfit(t, e, 1)[0] for t, e in zip(np.array_split(times, 4), np.array_split(energies, 4), strict=True)]
    # A slope has the inverse cube of the length in its variance: that of the whole is an eighth of that of a quarter's.
    return line[0], np.std(parts, ddof=1) / 8.0, np.std(energies - np.polyval(line, times))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument("--system", choices=("box", "droplet", "peptide"), default="box")
    parser.add_argument("--molecules", type=int, default=512, help="of box or droplet")
    parser.add_argument("--fs", type=float, default=1.0, help="a force evaluation")
    parser.add_argument("--ps", type=float, default=100.0)
    parser.add_argument("--samples", type=int, default=100)
    names = ["Verlet:openmm", "LangevinMiddle:openmm", "S2_2:native", "W2_1:native", "S6_10:native", "S2_2:host"]
    parser.add_argument("--integrators", nargs="+", default=names, help="name:engine")
    parser.add_argument("--precisions", nargs="+", default=PRECISIONS, choices=PRECISIONS)
    parser.add_argument("--csv", type=Path, default=Path("device_drift.csv"))
    options = parser.parse_args()
    warnings.filterwarnings("ignore", message="the Context is in single precision")
    inner = {"fast": "bonded"} if options.system == "peptide" else {}
    system, positions = start_of(options.system, options.molecules)
    energies = Energies(system, openmm.Platform.getPlatform(options.platform))
    folder = folder_of(options)
    if not (folder / "start.xml").exists():
        made = openmm.XmlSerializer.serialize(energies.start(positions, inner))
        (folder / "start.xml").write_text(made, encoding="utf-8")
    start = openmm.XmlSerializer.deserialize((folder / "start.xml").read_text(encoding="utf-8"))
    n, h = len(energies.double.getMolecules()), 1e-3 * options.fs
    with options.csv.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        for name, engine in (which.split(":") for which in options.integrators):
            for precision in options.precisions:
                kept = folder / f"{name}-{engine}-{precision}.npz"
                integrator = integrator_of(name, engine, h, inner)
                run = energies.run(integrator, precision, start, options.ps, options.samples, kept)
                drift, error, spread = (f"{value / n:.2e}" for value in slopes(*run))
                row = (name, engine, precision, n, options.fs, options.ps, drift, error, spread)
                rows.writerow(row)
                file.flush()
                print(*row, flush=True)


if __name__ == "__main__":
    main()
