"""
A peptide in rigid water
========================

This script computes a trajectory from a PDB file, for alanine dipeptide with constrained bonds to hydrogen in a box of
rigid water. A step of 4 fs evaluates the nonbonded forces once; the forces of bonds, angles and torsions are evaluated
in inner steps. The script writes a trajectory and its energies, and draws the total energy. After an interruption, the
same command with ``--resume`` continues the run.

This page shows ``python examples/solvated_peptide.py --steps 100``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app
from openmm.unit import femtoseconds, kelvin, nanometer

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt

PEPTIDE = Path(sys.argv[0]).resolve().parent / "data" / "alanine_dipeptide.pdb"


# %%
# One line is specific to this package. Because the nonbonded forces are evaluated only every 4 fs, bonded forces are
# integrated with inner steps.


def nve() -> rb.ExactRigidBodyIntegrator:
    return rb.ExactRigidBodyIntegrator(forceInterval=4 * femtoseconds)


# %%
# The force field and the System are created as in an ordinary OpenMM script. Water molecules are rigid bodies;
# constrained groups of the peptide, such as CH\ :sub:`3`, satisfy their constraints to roundoff.


def run(args: argparse.Namespace) -> None:
    job = rb.Run.from_options(args, free=["steps"])
    job.add_reporter(app.DCDReporter, "trajectory.dcd", 10)
    job.add_reporter(rb.EnergyReporter, "energies.csv", 2)
    picture = job.path("energy.png")
    pdb = app.PDBFile(str(PEPTIDE))
    force_field = app.ForceField("amber14-all.xml", "amber14/tip3p.xml")
    modeller = app.Modeller(pdb.topology, pdb.positions)
    modeller.addSolvent(force_field, padding=1.0 * nanometer)
    system = force_field.createSystem(
        modeller.topology,
        nonbondedMethod=app.PME,
        nonbondedCutoff=0.8 * nanometer,
        switchDistance=0.7 * nanometer,
        ewaldErrorTolerance=1e-5,
        constraints=app.HBonds,
        rigidWater=True,
    )
    platform = openmm.Platform.getPlatform(args.platform)
    simulation = app.Simulation(modeller.topology, system, nve(), platform)
    integrator = simulation.integrator
    simulation.context.setPositions(modeller.positions)
    if not job.resuming:
        simulation.minimizeEnergy(maxIterations=200)
        integrator.setVelocitiesToTemperature(300 * kelvin, 1)
    integrator.timings.reset()
    job.advance(simulation, args.steps)

    bodies, _ = integrator.bodyState()
    table = np.loadtxt(args.out / "energies.csv", delimiter=",", skiprows=1, ndmin=2)
    translation, rotation = integrator.degreesOfFreedom()
    timings = integrator.timings
    print(f"{bodies.n_turning} rigid bodies and {len(bodies.clusters)} flexible clusters")
    print(f"{translation} translational and {rotation} rotational degrees of freedom")
    print(
        f"{timings.fast_evaluations / timings.evaluations:.1f} evaluations of the bonded forces for one of the others"
    )
    print(f"std of the total energy {np.std(table[:, -1]):.2f} kJ/mol")
    print(f"{args.out}: topology.pdb, trajectory.dcd, energies.csv, energy.png")
    draw(table, picture)


# %%
# The kinetic energy fluctuates by tens of kJ/mol; the standard deviation of the total energy is printed above.


def draw(table: np.ndarray, file: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    kinetic = table[:, 2] + table[:, 3]
    for name, energy, colour, style in (
        ("kinetic", kinetic, "#0072B2", "--"),
        ("total", table[:, -1], "#D55E00", "-"),
    ):
        axes.plot(table[:, 1], energy - energy[0], style, color=colour, label=name)
    axes.set_xlabel("time (ps)")
    axes.set_ylabel("energy less that of the start (kJ/mol)")
    axes.set_title("Alanine dipeptide in rigid water")
    axes.grid(True, alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=150)


# %%
# The number of bonded evaluations per step follows from the fastest vibration of bonds and angles; ``inner`` and
# ``innerSteps`` override it.


def main() -> None:
    parser = argparse.ArgumentParser(description="Alanine dipeptide in rigid water.")
    parser.add_argument("--steps", type=int, default=500, metavar="N", help="steps of 4 fs (%(default)s)")
    parser.add_argument("--platform", default="CPU", metavar="NAME", help="OpenMM platform (%(default)s)")
    rb.Run.add_options(parser, "out/peptide")
    args = parser.parse_args()
    try:
        run(args)
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"solvated_peptide.py: {error}")


if __name__ == "__main__":
    main()
