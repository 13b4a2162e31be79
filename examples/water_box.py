"""A box of rigid water from a PDB file: one line of an OpenMM script changes, and the energy error with it.

The script is the usual one: force field, PME, Simulation, DCDReporter. Only the integrator is ours. It writes a
trajectory (DCD with its topology as PDB), the energies and a picture of the energy error, and runs OpenMM's own
VerletIntegrator from the same start for the picture.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit
from openmm.unit import femtoseconds, kelvin, nanometer
from tqdm import tqdm

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt


def main() -> int:
    args = parse()
    try:
        run(args)
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        print(f"water_box.py: {error}", file=sys.stderr)
        return 1
    return 0


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--pdb", type=Path, help="a PDB file of water (a box of 216 molecules that the script makes)")
    add("--scheme", choices=rb.SCHEMES, default="S2_3", metavar="NAME", help=f"{', '.join(rb.SCHEMES)} (%(default)s)")
    add("--force-interval", type=float, default=2.0, metavar="FS", help="time a force evaluation, fs (%(default)s)")
    add("--duration", type=float, default=4.0, metavar="PS", help="length of the run, ps (%(default)s)")
    add("--platform", default="CPU", metavar="NAME", help="OpenMM platform (%(default)s)")
    add("--out", type=Path, default=Path("out/water_box"), metavar="DIR", help="output folder (%(default)s)")
    return parser.parse_args()


def run(args: argparse.Namespace) -> None:
    args.out.mkdir(parents=True, exist_ok=True)
    pdb = app.PDBFile(str(args.pdb or make_box(args.out)))
    system = app.ForceField("tip3p.xml").createSystem(
        pdb.topology,
        nonbondedMethod=app.PME,
        nonbondedCutoff=0.8 * nanometer,
        switchDistance=0.7 * nanometer,
        ewaldErrorTolerance=1e-5,  # loose PME hides the error of any integrator
        rigidWater=True,
        removeCMMotion=False,
    )
    platform = openmm.Platform.getPlatform(args.platform)
    start = equilibrate(pdb, system, platform)

    # The line that changes. The step is that of the whole scheme, so the cost of both runs is the same.
    verlet = openmm.VerletIntegrator(args.force_interval * femtoseconds)
    exact = rb.ExactRigidBodyIntegrator(
        args.force_interval * rb.SCHEMES[args.scheme].stages * femtoseconds, scheme=args.scheme
    )

    errors = {}
    for name, integrator in (("VerletIntegrator", verlet), (f"ExactRigidBodyIntegrator, {args.scheme}", exact)):
        simulation = app.Simulation(pdb.topology, system, integrator, platform)
        simulation.context.setState(start)
        if integrator is exact:
            frames = max(1, round(0.05 / (integrator.getStepSize().value_in_unit(unit.picosecond))))
            simulation.reporters.append(app.DCDReporter(str(args.out / "trajectory.dcd"), frames))
            simulation.reporters.append(rb.EnergyReporter(args.out / "energies.csv", frames))
        errors[name] = follow_energy(simulation, args.duration, name)
        noise = np.std(errors[name][1]) / pdb.topology.getNumResidues()
        print(f"{name:<40} std of the total energy {noise:.1e} kJ/mol a molecule")
    draw(errors, pdb.topology.getNumResidues(), args.force_interval, args.out / "energy_error.png")
    print(f"{args.out}: box.pdb, trajectory.dcd, energies.csv, energy_error.png")


def make_box(out: Path) -> Path:
    """Write a PDB file of 216 molecules."""
    topology, _, positions = rb.rigid_water(216, nonbondedMethod=app.PME, nonbondedCutoff=0.8 * nanometer)
    file = out / "box.pdb"
    with file.open("w") as handle:
        app.PDBFile.writeFile(topology, positions, handle)
    return file


def equilibrate(pdb: app.PDBFile, system: openmm.System, platform: openmm.Platform) -> openmm.State:
    """Return a canonical start."""
    langevin = openmm.LangevinMiddleIntegrator(300 * kelvin, 5 / unit.picosecond, 2 * femtoseconds)
    langevin.setRandomNumberSeed(1)
    simulation = app.Simulation(pdb.topology, system, langevin, platform)
    simulation.context.setPositions(pdb.positions)
    simulation.minimizeEnergy()
    simulation.context.setVelocitiesToTemperature(300 * kelvin, 1)
    simulation.step(1000)
    return simulation.context.getState(positions=True, velocities=True)


def follow_energy(simulation: app.Simulation, duration: float, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Run and return times (ps) and total energies (kJ/mol)."""
    h = simulation.integrator.getStepSize().value_in_unit(unit.picosecond)
    interval = max(1, round(0.02 / h))
    samples = []
    for _ in tqdm(range(round(duration / (interval * h))), desc=name, mininterval=1.0):
        simulation.step(interval)
        state = simulation.context.getState(energy=True)
        energy = state.getPotentialEnergy() + state.getKineticEnergy()
        samples.append((state.getTime().value_in_unit(unit.picosecond), energy.value_in_unit(unit.kilojoule_per_mole)))
    return tuple(np.array(samples).T)


def draw(errors: dict[str, tuple[np.ndarray, np.ndarray]], molecules: int, interval: float, file: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    for (name, (times, energies)), colour in zip(errors.items(), ("#D55E00", "#0072B2"), strict=True):
        axes.plot(times - times[0], (energies - energies.mean()) / molecules, color=colour, lw=1.0, label=name)
    axes.set_xlabel("time (ps)")
    axes.set_ylabel("total energy - mean (kJ/mol per molecule)")
    axes.set_title(f"Rigid TIP3P water, PME, a force evaluation every {interval:g} fs")
    axes.grid(True, alpha=0.3)
    axes.legend(loc="upper right", fontsize=9)
    figure.savefig(file, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    sys.exit(main())
