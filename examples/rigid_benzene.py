"""
Molecules made rigid by hand
============================

If a force field describes a molecule as flexible, with bonds and angles and without constraints, ``bodies=`` makes it
rigid: the positions at the first step define its shape, and forces within the molecule only add a constant to the
energy. The example is a small cluster of the flexible OPLS-AA benzene. The script writes a trajectory, its energies and
a picture; ``--resume`` continues after an interruption.

This page shows ``python examples/rigid_benzene.py -n 8 --steps 100``.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit
from openmm.unit import femtoseconds, kelvin

import openmm_exactrb as rb
from openmm_exactrb.mathematics import quaternions

mpl.use("Agg")
import matplotlib.pyplot as plt

# W. L. Jorgensen and D. L. Severance, J. Am. Chem. Soc. 112, 4768 (1990), doi:10.1021/ja00168a022, in OpenMM's units.
CHARGE = {"C": -0.115, "H": 0.115}
SIGMA = {"C": 0.355, "H": 0.242}
EPSILON = {"C": 0.29288, "H": 0.12552}
MASS = {"C": 12.011, "H": 1.008}
ATOMS = ["C"] * 6 + ["H"] * 6


def main() -> None:
    parser = argparse.ArgumentParser(description="Benzene made rigid by hand: bodies=[...] names the molecules.")
    parser.add_argument("-n", type=int, default=27, metavar="N", help="molecules (%(default)s)")
    parser.add_argument("--steps", type=int, default=200, metavar="N", help="steps of 30 fs (%(default)s)")
    parser.add_argument("--platform", default="Reference", metavar="NAME", help="OpenMM platform (%(default)s)")
    rb.Run.add_options(parser, "out/benzene")
    args = parser.parse_args()
    try:
        run(args)
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"rigid_benzene.py: {error}")


# %%
# The molecules start with random orientations on a lattice. ``bodies=`` lists the particles of each molecule.


def run(args: argparse.Namespace) -> None:
    job = rb.Run.from_options(args, free=["steps"])
    job.add_reporter(app.DCDReporter, "trajectory.dcd", 5)
    job.add_reporter(rb.EnergyReporter, "energies.csv", 5)
    picture = job.path("cluster.png")
    topology, system = cluster(args.n)
    shape = measured_molecule()
    rng = np.random.default_rng(1)
    edge = int(np.ceil(args.n ** (1 / 3)))
    centres = 0.62 * np.array(list(itertools.product(range(edge), repeat=3)))[: args.n]
    Q = quaternions.rotation_matrix(quaternions.random(rng, args.n))
    positions = (centres[:, None] + np.einsum("nij,sj->nsi", Q, shape)).reshape(-1, 3)

    molecules = [range(12 * k, 12 * k + 12) for k in range(args.n)]
    integrator = rb.ExactRigidBodyIntegrator(30 * femtoseconds, scheme="SRKN4_6b", bodies=molecules)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform(args.platform))
    simulation.context.setPositions(positions)
    integrator.setVelocitiesToTemperature(150 * kelvin, 1)
    inner = inner_energy(simulation)
    job.advance(simulation, args.steps)

    energy = np.loadtxt(args.out / "energies.csv", delimiter=",", skiprows=1, ndmin=2)[:, -1]
    print(f"energy of bonds and angles: {inner:.6f} kJ/mol before, {inner_energy(simulation):.6f} after")
    print(f"std of the total energy {np.std(energy) / args.n:.1e} kJ/mol per molecule")
    print(f"{args.out}: topology.pdb, trajectory.dcd, energies.csv, cluster.png")
    x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value
    time = args.steps * integrator.getStepSize().value_in_unit(unit.picosecond)
    draw(x.reshape(-1, 12, 3), f"{args.n} rigid molecules of benzene after {time:g} ps", picture)


# %%
# The following functions define the published, flexible force field, and the shape and energy of a molecule.


def cluster(n: int) -> tuple[app.Topology, openmm.System]:
    """Return the Topology and the System of n flexible molecules, with bonds and angles in force group 1."""
    topology, system = app.Topology(), openmm.System()
    bonds, angles, pairs = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce(), openmm.NonbondedForce()
    bonds.setForceGroup(1)
    angles.setForceGroup(1)
    chain = topology.addChain()
    for molecule in range(n):
        residue, first = topology.addResidue("BNZ", chain), 12 * molecule
        atoms = []
        for k, name in enumerate(ATOMS):
            system.addParticle(MASS[name])
            pairs.addParticle(CHARGE[name], SIGMA[name], EPSILON[name])
            atoms.append(topology.addAtom(f"{name}{k % 6 + 1}", app.Element.getBySymbol(name), residue))
        for k in range(6):
            after, before = (k + 1) % 6, (k - 1) % 6
            for i, j, length, strength in ((k, after, 0.14, 392459.2), (k, k + 6, 0.108, 307105.6)):
                bonds.addBond(first + i, first + j, length, strength)
                topology.addBond(atoms[i], atoms[j])
            for i, j, strength in ((before, after, 527.184), (before, k + 6, 292.88), (after, k + 6, 292.88)):
                angles.addAngle(first + i, first + k, first + j, 2.0943951, strength)
        for i, j in itertools.combinations(range(12), 2):
            pairs.addException(first + i, first + j, 0.0, 1.0, 0.0)
    for force in (bonds, angles, pairs):
        system.addForce(force)
    return topology, system


def measured_molecule() -> np.ndarray:
    """Return the positions (12, 3) in nm of a molecule with measured bond lengths, unlike those of the force field."""
    phi = np.pi / 3 * np.arange(6)
    ring = np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])
    return np.vstack([0.1391 * ring, 0.2471 * ring])


def inner_energy(simulation: app.Simulation) -> float:
    return simulation.context.getState(energy=True, groups={1}).getPotentialEnergy()._value


def draw(molecules: np.ndarray, title: str, file: Path) -> None:
    """Draw the rings and the bonds to hydrogen."""
    figure = plt.figure(figsize=(6.4, 5.6), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    for atoms in molecules:
        axes.plot(*atoms[[0, 1, 2, 3, 4, 5, 0]].T, color="#0072B2", lw=2.5)
        for k in range(6):
            axes.plot(*atoms[[k, k + 6]].T, color="0.6", lw=1.5)
    axes.set_aspect("equal")
    axes.set_xlabel("x (nm)")
    axes.set_ylabel("y (nm)")
    axes.set_zlabel("z (nm)")
    axes.set_title(title)
    figure.savefig(file, dpi=150)


# %%
# The energy of bonds and angles is the same before and after the run, to the last digit printed: the molecules stayed
# rigid. The step is 30 fs, which would be unstable with the bonds of the flexible molecule.

if __name__ == "__main__":
    main()
