"""
A Stockmayer fluid of a thousand dipoles
========================================

Lennard-Jones spheres with a strong point dipole, mu² = 3, at density 0.822 and kT = 1.15, form a strongly polar liquid.
The picture shows its structure:

- g(r), the density of spheres at a distance r, and
- h110(r), three times the mean cosine of the angle between two dipoles, times g(r). In an infinite sample its integral
  is Kirkwood's factor g_K, with (eps - 1)(2 eps + 1)/(9 eps) = y g_K and y = 4 pi rho mu²/(9 kT). In a periodic box
  with an Ewald sum, h110 has a tail that extends over the whole box, so that the fluctuation formula eps = 1 + 3 y G
  needs the sum G over the whole box.

Units are reduced: sigma, epsilon and the mass of a sphere are 1 nm, 1 kJ/mol and 1 amu, and times are in ps. After
Ctrl-C, a kill or a full disk, the same command with ``--resume`` continues the run.

The first peak of g(r) is at 1.05 sigma. The peak height is 2.61, and h110 there is 1.93. At half the edge of the box,
5.3 sigma, the sum of cosines is 6.1; the moment of the whole box gives 7.3.

The picture is from ``python examples/stockmayer_fluid.py``, whose dielectric constant is 66.8 ± 5.9. ``--draw
benchmarks/records/stockmayer_fluid.csv stockmayer_fluid.png`` draws it from the stored record, the file
``structure.csv`` of that run.

.. image:: /pictures/stockmayer_fluid.png
   :alt: Top, g(r) and h110(r). Bottom, the sum of cosines, which still grows at half the edge of the box
"""

# sphinx_gallery_thumbnail_path = "pictures/stockmayer_fluid.png"

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

import matplotlib as mpl
import mdtraj
import numpy as np
import openmm
from openmm import app, unit
from scipy.spatial import cKDTree
from tqdm import tqdm

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt

KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
DENSITY, KT, MU2 = 0.822, 1.15, 3.0
Y = 4.0 * np.pi * DENSITY * MU2 / (9.0 * KT)
STEP = 0.015  # ps, with one force evaluation
CUTOFF = 3.5  # of the attraction, sigma, or half of a smaller box
SAMPLE = 4  # steps between two moments


def main() -> None:
    args = parse()
    if args.draw:
        draw(*args.draw)
        return
    try:
        job = rb.Run.from_options(args, free=("duration", "draw"))
        table, picture = job.path("structure.csv"), job.path("stockmayer_fluid.png")
        moments, frames, edge = simulate(args, job)
    except (ValueError, ArithmeticError, ImportError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"stockmayer_fluid.py: {error}")
    value, error = rb.dielectric_constant(moments, edge**3, KT, blocks=min(10, len(moments)))
    r, g, h110, total = correlations(frames[:: 1 + len(frames) // max(8, 30_000 // args.n)], edge)
    columns = np.transpose((r, g, h110, total, np.full_like(r, (value - 1.0) / (3.0 * Y))))
    np.savetxt(table, columns, "%.3f", ",", header="r,g,h110,sum_of_cosines,whole_box", comments="")
    print(f"dielectric constant of {args.n} dipoles from {args.duration:g} ps: {value:.1f} +- {error:.1f}")
    draw(table, picture)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="The structure and the dielectric constant of a Stockmayer fluid.")
    add = parser.add_argument
    add("-n", type=int, default=1000, metavar="N", help="number of dipoles (%(default)s)")
    add("--equilibration", type=float, default=15.0, metavar="T", help="equilibration at the start, ps (%(default)s)")
    add("--duration", type=float, default=200.0, metavar="T", help="length of the run after it, ps (%(default)s)")
    add("--seed", type=int, default=0, metavar="S", help="seed of positions, momenta and noise (%(default)s)")
    add("--draw", type=Path, nargs=2, metavar=("CSV", "PNG"), help="draw a file structure.csv again, without a run")
    rb.Run.add_options(parser, "out/stockmayer_fluid")
    return parser.parse_args()


def simulate(args: argparse.Namespace, job: rb.Run) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the total moments (n, 3), positions of centres and tips (frames, n, 2, 3), and the edge of the box."""
    edge = (args.n / DENSITY) ** (1.0 / 3.0)
    topology, system, positions = rb.dipole_fluid(
        args.n,
        args.seed,
        dipole=(0.0, 0.0, MU2**0.5),
        inertia=(0.2, 0.2, 0.2),
        attraction=1.0,
        density=DENSITY,
        boundary=rb.Ewald(tolerance=1e-3),
        sphere_cutoff=min(CUTOFF, 0.5 * edge),
    )
    ends = {"C": -(MU2**0.5) / 0.5, "D": MU2**0.5 / 0.5}  # charges of the dipole, half a nm apart
    charges = [ends.get(atom.name, 0.0) for atom in topology.atoms()]
    frame = 40 * max(1, args.n // 1000)  # steps between two frames
    job.add_reporter(partial(rb.MomentReporter, charges=charges), "moments.csv", SAMPLE)
    job.add_reporter(app.DCDReporter, "trajectory.dcd", frame)
    integrator = rb.ExactRigidBodyLangevinIntegrator(KT / KB, 0.5, STEP, "BAOA")
    integrator.setRandomNumberSeed(args.seed + 1)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    if not job.resuming:
        openmm.LocalEnergyMinimizer.minimize(simulation.context, 100.0, 50)  # no pair of the lattice too close
    integrator.setVelocitiesToTemperature(KT / KB, args.seed)
    steps = round((args.equilibration + args.duration) / STEP)
    with tqdm(total=steps, desc=f"{args.n} dipoles", unit="step", mininterval=2.0, delay=1.0) as bar:
        job.advance(simulation, steps, progress=bar.update)
    first = args.equilibration / STEP
    table = np.loadtxt(job.folder / "moments.csv", delimiter=",", skiprows=1, ndmin=2)
    trajectory = mdtraj.load(str(job.folder / "trajectory.dcd"), top=mdtraj.Topology.from_openmm(topology))
    frames = trajectory.xyz.reshape(len(trajectory), args.n, -1, 3)[:, :, -2:].astype(np.float64)
    return table[table[:, 0] > first, 2:5], frames[int(first / frame) + 1 :], edge


def correlations(frames: np.ndarray, edge: float, width: float = 0.02) -> tuple[np.ndarray, ...]:
    """Return distances, g(r), h110(r), and sums of cosines up to each distance, including 1 for the dipole itself."""
    bounds = np.arange(0.8, 0.5 * edge, width)
    pairs, cosines = np.zeros(len(bounds) - 1), np.zeros(len(bounds) - 1)
    for sites in frames:
        u = sites[:, 1] - sites[:, 0]
        u -= edge * np.round(u / edge)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        tree = cKDTree(sites[:, 0] % edge, boxsize=edge)
        for some in np.array_split(np.arange(len(u)), 1 + len(u) // 500):  # not all pairs in memory at once
            part = cKDTree(sites[some, 0] % edge, boxsize=edge)
            found = part.sparse_distance_matrix(tree, bounds[-1], output_type="ndarray")
            i, j, d = some[found["i"]], found["j"], found["v"]
            pairs += np.histogram(d, bounds)[0]
            cosines += np.histogram(d, bounds, weights=np.einsum("ij,ij->i", u[i], u[j]))[0]
    shells = 4.0 * np.pi / 3.0 * np.diff(bounds**3) * DENSITY * frames.shape[0] * frames.shape[1]
    kirkwood = 1.0 + np.cumsum(cosines) / (frames.shape[0] * frames.shape[1])
    return 0.5 * (bounds[1:] + bounds[:-1]), pairs / shells, 3.0 * cosines / shells, kirkwood


def draw(table: Path, file: Path) -> None:
    r, g, h110, total, whole_box = np.loadtxt(table, delimiter=",", skiprows=1, unpack=True)
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(5.6, 7.0), sharex=True, layout="constrained")
    upper.plot(r, g, color="#0072B2", lw=1.6, label="g(r)")
    upper.plot(r, h110, color="#D55E00", lw=1.6, label="h110(r)")
    upper.axhline(0.0, color="0.6", lw=0.8)
    upper.axhline(1.0, color="0.6", lw=0.8, ls=":")
    upper.legend()
    upper.set_title("Density of spheres, and order of their dipoles")
    lower.plot(r, total, color="#009E73", lw=1.6, label="1 + sum of the cosines up to a distance")
    lower.plot(r, whole_box, color="0.3", lw=1.4, ls=":", label="whole box, from its moment")
    lower.legend()
    lower.set_xlabel("distance (sigma)")
    lower.set_title("The sum still grows at half the edge of the box")
    for axes in (upper, lower):
        axes.grid(True, alpha=0.3)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
