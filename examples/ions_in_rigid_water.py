"""Sodium and chloride in rigid water: free particles move beside rigid bodies by the same splitting.

Writes a trajectory and its energies, and prints the temperatures of translation and rotation. After an accident the
same command with --resume goes on.
"""

from __future__ import annotations

import argparse
import random
import sys

import numpy as np
import openmm
from openmm import app, unit
from openmm.unit import femtoseconds, kelvin, molar, nanometer

import openmm_exactrb as rb


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=300, metavar="N", help="steps of 6 fs (%(default)s)")
    parser.add_argument("--platform", default="CPU", metavar="NAME", help="OpenMM platform (%(default)s)")
    rb.Run.add_options(parser, "out/ions")
    args = parser.parse_args()
    try:
        run(args)
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        print(f"ions_in_rigid_water.py: {error}", file=sys.stderr)
        return 1
    return 0


def run(args: argparse.Namespace) -> None:
    job = rb.Run.from_options(args, free=["steps"])
    job.add_reporter(app.DCDReporter, "trajectory.dcd", 10)
    job.add_reporter(rb.EnergyReporter, "energies.csv", 10)
    force_field = app.ForceField("amber14/tip3p.xml")
    random.seed(1)  # Modeller places ions with Python's generator
    modeller = app.Modeller(app.Topology(), unit.Quantity([], nanometer))
    modeller.addSolvent(force_field, boxSize=openmm.Vec3(2, 2, 2) * nanometer, ionicStrength=0.5 * molar)
    system = force_field.createSystem(
        modeller.topology,
        nonbondedMethod=app.PME,
        nonbondedCutoff=0.8 * nanometer,
        switchDistance=0.7 * nanometer,
        rigidWater=True,
    )
    integrator = rb.ExactRigidBodyIntegrator(6 * femtoseconds, scheme="S2_3")
    platform = openmm.Platform.getPlatform(args.platform)
    simulation = app.Simulation(modeller.topology, system, integrator, platform)
    simulation.context.setPositions(modeller.positions)
    if not job.resuming:
        simulation.minimizeEnergy()
        integrator.setVelocitiesToTemperature(300 * kelvin, 1)
    job.advance(simulation, args.steps)

    bodies, _ = integrator.bodyState()
    energy = np.loadtxt(args.out / "energies.csv", delimiter=",", skiprows=1, ndmin=2)[:, -1]
    translation, rotation = integrator.temperatures()
    print(f"{bodies.n_turning} rigid molecules and {len(bodies) - bodies.n_turning} ions")
    print(f"temperature of translation {translation._value:.0f} K, of rotation {rotation._value:.0f} K")
    print(f"std of the total energy {np.std(energy) / len(bodies):.1e} kJ/mol a molecule")
    print(f"{args.out}: topology.pdb, trajectory.dcd, energies.csv")


if __name__ == "__main__":
    sys.exit(main())
