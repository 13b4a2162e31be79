"""
A nematic liquid crystal by compression
=======================================

These ellipsoids are three times as long as they are thick, and interact by the Gay-Berne potential GB(3, 5, 2, 1), at
kT = 1. A barostat compresses them in stages. At the first pressure, the initial lattice of parallel ellipsoids melts
into an isotropic liquid. At the last pressure the liquid is nematic: the axes are aligned, but the centres are not
ordered. E. de Miguel et al., Mol. Phys. 74, 405 (1991), doi:10.1080/00268979100102321, found isotropic, nematic and
smectic B phases of this model, and the nematic phase only above kT = 0.8.

The order parameter S is the largest eigenvalue of Q, the mean of (3 u u - 1)/2 over the axes u; it is 1 if all axes are
parallel. If the centres formed layers, the largest density wave of the box with a wavelength from 1.5 to 5 would have
an amplitude near 1. For comparison, the script prints both numbers for random axes and centres of n ellipsoids.

Units are reduced: diameter, epsilon and mass of an ellipsoid are 1 nm, 1 kJ/mol and 1 amu, and times are in ps. After
Ctrl-C, a kill or a full disk, the same command with ``--resume`` continues the run.

The picture is from ``python examples/ellipsoids.py --pressures 2 3 4 5 --duration 400``: the order parameter is 0.09 at
the first pressure and 0.78 at the last.

.. image:: /pictures/ellipsoids.png
   :alt: Order parameter in four stages of rising pressure, below 0.2 in the first two, above 0.7 in the others
"""

# sphinx_gallery_thumbnail_path = "pictures/ellipsoids.png"

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib as mpl
import mdtraj
import numpy as np
import openmm
from openmm import app, unit
from tqdm import tqdm

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt

KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
BAR = (1.0 * unit.kilojoule_per_mole / unit.nanometer**3 / unit.AVOGADRO_CONSTANT_NA).value_in_unit(unit.bar)
KT = 1.0
STEP = 0.01  # ps, with one force evaluation
FRAME = 25  # steps between two frames
BLOCKS = 5  # of a stage, for errors
QUANTITIES = "density", "S", "largest wave"
WAVES = np.arange(-6, 7)  # along each axis, in 2 pi/edge


def main() -> None:
    args = parse()
    try:
        picture = rb.Run.from_options(args).path("ellipsoids.png")
        table = rb.Run.from_options(args).path("ellipsoids.csv")
        axes, centres, edges = simulate(args)
    except (ValueError, ArithmeticError, ImportError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"ellipsoids.py: {error}")
    S = np.array([order(u) for u in axes])
    waves = np.array([largest_wave(x, edge) for x, edge in zip(centres, edges, strict=True)])
    stages = summarised([args.n / edges**3, S, waves], args)
    rows = [f"{p:g},{d:.4f},{de:.4f},{s:.3f},{se:.3f},{w:.3f},{we:.3f}" for p, (d, de), (s, se), (w, we) in stages]
    table.write_text("\n".join(["pressure,density,error_density,S,error_S,largest_wave,error_largest_wave", *rows, ""]))
    for pressure, *found in stages:
        values = (f"{name} {value:.4f} +- {error:.4f}" for name, (value, error) in zip(QUANTITIES, found, strict=True))
        print(f"pressure {pressure:g}: {', '.join(values)}")
    rng = np.random.default_rng(0)
    random = np.mean([order(u / np.linalg.norm(u, axis=1)[:, None]) for u in rng.standard_normal((200, args.n, 3))])
    gas = np.mean([largest_wave(edges[-1] * rng.random((args.n, 3)), edges[-1]) for _ in range(20)])
    print(f"{args.n} random axes and centres: S {random:.3f}, largest wave {gas:.3f}")
    draw(S, axes[-1], centres[-1], edges[-1], stages, random, args, picture)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Ellipsoids of Gay and Berne, compressed to a nematic liquid.")
    add = parser.add_argument
    add("-n", type=int, default=288, metavar="N", help="number of ellipsoids (%(default)s)")
    add("--pressures", type=float, nargs="+", default=[2.0, 5.0], metavar="P", help="one per stage, in reduced units")
    add("--duration", type=float, default=600.0, metavar="T", help="length of a stage, ps (%(default)s)")
    add("--seed", type=int, default=0, metavar="S", help="seed of positions, momenta and noise (%(default)s)")
    rb.Run.add_options(parser, "out/ellipsoids")
    return parser.parse_args()


def simulate(args: argparse.Namespace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the axes and the centres, each (frames, n, 3), and the edges of the box (frames,)."""
    topology, system, positions = rb.ellipsoids(args.n, args.seed)
    system.addForce(openmm.MonteCarloBarostat(args.pressures[0] * BAR, KT / KB, 20))
    job = rb.Run.from_options(args)
    job.add_reporter(app.DCDReporter, "trajectory.dcd", FRAME)
    integrator = rb.ExactRigidBodyLangevinIntegrator(KT / KB, 0.5, STEP, "BAOA")
    integrator.setRandomNumberSeed(args.seed + 1)
    system.getForces()[-1].setRandomNumberSeed(args.seed + 1)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    integrator.setVelocitiesToTemperature(KT / KB, args.seed)
    steps = round(args.duration / STEP)
    for stage, pressure in enumerate(args.pressures, 1):
        simulation.context.setParameter(openmm.MonteCarloBarostat.Pressure(), pressure * BAR)
        with tqdm(total=stage * steps, desc=f"up to pressure {pressure:g}", unit="step", mininterval=2.0) as bar:
            job.advance(simulation, stage * steps, progress=bar.update)
    trajectory = mdtraj.load(str(job.folder / "trajectory.dcd"), top=mdtraj.Topology.from_openmm(topology))
    sites = trajectory.xyz.reshape(len(trajectory), args.n, -1, 3)[:, :, -2:].astype(np.float64)
    edges = trajectory.unitcell_lengths[:, 0].astype(np.float64)
    u = sites[:, :, 1] - sites[:, :, 0]
    u -= edges[:, None, None] * np.round(u / edges[:, None, None])
    return u / np.linalg.norm(u, axis=2, keepdims=True), sites[:, :, 0], edges


def order(u: np.ndarray) -> float:
    """Return the order parameter of axes (n, 3), the largest eigenvalue of Q."""
    return float(np.linalg.eigvalsh(1.5 * u.T @ u / len(u) - 0.5 * np.eye(3))[-1])


def largest_wave(centres: np.ndarray, edge: float) -> float:
    """Return the largest amplitude, at most 1, of the density waves of the box with wavelengths from 1.5 to 5."""
    x, y, z = np.exp(2j * np.pi / edge * centres.T[:, :, None] * WAVES)
    amplitudes = np.abs(np.einsum("na,nb,nc->abc", x, y, z, optimize=True)) / len(centres)
    with np.errstate(divide="ignore"):
        lengths = edge / np.linalg.norm(np.meshgrid(WAVES, WAVES, WAVES), axis=0)
    return float(amplitudes[(lengths > 1.5) & (lengths < 5.0)].max())


def summarised(quantities: list[np.ndarray], args: argparse.Namespace) -> list[tuple]:
    """Return the pressure of each stage, and means and errors of quantities (frames,) in blocks of its second half."""
    frames = round(args.duration / STEP / FRAME)
    stages = []
    for k, pressure in enumerate(args.pressures):
        second = slice(k * frames + frames // 2 + 1, (k + 1) * frames + 1)
        blocks = [[b.mean() for b in np.array_split(a[second], BLOCKS)] for a in quantities]
        stages.append((pressure, *((np.mean(b), np.std(b, ddof=1) / BLOCKS**0.5) for b in blocks)))
    return stages


def draw(
    S: np.ndarray,
    u: np.ndarray,
    centres: np.ndarray,
    edge: float,
    stages: list[tuple],
    random: float,
    args: argparse.Namespace,
    file: Path,
) -> None:
    figure = plt.figure(figsize=(10.0, 4.6), layout="constrained")
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.25, 1.0))
    axes = figure.add_subplot(left)
    axes.plot(np.arange(len(S)) * FRAME * STEP, S, color="#0072B2", lw=1.0)
    axes.axhline(random, color="0.5", lw=1.0, ls=":")
    for k, (pressure, (density, _), (value, _), _) in enumerate(stages):
        axes.axvline(k * args.duration, color="0.8", lw=0.8)
        axes.text((k + 0.5) * args.duration, 1.02, f"P {pressure:g}\nρ {density:.3f}\nS {value:.2f}", ha="center")
    axes.set_ylim(0.0, 1.2)
    axes.set_xlabel("time (ps)")
    axes.set_ylabel("order parameter S")
    axes.set_title("Compression; dotted: random axes", fontsize=11)
    turn = np.linalg.eigh(u.T @ u)[1]  # the director upwards
    centres, u = centres % edge @ turn, u @ turn
    box = figure.add_subplot(right, projection="3d")
    colours = plt.get_cmap("viridis_r")(np.abs(u[:, 2]))
    for c, d, colour in zip(centres, u, colours, strict=True):
        box.plot(*np.array([c - 1.2 * d, c + 1.2 * d]).T, color=colour, lw=3.0, solid_capstyle="round")
    box.set_box_aspect((1.0, 1.0, 1.0), zoom=1.1)
    box.set_axis_off()
    box.set_title("The end, coloured by the angle with the director", fontsize=11)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
