"""
A box of rigid water
====================

This is an ordinary OpenMM script, with a force field, PME, a Simulation and a DCDReporter. Only the line that creates
the integrator is different. The script simulates a box twice from the same initial state, with OpenMM's
``VerletIntegrator`` and with :class:`openmm_exactrb.ExactRigidBodyIntegrator`, both with one force evaluation every 2
fs. It writes a trajectory (DCD with its topology as PDB), the energies and a picture of the energy error. After
an interruption, the same command with ``--resume`` continues the run.

This page shows ``python examples/water_box.py --duration 2``.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
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


def main() -> None:
    args = parse()
    try:
        run(args)
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"water_box.py: {error}")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="A box of rigid water: one line of an OpenMM script changes, and the energy error with it."
    )
    add = parser.add_argument
    add("--pdb", type=Path, help="a PDB file of water (216 molecules that the script makes)")
    add("--scheme", choices=rb.SCHEMES, default="W4_4", metavar="NAME", help=f"{', '.join(rb.SCHEMES)} (%(default)s)")
    add("--force-interval", type=float, default=2.0, metavar="FS", help="time per force evaluation, fs (%(default)s)")
    add("--duration", type=float, default=4.0, metavar="PS", help="length of the run, ps (%(default)s)")
    add("--platform", default="CPU", metavar="NAME", help="OpenMM platform (%(default)s)")
    rb.Run.add_options(parser, "out/water_box")
    return parser.parse_args()


# %%
# Two settings of the System matter as much as the integrator: without ``switchDistance``, the energy jumps when a
# molecule crosses the cutoff, and with the default ``ewaldErrorTolerance``, the electrostatic energy jumps when
# charges cross the cutoff.


def run(args: argparse.Namespace) -> None:
    verlet_job = rb.Run.from_options(args, "verlet", free=["duration"])
    exact_job = rb.Run.from_options(args, free=["duration"])
    picture = exact_job.path("energy_error.png")
    pdb = read_box(args.pdb) if args.pdb else make_box()
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
    start = start_of(exact_job, args.resume, pdb, system, platform)

    # Only this line changes. The runs cost the same, except for 5 % more force evaluations for the output of W4_4.
    verlet = openmm.VerletIntegrator(args.force_interval * femtoseconds)
    exact = rb.ExactRigidBodyIntegrator(forceInterval=args.force_interval * femtoseconds, scheme=args.scheme)

    own, table = rb.EnergyReporter, partial(app.StateDataReporter, step=True, time=True, totalEnergy=True)
    errors = {}
    for name, integrator, job, energies in (
        ("VerletIntegrator", verlet, verlet_job, table),
        (f"ExactRigidBodyIntegrator, {args.scheme}", exact, exact_job, own),
    ):
        h = integrator.getStepSize().value_in_unit(unit.picosecond)
        job.add_reporter(app.DCDReporter, "trajectory.dcd", max(1, round(0.05 / h)))
        job.add_reporter(energies, "energies.csv", max(1, round(0.02 / h)))
        simulation = app.Simulation(pdb.topology, system, integrator, platform)
        simulation.context.setState(start)
        steps = round(args.duration / h)
        with tqdm(total=steps, desc=name, mininterval=1.0, delay=1.0) as bar:
            job.advance(simulation, steps, progress=bar.update)
        errors[name] = np.loadtxt(job.folder / "energies.csv", delimiter=",", skiprows=1, ndmin=2)[:, [1, -1]].T
        noise = np.std(errors[name][1]) / pdb.topology.getNumResidues()
        print(f"{name:<40} std of the total energy {noise:.1e} kJ/mol per molecule")
    draw(errors, pdb.topology.getNumResidues(), args.force_interval, picture)
    print(f"{args.out}: topology.pdb, trajectory.dcd, energies.csv, energy_error.png")


# %%
# The box is read from a file or built by the script; a Langevin run then brings it to 300 K.


def read_box(file: Path) -> app.PDBFile:
    """Return the contents of a PDB file, which must be complete."""
    try:
        if not any(line.startswith("END") for line in file.read_text(encoding="utf-8").splitlines()):
            raise ValueError("it has no END line")
        return app.PDBFile(str(file))
    except OSError:
        raise
    except Exception as error:  # OpenMM's parser raises exceptions of any kind
        raise ValueError(f"{file} is no PDB file, or a truncated one: {error}") from error


def make_box() -> app.Modeller:
    """Return the topology and positions of a box of 216 water molecules."""
    topology, _, positions = rb.rigid_water(216, nonbondedMethod=app.PME, nonbondedCutoff=0.8 * nanometer)
    return app.Modeller(topology, positions)


def start_of(
    job: rb.Run, resume: bool, pdb: app.PDBFile | app.Modeller, system: openmm.System, platform: openmm.Platform
) -> openmm.State:
    """Return an initial State at 300 K, which both runs and a resumed run share."""
    file = job.folder / "start.xml"
    if resume and file.exists():
        try:
            return openmm.XmlSerializer.deserialize(file.read_text(encoding="utf-8"))
        except openmm.OpenMMException as error:
            raise ValueError(f"{file} is damaged: {' '.join(str(error).split())}") from error
    job.path(file.name)
    start = equilibrate(pdb, system, platform)
    job.folder.mkdir(parents=True, exist_ok=True)
    with rb.written_whole(file) as out:
        out.write(openmm.XmlSerializer.serialize(start))
    return start


def equilibrate(pdb: app.PDBFile | app.Modeller, system: openmm.System, platform: openmm.Platform) -> openmm.State:
    """Return a State of the box after 2 ps of Langevin dynamics at 300 K."""
    langevin = openmm.LangevinMiddleIntegrator(300 * kelvin, 5 / unit.picosecond, 2 * femtoseconds)
    langevin.setRandomNumberSeed(1)
    simulation = app.Simulation(pdb.topology, system, langevin, platform)
    simulation.context.setPositions(pdb.positions)
    simulation.minimizeEnergy(tolerance=50)
    simulation.context.setVelocitiesToTemperature(300 * kelvin, 1)
    simulation.step(1000)
    simulation.currentStep = 0
    simulation.context.setTime(0.0)
    return simulation.context.getState(positions=True, velocities=True)


def draw(errors: dict[str, np.ndarray], molecules: int, interval: float, file: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    for (name, (times, energies)), colour in zip(errors.items(), ("#D55E00", "#0072B2"), strict=True):
        axes.plot(times - times[0], (energies - energies.mean()) / molecules, color=colour, lw=1.0, label=name)
    axes.set_xlabel("time (ps)")
    axes.set_ylabel("total energy - mean (kJ/mol per molecule)")
    axes.set_title(f"Rigid TIP3P water, PME, a force evaluation every {interval:g} fs")
    axes.grid(True, alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9)
    figure.savefig(file, dpi=150)


# %%
# Both total energies fluctuate about a mean. The amplitude is the error of the method: the smaller the amplitude, the
# closer the run stays to a surface of constant energy. Try ``--force-interval 1``, or ``--scheme W2_1``.

if __name__ == "__main__":
    main()
