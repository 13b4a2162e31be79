"""
Rigid domains
=============

The system is a protein of two folded domains and disordered parts, with one bead per residue: hnRNPA1 without a
hexapeptide (hnRNPA1*), in the CALVADOS 2 model of G. Tesei and K. Lindorff-Larsen, doi:10.12688/openreseurope.14967.2.
The domains are rigid, with the masses of all their beads, and pairs within them are excluded. The tutorial "Rigid
domains" contains measurements. The script writes a trajectory, its energies and a picture; ``--resume`` continues after
an interruption.

This page shows ``python examples/rigid_domains.py --steps 200``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit
from openmm.unit import femtoseconds, kelvin, picosecond

import openmm_exactrb as rb
from openmm_exactrb.mathematics import quaternions

mpl.use("Agg")
import matplotlib.pyplot as plt

_HERE = Path(globals().get("__file__", sys.argv[0])).resolve().parent  # the gallery sets no __file__

# For each residue, the mass (amu), the stickiness lambda, the diameter sigma (nm) and the charge (e).
RESIDUES = {
    "R": (156.19, 0.7307624767517166, 0.656, 1.0),
    "D": (115.09, 0.0416040480605567, 0.558, -1.0),
    "N": (114.1, 0.4255859009787713, 0.568, 0.0),
    "E": (129.11, 0.0006935460962935, 0.592, -1.0),
    "K": (128.17, 0.1790211738990582, 0.636, 1.0),
    "H": (137.14, 0.4663667290557992, 0.608, 0.0),
    "Q": (128.13, 0.3934318551056041, 0.602, 0.0),
    "S": (87.08, 0.4625416811611541, 0.518, 0.0),
    "C": (103.14, 0.5615435099141777, 0.548, 0.0),
    "G": (57.05, 0.7058843733666401, 0.45, 0.0),
    "T": (101.11, 0.3713162976273964, 0.562, 0.0),
    "A": (71.07, 0.2743297969040348, 0.504, 0.0),
    "M": (131.2, 0.5308481134337497, 0.618, 0.0),
    "Y": (163.18, 0.9774611449343455, 0.646, 0.0),
    "V": (99.13, 0.2083769608174481, 0.586, 0.0),
    "W": (186.22, 0.9893764740371644, 0.678, 0.0),
    "L": (113.16, 0.6440005007782226, 0.618, 0.0),
    "I": (113.16, 0.5423623610671892, 0.618, 0.0),
    "P": (97.12, 0.3593126576364644, 0.556, 0.0),
    "F": (147.18, 0.8672358982062975, 0.636, 0.0),
}
SEQUENCE = (
    "MSKSESPKEPEQLRKLFIGGLSFETTDESLRSHFEQWGTLTDCVVMRDPNTKRSRGFGFVTYATVEEVDAAMNARPHKVDGRVVEPKRAVSREDSQRPGAHLTV"
    "KKIFVGGIKEDTEEHHLRDYFEQYGKIEVIEIMTDRGSGKKRGFAFVTFDDHDSVDKIVIQKYHTVNGHNCEVRKALSKQEMASASSSQRGRSGSGNFGGGRGG"
    "GFGGNDNFGRGGNFSGRGGFGGSRGGGGYGGSGDGYNGFGNDGSNFGGGGNYNNQSSNFGPMKGGNFGGRSSGPYGGGGQYFAKPRNQGGYGGSSSSSSYGSGR"
    "RF"
)
# Residues 11 to 89 and 105 to 179, counted from 0; the others are flexible.
DOMAINS = [range(10, 89), range(104, 179)]
GROUPS = {"domains": [k for body in DOMAINS for k in body]}
GROUPS["linkers"] = [k for k in range(len(SEQUENCE)) if k not in GROUPS["domains"]]
BOND, STIFFNESS = 0.38, 8033.0  # nm, kJ/mol/nm²
EPSILON = 0.8368  # kJ/mol
TEMPERATURE, IONIC = 293.0, 0.15  # K, mol/l


def main() -> None:
    parser = argparse.ArgumentParser(description="A protein of two rigid domains and flexible linkers.")
    parser.add_argument("--steps", type=int, default=20000, metavar="N", help="steps of 20 fs (%(default)s)")
    parser.add_argument("--platform", default="CPU", metavar="NAME", help="OpenMM platform (%(default)s)")
    rb.Run.add_options(parser, "out/rigid_domains")
    args = parser.parse_args()
    try:
        run(args)
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"rigid_domains.py: {error}")


# ``bodies=`` lists the particles of each domain. Minimisation and dynamics preserve the shapes of the domains.


def run(args: argparse.Namespace) -> None:
    job = rb.Run.from_options(args, free=["steps"])
    job.add_reporter(app.DCDReporter, "trajectory.dcd", 50)
    job.add_reporter(rb.EnergyReporter, "energies.csv", 50)
    picture = job.path("protein.png")
    system = calvados2(SEQUENCE, TEMPERATURE, IONIC)
    pairs = rb.exclude_within(system, DOMAINS)
    integrator = rb.ExactRigidBodyLangevinIntegrator(
        TEMPERATURE * kelvin, 1 / picosecond, 20 * femtoseconds, bodies=DOMAINS
    )
    simulation = app.Simulation(topology_of(SEQUENCE), system, integrator, openmm.Platform.getPlatform(args.platform))
    simulation.context.setPositions(start())
    integrator.minimizeEnergy(maxIterations=100)
    integrator.setVelocitiesToTemperature(TEMPERATURE * kelvin, 1)
    job.advance(simulation, args.steps)

    x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value
    print(f"{pairs} pairs within domains are excluded")
    print(f"{len(SEQUENCE)} beads move as {len(integrator.bodyState()[0])} bodies")
    time = simulation.context.getTime().value_in_unit(unit.picosecond)
    print(f"radius of gyration {radius_of_gyration(system, x):.2f} nm after {time:.4g} ps")
    for name, (translation, rotation) in integrator.temperatures(groups=GROUPS).items():
        print(f"{name}: {translation._value:.0f} K of translation, {rotation._value:.0f} K of rotation")
    draw(x, picture)


# The model consists of springs between neighbours, the potential of Ashbaugh and Hatch up to 2 nm, and the potential of
# Debye and Hückel up to 4 nm; both potentials are shifted to zero at these cutoffs.


def calvados2(sequence: str, temperature: float, ionic: float) -> openmm.System:
    """Return the System of a chain at a temperature in K and an ionic strength in mol/l."""
    system, bonds = openmm.System(), openmm.HarmonicBondForce()
    contacts = openmm.CustomNonbondedForce(
        "select(step(r - 2^(1/6)*s), l*u, u + e*(1 - l)) - l*shift; shift = 4*e*((s/2)^12 - (s/2)^6);"
        "u = 4*e*((s/r)^12 - (s/r)^6); s = 0.5*(sigma1 + sigma2); l = 0.5*(lambda1 + lambda2)"
    )
    T = temperature
    permittivity = 5321.0 / T + 233.76 - 0.9297 * T + 1.417e-3 * T**2 - 8.292e-7 * T**3
    strength = 138.935458 / permittivity  # kJ/mol nm
    kT = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin) * temperature
    length = (8.0 * np.pi * strength / kT * 0.602214 * ionic) ** -0.5
    charges = openmm.CustomNonbondedForce("strength*q1*q2*(exp(-r/length)/r - exp(-4/length)/4)")
    contacts.addGlobalParameter("e", EPSILON)
    charges.addGlobalParameter("strength", strength)
    charges.addGlobalParameter("length", length)
    for name in ("sigma", "lambda"):
        contacts.addPerParticleParameter(name)
    charges.addPerParticleParameter("q")
    for force, cutoff in ((contacts, 2.0), (charges, 4.0)):
        force.setNonbondedMethod(force.CutoffNonPeriodic)
        force.setCutoffDistance(cutoff)
    for k, residue in enumerate(sequence):
        mass, stickiness, size, charge = RESIDUES[residue]
        system.addParticle(mass)
        contacts.addParticle([size, stickiness])
        charges.addParticle([charge])
        if k:
            bonds.addBond(k - 1, k, BOND, STIFFNESS)
            contacts.addExclusion(k - 1, k)
            charges.addExclusion(k - 1, k)
    for group, force in enumerate((bonds, contacts, charges)):  # on a GPU, each cutoff needs a separate group
        force.setForceGroup(group)
        system.addForce(force)
    return system


def start() -> np.ndarray:
    """Return initial positions (nm): the predicted positions of residues 11 to 179, and two coils that avoid them."""
    known = np.loadtxt(_HERE / "data" / "hnrnpa1_domains.csv", delimiter=",")[:, 1:]
    before = coil(known, known[0], 10)[::-1]
    known = np.vstack([before, known])
    return np.vstack([known, coil(known, known[-1], len(SEQUENCE) - len(known))])


def coil(others: np.ndarray, first: np.ndarray, n: int) -> np.ndarray:
    """Return a helix of n positions that continues from `first`, spaced by `BOND` and oriented away from the others."""
    turn, rise = 0.36, 0.05  # a turn of 1 nm in radius, 0.9 nm above the one before
    radius = np.sqrt(BOND**2 - rise**2) / (2.0 * np.sin(0.5 * turn))
    angle = turn * np.arange(1, n + 1)
    helix = np.column_stack([radius * (np.cos(angle) - 1.0), radius * np.sin(angle), rise * np.arange(1, n + 1)])
    rng = np.random.default_rng(1)
    turned = [first + helix @ Q.T for Q in quaternions.rotation_matrix(quaternions.random(rng, 500))]
    away = others[(others != first).any(axis=1)]
    return max(turned, key=lambda x: np.linalg.norm(x[:, None] - away, axis=2).min())


def radius_of_gyration(system: openmm.System, x: np.ndarray) -> float:
    """Return the mass-weighted radius of gyration in nm."""
    masses = np.array([system.getParticleMass(k)._value for k in range(len(x))])
    arms = x - masses @ x / masses.sum()
    return float(np.sqrt(masses @ (arms**2).sum(axis=1) / masses.sum()))


def topology_of(sequence: str) -> app.Topology:
    topology = app.Topology()
    chain, before = topology.addChain(), None
    for residue in sequence:
        atom = topology.addAtom("CA", app.element.carbon, topology.addResidue(residue, chain))
        if before is not None:
            topology.addBond(before, atom)
        before = atom
    return topology


def draw(x: np.ndarray, file: Path) -> None:
    """Draw the chain with coloured domains."""
    figure = plt.figure(figsize=(6.4, 5.6), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    axes.plot(*x.T, color="0.6", lw=1.0)
    for body, colour in zip(DOMAINS, ("#0072B2", "#D55E00"), strict=True):
        axes.scatter(*x[list(body)].T, s=40, color=colour, depthshade=True)
    axes.set_aspect("equal")
    axes.set_xlabel("x (nm)")
    axes.set_ylabel("y (nm)")
    axes.set_zlabel("z (nm)")
    axes.set_title("Two rigid domains and flexible linkers")
    figure.savefig(file, dpi=150)


# %%
# An average of the radius of gyration requires a run of hundreds of nanoseconds (see the tutorial).

if __name__ == "__main__":
    main()
