"""
Ions in rigid water
===================

Particles without constraints are integrated together with the rigid bodies, by the same splitting: this script adds
sodium and chloride to a box of water and changes nothing else. It writes a trajectory and its energies, and draws the
temperatures of translation and rotation. After an interruption, the same command with ``--resume`` continues the run.

This page shows ``python examples/ions_in_rigid_water.py --steps 100``.
"""

from __future__ import annotations

import argparse
import random
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit
from openmm.unit import femtoseconds, kelvin, molar, nanometer

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt


def main() -> None:
    parser = argparse.ArgumentParser(description="Sodium and chloride in rigid water.")
    parser.add_argument("--steps", type=int, default=300, metavar="N", help="steps of 8 fs (%(default)s)")
    parser.add_argument("--platform", default="CPU", metavar="NAME", help="OpenMM platform (%(default)s)")
    rb.Run.add_options(parser, "out/ions")
    args = parser.parse_args()
    try:
        run(args)
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"ions_in_rigid_water.py: {error}")


# %%
# The force field and the System are created as in an ordinary OpenMM script. The constraints define the bodies;
# particles without constraints are ions.


def run(args: argparse.Namespace) -> None:
    job = rb.Run.from_options(args, free=["steps"])
    job.add_reporter(app.DCDReporter, "trajectory.dcd", 10)
    job.add_reporter(rb.EnergyReporter, "energies.csv", 2)
    picture = job.path("temperatures.png")
    force_field = app.ForceField("amber14/tip3p.xml")
    random.seed(1)  # Modeller places ions with Python's generator
    modeller = app.Modeller(app.Topology(), unit.Quantity([], nanometer))
    modeller.addSolvent(force_field, boxSize=openmm.Vec3(2, 2, 2) * nanometer, ionicStrength=0.5 * molar)
    system = force_field.createSystem(
        modeller.topology,
        nonbondedMethod=app.PME,
        nonbondedCutoff=0.8 * nanometer,
        switchDistance=0.7 * nanometer,
        ewaldErrorTolerance=1e-5,
        rigidWater=True,
    )
    integrator = rb.ExactRigidBodyIntegrator(forceInterval=2 * femtoseconds, scheme="W4_4")
    platform = openmm.Platform.getPlatform(args.platform)
    simulation = app.Simulation(modeller.topology, system, integrator, platform)
    simulation.context.setPositions(modeller.positions)
    if not job.resuming:
        simulation.minimizeEnergy(maxIterations=200)
        equilibrate(simulation)
    job.advance(simulation, args.steps)

    bodies, _ = integrator.bodyState()
    table = np.loadtxt(args.out / "energies.csv", delimiter=",", skiprows=1, ndmin=2)
    translation, rotation = integrator.temperatures()
    print(f"{bodies.n_turning} rigid molecules and {len(bodies) - bodies.n_turning} ions")
    print(f"temperature of translation {translation._value:.0f} K, of rotation {rotation._value:.0f} K")
    print(f"std of the total energy {np.std(table[:, -1]) / len(bodies):.1e} kJ/mol per molecule")
    print(f"{args.out}: topology.pdb, trajectory.dcd, energies.csv, temperatures.png")
    draw(table, picture)


# %%
# After a minimisation, half of the initial kinetic energy becomes potential energy. The momenta are therefore drawn
# several times, until translation and rotation have the desired temperature.


def equilibrate(simulation: app.Simulation, times: int = 20) -> None:
    for seed in range(1, times + 1):
        simulation.integrator.setVelocitiesToTemperature(300 * kelvin, seed)
        simulation.integrator.step(10)
    simulation.context.setTime(0.0)
    simulation.context.setStepCount(0)


# %%
# A temperature is twice the kinetic energy divided by :math:`k_B` and by the number of degrees of freedom. An ion has
# three translational degrees of freedom and no rotational ones.


def draw(table: np.ndarray, file: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    for name, temperature, colour, style in (
        ("translation", table[:, 4], "#0072B2", "-"),
        ("rotation", table[:, 5], "#D55E00", "--"),
    ):
        label = f"{name}, mean {temperature.mean():.0f} K"
        axes.plot(table[:, 1], temperature, style, color=colour, label=label)
    axes.axhline(300.0, color="0.5", lw=0.8, ls=":")
    axes.set_xlabel("time (ps)")
    axes.set_ylabel("temperature (K)")
    axes.set_ylim(200.0, 400.0)
    axes.set_title("Sodium and chloride in rigid water")
    axes.grid(True, alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
