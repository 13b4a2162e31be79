"""
The dielectric constant of a Stockmayer fluid
=============================================

The system is a box of Lennard-Jones spheres with point dipoles, whose periodic images are included by an Ewald sum. All
momenta are redrawn every half picosecond, so that the run samples the canonical ensemble. The dielectric constant
follows from the fluctuations of the total dipole moment. The picture shows its running estimate with the standard error
from block averages, and the value that LAMMPS gives for the same state. ``--long-range "reaction field"`` truncates the
dipole interactions instead, which gives the same dielectric constant within errors for weak dipoles (``--dipole2 1``).

With ``--core wca --density 0.05 --temperature 1``, the spheres only repel each other; this is a ferrofluid in a state
for which values have been published. Its short chains rotate slowly, so use ``--duration 10000 --step 0.03``.

Units are reduced: sigma, epsilon and the mass of a sphere are 1 nm, 1 kJ/mol and 1 amu, and times are in ps. After
Ctrl-C, a kill or a full disk, the same command with ``--resume`` continues the run.

The picture is from ``python examples/dielectric_constant.py``, which simulates dipoles of mu² = 3 for 2000 ps. The
dielectric constant is 63.4 ± 2.3, compared with 64.6 ± 1.8 from LAMMPS. The mean of six longer runs is 66.4 ± 0.7
(:doc:`/tutorials/dielectric`).

.. image:: /pictures/dielectric_constant.png
   :alt: Running estimate of the dielectric constant over 2000 ps with its error band, next to the value of LAMMPS
"""

# sphinx_gallery_thumbnail_path = "pictures/dielectric_constant.png"

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit
from tqdm import tqdm

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt

KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
# The dielectric constant of the Stockmayer fluid and its standard error, for (density, kT, mu²), from LAMMPS with an
# Ewald sum of 125 dipoles in 400000 and 150000 steps (benchmarks/dipoles/dielectric_lammps.py).
LAMMPS = "LAMMPS, Ewald sum of 125 dipoles"
EWALD = {(0.822, 1.15, 3.0): [(LAMMPS, 64.6, 1.8)], (0.822, 1.15, 1.0): [(LAMMPS, 7.51, 0.16)]}
# The same for WCA spheres, at a volume fraction of 0.0262 and lambda = 3: Z. Wang, C. Holm and H. W. Müller, Phys. Rev.
# E 66, 021405 (2002), table 1, as quoted in ESPResSo's tutorial on ferrofluids.
FERROFLUID = {
    (0.05, 1.0, 3.0): [
        ("Wang, Holm and Müller (2002)", 1.822, 0.017),
        ("ESPResSo", 1.86, 0.0),
    ]
}
BOUNDARIES = {"ewald": rb.Ewald(), "reaction field": rb.ReactionField()}
NAMES = {"ewald": "Ewald sum", "reaction field": "reaction field"}
DRAW = 0.5  # ps between two draws of the momenta
SAMPLE = 0.05  # ps between two moments


def main() -> None:
    args = parse()
    try:
        picture = rb.Run.from_options(args).path("dielectric_constant.png")
        moments, volume = simulate(args)
    except (ValueError, ArithmeticError, ImportError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"dielectric_constant.py: {error}")
    times, values, errors = running(moments[:, 0] - args.equilibration, moments[:, 1:], volume, args.temperature)
    references = known(args)
    print(f"dielectric constant {values[-1]:.4g} +- {errors[-1]:.2g} from {args.duration:g} ps")
    for name, value, error in references:
        print(f"{name}: {value:.4g}" + (f" +- {error:.2g}" if error else ""))
    draw(times, values, errors, args.long_range, references, picture)
    print(f"{args.out}: moments.csv, energies.csv, dielectric_constant.png")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="The dielectric constant of dipolar spheres.")
    add = parser.add_argument
    add("-n", type=int, default=125, metavar="N", help="number of spheres (%(default)s)")
    add("--density", type=positive, default=0.822, metavar="RHO", help="spheres per nm^3 (%(default)s)")
    add("--temperature", type=positive, default=1.15, metavar="KT", help="kT, kJ/mol (%(default)s)")
    add("--dipole2", type=positive, default=3.0, metavar="MU2", help="square of the dipole, kJ/mol nm^3 (%(default)s)")
    add("--core", choices=("lennard-jones", "soft", "wca"), default="lennard-jones", help="%(default)s")
    add("--long-range", choices=BOUNDARIES, default="ewald", help="treatment of distant dipoles (%(default)s)")
    add("--step", type=positive, default=0.0125, metavar="H", help="size of a whole step of S2_2, ps (%(default)s)")
    add("--equilibration", type=float, default=40.0, metavar="T", help="equilibration at the start, ps (%(default)s)")
    add("--duration", type=positive, default=2000.0, metavar="T", help="length of the run after it, ps (%(default)s)")
    add("--seed", type=int, default=0, metavar="S", help="seed of positions and momenta (%(default)s)")
    add("--platform", default="Reference", metavar="NAME", help="OpenMM platform (%(default)s)")
    rb.Run.add_options(parser, "out/dielectric_constant")
    return parser.parse_args()


def positive(text: str) -> float:
    value = float(text)
    if not (np.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def simulate(args: argparse.Namespace) -> tuple[np.ndarray, float]:
    """Return times (ps) and moments after the equilibration, as an array (n, 4), and the volume (nm³)."""
    strength = args.dipole2**0.5
    topology, system, positions = rb.dipole_fluid(
        args.n,
        args.seed,
        dipole=(0.0, 0.0, strength),
        inertia=(0.2, 0.2, 0.2),
        attraction=0.0 if args.core == "soft" else 1.0,
        wca=args.core == "wca",
        boundary=BOUNDARIES[args.long_range],
        density=args.density,
        # On a GPU, OpenMM computes the forces if possible.
        kernel="auto" if args.long_range == "ewald" or args.platform in ("Reference", "CPU") else "bonds",
    )
    job = rb.Run.from_options(args, free=("duration",))
    interval = max(1, round(SAMPLE / args.step))
    moments = partial(rb.MomentReporter, charges=charges(topology, strength))
    job.add_reporter(moments, "moments.csv", interval)
    job.add_reporter(rb.EnergyReporter, "energies.csv", max(1, round(DRAW / args.step)))

    integrator = rb.ExactRigidBodyIntegrator(args.step, scheme="S2_2")
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform(args.platform))
    simulation.context.setPositions(positions)
    if not job.resuming:
        openmm.LocalEnergyMinimizer.minimize(simulation.context, 100.0, 50)  # no pair of the lattice too close
    integrator.setVelocitiesToTemperature(args.temperature / KB, args.seed)
    simulation.reporters.append(rb.CanonicalMomenta(args.temperature / KB, max(1, round(DRAW / args.step)), args.seed))
    steps = round((args.equilibration + args.duration) / args.step)
    with tqdm(total=steps, desc=f"{args.n} dipoles", unit="step", mininterval=2.0, delay=1.0) as bar:
        job.advance(simulation, steps, progress=bar.update)
    table = np.loadtxt(job.folder / "moments.csv", delimiter=",", skiprows=1, ndmin=2)[:, 1:]
    return table[table[:, 0] > args.equilibration], args.n / args.density


def charges(topology: app.Topology, strength: float, length: float = 0.5) -> np.ndarray:
    """Return the charges at the centres C and the tips D that represent the dipoles."""
    ends = {"C": -strength / length, "D": strength / length}
    return np.array([ends.get(atom.name, 0.0) for atom in topology.atoms()])


def running(times: np.ndarray, moments: np.ndarray, volume: float, kT: float) -> tuple[np.ndarray, ...]:
    """Return times (ps), the estimate from the run up to each time, and its standard error."""
    ends = np.linspace(len(times) / 50, len(times), 50).astype(int)
    estimates = [rb.dielectric_constant(moments[:end], volume, kT, blocks=min(20, end)) for end in ends if end > 1]
    return times[ends[ends > 1] - 1], *np.array(estimates).T


def known(args: argparse.Namespace) -> list[tuple[str, float, float]]:
    """Return names, values and errors of the available reference values."""
    state = args.density, args.temperature, args.dipole2
    if args.core == "lennard-jones" and state in EWALD:
        return EWALD[state]
    if args.core == "wca" and state in FERROFLUID:
        return FERROFLUID[state]
    y = 4.0 * np.pi * args.density * args.dipole2 / (9.0 * args.temperature)
    return [("Clausius and Mossotti", (1.0 + 2.0 * y) / (1.0 - y), 0.0)] if y < 1.0 else []


def draw(
    times: np.ndarray,
    values: np.ndarray,
    errors: np.ndarray,
    long_range: str,
    references: list[tuple[str, float, float]],
    file: Path,
) -> None:
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    axes.fill_between(times, values - errors, values + errors, color="#0072B2", alpha=0.25, lw=0)
    axes.plot(times, values, color="#0072B2", lw=1.6, label=f"this package, {NAMES[long_range]}, ± standard error")
    for (name, value, error), colour, line in zip(references, ("#D55E00", "#009E73"), ("-", "--"), strict=False):
        axes.axhline(value, color=colour, ls=line, lw=1.4, label=name)
        axes.axhspan(value - error, value + error, color=colour, alpha=0.15, lw=0)
    axes.set_xlabel("time after equilibration (ps)")
    axes.set_ylabel("dielectric constant")
    axes.set_title("Running estimate of the dielectric constant")
    axes.grid(True, alpha=0.3)
    axes.legend(loc="best", fontsize=9)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
