"""
Chains in a ferrofluid
======================

The system consists of magnetic particles at a volume fraction of 2.6 %: repulsive WCA spheres with point dipoles, whose
periodic images are included by an Ewald sum. With lambda = mu²/kT = 8, two particles in contact, head to tail, are
bound by 15.7 kT. Initially separate particles form chains and rings.

The picture shows the box at the end, with a colour for each of the eight largest clusters, and the growth of the mean
cluster size. Units are reduced: diameter, epsilon and mass of a particle are 1 nm, 1 kJ/mol and 1 amu, and times are in
ps. After Ctrl-C, a kill or a full disk, the same command with ``--resume`` continues the run.

The picture is from ``python examples/ferrofluid.py -n 500 --duration 30``: after 30 ps, the particles form eleven
clusters, of up to 168 particles, which differ between machines and numbers of threads.

.. image:: /pictures/ferrofluid_chains.png
   :alt: Chains and rings of dipoles in a box, and the mean size of clusters, which grows over 30 ps
"""

# sphinx_gallery_thumbnail_path = "pictures/ferrofluid_chains.png"

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib as mpl
import mdtraj
import numpy as np
import openmm
from openmm import app, unit
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from tqdm import tqdm

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt

KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
DENSITY, KT = 0.05, 1.0
STEP = 0.01  # ps
BOUND = 8.0  # kT, the least dipolar attraction between neighbours in a chain
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C510A", "#35978F")


def main() -> None:
    args = parse()
    try:
        picture = rb.Run.from_options(args).path("ferrofluid.png")
        frames, edge = simulate(args)
    except (ValueError, ArithmeticError, ImportError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"ferrofluid.py: {error}")
    found = [clusters(sites, edge, args.coupling) for sites in frames]
    sizes = [args.n / count for count, *_ in found]
    print(f"mean size of a cluster: {sizes[0]:.2f} at the start, {sizes[-1]:.2f} after {args.duration:g} ps")
    draw(frames[-1], edge, found[-1], np.linspace(0.0, args.duration, len(sizes)), sizes, args, picture)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Chains of magnetic particles.")
    add = parser.add_argument
    add("-n", type=int, default=1000, metavar="N", help="number of particles (%(default)s)")
    add("--coupling", type=float, default=8.0, metavar="LAMBDA", help="mu²/kT (%(default)s)")
    add("--duration", type=float, default=100.0, metavar="T", help="length of the run, ps (%(default)s)")
    add("--seed", type=int, default=0, metavar="S", help="seed of positions, momenta and noise (%(default)s)")
    rb.Run.add_options(parser, "out/ferrofluid")
    return parser.parse_args()


def simulate(args: argparse.Namespace) -> tuple[np.ndarray, float]:
    """Return the positions of centres and tips (frames, n, 2, 3), and the edge of the box, in nm."""
    topology, system, positions = rb.dipole_fluid(
        args.n,
        args.seed,
        dipole=(0.0, 0.0, (args.coupling * KT) ** 0.5),
        inertia=(0.2, 0.2, 0.2),
        attraction=1.0,
        wca=True,
        density=DENSITY,
        boundary=rb.Ewald(tolerance=1e-3),
    )
    job = rb.Run.from_options(args, free=("duration",))
    job.add_reporter(app.DCDReporter, "trajectory.dcd", 50)
    integrator = rb.ExactRigidBodyLangevinIntegrator(KT / KB, 0.5, STEP, "BAOA")
    integrator.setRandomNumberSeed(args.seed + 1)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    integrator.setVelocitiesToTemperature(KT / KB, args.seed)
    steps = round(args.duration / STEP)
    with tqdm(total=steps, desc=f"{args.n} particles", unit="step", mininterval=2.0, delay=1.0) as bar:
        job.advance(simulation, steps, progress=bar.update)
    trajectory = mdtraj.load(str(job.folder / "trajectory.dcd"), top=mdtraj.Topology.from_openmm(topology))
    frames = trajectory.xyz.reshape(len(trajectory), args.n, -1, 3)[:, :, -2:].astype(np.float64)
    return frames, (args.n / DENSITY) ** (1.0 / 3.0)


def clusters(sites: np.ndarray, edge: float, coupling: float) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the number of clusters, the index of the cluster of each particle (n,), and the bound pairs (m, 2)."""
    u = nearest(sites[:, 1] - sites[:, 0], edge)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    r = nearest(sites[:, None, 0] - sites[None, :, 0], edge)
    d = np.linalg.norm(r, axis=2) + 1e3 * np.eye(len(sites))
    along = np.einsum("ik,ijk->ij", u, r) * np.einsum("jk,ijk->ij", u, r) / d**2
    energy = coupling * (u @ u.T - 3.0 * along) / d**3  # in kT
    bound = energy < -BOUND
    count, of = connected_components(csr_array(bound), directed=False)
    return count, of, np.argwhere(np.triu(bound))


def nearest(vectors: np.ndarray, edge: float) -> np.ndarray:
    """Return the vectors to the nearest periodic images."""
    return vectors - edge * np.round(vectors / edge)


def draw(
    sites: np.ndarray,
    edge: float,
    found: tuple[int, np.ndarray, np.ndarray],
    times: np.ndarray,
    sizes: list[float],
    args: argparse.Namespace,
    file: Path,
) -> None:
    count, of, pairs = found
    centres = sites[:, 0] % edge
    members = np.bincount(of)
    largest = np.argsort(-members)[: len(COLOURS)]
    colours = np.full(count, "#BBBBBB", dtype=object)
    colours[largest] = COLOURS[: len(largest)]
    figure = plt.figure(figsize=(7.0, 4.0), layout="constrained")
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.5, 1.0))
    axes = figure.add_subplot(left, projection="3d")
    for i, j in pairs:
        step = nearest(centres[j] - centres[i], edge)
        axes.plot(*np.array([centres[i], centres[i] + step]).T, color=colours[of[i]], lw=1.8)
    axes.scatter(*centres.T, c=list(colours[of]), s=5, depthshade=False)
    axes.set(xlim=(0.0, edge), ylim=(0.0, edge), zlim=(0.0, edge))
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.15)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_ticklabels([])
    axes.set_title(f"after {args.duration:g} ps; the largest of {count} clusters has {members.max()}", fontsize=10)
    growth = figure.add_subplot(right)
    growth.plot(times, sizes, color="#0072B2", lw=1.8)
    growth.set_xlabel("time (ps)")
    growth.set_title("particles per cluster, mean", fontsize=10)
    growth.grid(True, alpha=0.3)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
