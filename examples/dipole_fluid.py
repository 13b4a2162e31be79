"""
A droplet of dipoles
====================

The splitting with exact free rotation was first published for this system: soft spheres with point dipoles, which repel
each other as :math:`1/r^{12}`. A kernel of this package, or OpenMM on a GPU, computes the forces. The script writes a
trajectory (DCD, with its topology as PDB), the energies (CSV, every digit of float64) and a picture of the energy
error, and prints the cost of the run.

With ``--compare`` the script makes two runs from the same initial state with the same number of force evaluations: one
with the exact rotation and a scheme of order 4, the other with the usual combination of velocity Verlet and the
McLachlan-Reich rotation. This page shows ``python examples/dipole_fluid.py -n 64 --duration 6 --compare``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit
from tqdm import tqdm

import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt

# Strong enough to hold the droplet together, weak compared with the forces between neighbours.
TRAP = 0.5
KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


# %%
# Before the simulation, ``main`` checks that no file of an earlier run would be replaced. Errors are printed in one
# line.


@dataclass
class Outcome:
    """The results of one run."""

    scheme: str
    rotor: str
    h: float
    evaluations: int
    times: np.ndarray
    energies: np.ndarray
    wall: float
    forces: float
    rotation: float

    @property
    def errors(self) -> np.ndarray:
        """Relative errors of the total energy."""
        return (self.energies - self.energies[0]) / abs(self.energies[0])


def main() -> None:
    args = parse()
    try:
        if args.paper:
            print("The paper's lattice is compressed, about 4 epsilon a contact: it flies apart.")
        picture = rb.Run.from_options(args).path("energy_error.png")
        if args.compare:
            rb.Run.from_options(args, "compare")  # raises an error before any simulation is run
        runs = [simulate(args, args.scheme, args.rotor, args.step)]
        if args.compare:
            # The same initial state and the same number of force evaluations.
            h = args.step / rb.SCHEMES[args.scheme].forces
            runs.append(simulate(args, "V2", "mclachlan_reich", h, "compare"))
    except (ValueError, ArithmeticError, OSError, openmm.OpenMMException) as error:
        sys.exit(f"dipole_fluid.py: {error}")
    draw(runs, picture)
    report(runs, args.out)


class Parser(argparse.ArgumentParser):
    """A parser with one-line error messages."""

    def error(self, message: str) -> NoReturn:
        """Exit with one line, without the usage."""
        self.exit(2, f"{self.prog}: {message} (see --help)\n")


def parse() -> argparse.Namespace:
    parser = Parser(
        description="A droplet of soft dipolar spheres, with forces by a compiled kernel and exact rotation. After "
        "Ctrl-C, a kill or a full disk, the same command with --resume continues the run.",
        epilog="Units are OpenMM's: amu, nm, ps, kJ/mol; with sigma = epsilon = m = 1 they are the reduced units of "
        "the paper.",
    )

    def names(what: Mapping[str, object]) -> str:
        return f"{', '.join(what)} (%(default)s)"

    add = parser.add_argument
    add("-n", type=whole, default=125, metavar="N", help="number of spheres (%(default)s)")
    add("--scheme", choices=rb.SCHEMES, default="SRKN4_6b", metavar="NAME", help="scheme: " + names(rb.SCHEMES))
    add("--rotor", choices=rb.ROTORS, default="exact", metavar="NAME", help="free rotation: " + names(rb.ROTORS))
    add("--step", type=positive, default=0.02, metavar="H", help="size of a whole step of the scheme, ps (%(default)s)")
    add("--duration", type=positive, default=20.0, metavar="T", help="length of the run, ps (%(default)s)")
    add("--temperature", type=positive, default=0.1, metavar="KT", help="kT of the first momenta, kJ/mol (%(default)s)")
    add("--energy", type=finite, metavar="E", help="total energy of the start, kJ/mol, instead of a temperature")
    add(
        "--paper",
        action="store_true",
        help="the paper's start: lattice constant 1, no trap, at rest but for the first and the last sphere, whose "
        "momenta give --energy. It is compressed, about 4 epsilon a contact, and flies apart",
    )
    add("--trap", type=not_negative, default=TRAP, metavar="K", help="harmonic trap, kJ/mol/nm^2 (%(default)s)")
    add("--seed", type=natural, default=0, metavar="S", help="seed of positions, orientations, momenta (%(default)s)")
    add("--platform", default="Reference", metavar="NAME", help="OpenMM platform (%(default)s)")
    add("--frames", type=whole, default=200, metavar="N", help="frames and lines to write (%(default)s)")
    add("--compare", action="store_true", help="then the same start with V2 and McLachlan-Reich, at the same cost")
    rb.Run.add_options(parser)
    return parser.parse_args()


def number(kind: type, description: str, fits: Callable[[float], bool]) -> Callable[[str], float]:
    """Return an argparse type for numbers within a range."""

    def convert(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not (np.isfinite(value) and fits(value)):
            raise argparse.ArgumentTypeError(f"{text!r} is not a {description}")
        return value

    return convert


whole = number(int, "whole number of at least 1", lambda value: value >= 1)
natural = number(int, "whole number of at least 0", lambda value: value >= 0)
positive = number(float, "positive number", lambda value: value > 0.0)
not_negative = number(float, "number of at least 0", lambda value: value >= 0.0)
finite = number(float, "finite number", lambda value: True)


# %%
# This is an ordinary OpenMM simulation. :class:`openmm_exactrb.Run` attaches the reporters, writes checkpoints, and
# resumes from the last checkpoint after an interruption.


def simulate(args: argparse.Namespace, scheme: str, rotor: str, h: float, subfolder: str = "") -> Outcome:
    """Run one scheme from the start that the options describe, or from its checkpoint."""
    steps = max(1, round(args.duration / h))
    interval = max(1, steps // args.frames)
    job = rb.Run.from_options(args, subfolder, free=("compare", "duration", "frames"))
    job.add_reporter(app.DCDReporter, "trajectory.dcd", interval)
    job.add_reporter(rb.EnergyReporter, "energies.csv", interval)

    geometry = {"spacing": 1.0} if args.paper else {"trap": args.trap}
    kernel = "auto" if args.platform in ("Reference", "CPU") else "openmm"  # a GPU computes its own forces
    topology, system, positions = rb.dipole_fluid(args.n, args.seed, kernel=kernel, **geometry)
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, rotor=rotor)
    simulation = app.Simulation(topology, system, integrator, platform(args.platform))
    simulation.context.setPositions(positions)
    set_momenta(simulation.context, args, integrator)

    pause = 0.1 if sys.stderr.isatty() else 5.0
    with tqdm(total=steps, desc=f"{scheme} + {rotor}", unit="step", mininterval=pause, delay=1.0) as bar:
        job.advance(simulation, steps, progress=bar.update)
    timings = integrator.timings
    table = np.loadtxt(job.folder / "energies.csv", delimiter=",", skiprows=1, ndmin=2)
    times, energies = table[:, 1], table[:, -1]
    return Outcome(scheme, rotor, h, timings.evaluations, times, energies, job.wall, timings.forces, timings.rotor)


def platform(name: str) -> openmm.Platform:
    names = [openmm.Platform.getPlatform(i).getName() for i in range(openmm.Platform.getNumPlatforms())]
    if name not in names:
        raise ValueError(f"there is no platform {name!r} here: choose one of {', '.join(names)}")
    return openmm.Platform.getPlatform(name)


def set_momenta(context: openmm.Context, args: argparse.Namespace, integrator: rb.ExactRigidBodyIntegrator) -> None:
    """Draw the momenta of the spheres at a temperature, or set them so that the total energy has a given value."""
    potential = context.getState(energy=True).getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
    if args.energy is not None and not args.energy > potential:
        raise ValueError(
            f"--energy {args.energy} is not above the potential energy of the start, {potential:.6g} kJ/mol"
        )
    if args.paper:
        velocities = np.zeros((context.getSystem().getNumParticles(), 3))
        if args.energy is not None:
            # The two spheres have opposite momenta along the diagonal: m v² = E - V.
            sites = len(velocities) // args.n
            speed = np.sqrt(args.energy - potential)
            velocities[:sites] = -speed / np.sqrt(3.0)
            velocities[-sites:] = speed / np.sqrt(3.0)
        context.setVelocities(velocities)
        return
    context.setVelocitiesToTemperature(args.temperature / KB, args.seed + 1)
    if args.energy is not None:
        kinetic = sum(e._value for e in integrator.kineticEnergies())
        velocities = context.getState(velocities=True).getVelocities(asNumpy=True)._value
        context.setVelocities(velocities * np.sqrt((args.energy - potential) / kinetic))


# %%
# The remaining code prints and draws the results.


def report(runs: list[Outcome], out: Path) -> None:
    """Print the cost and the energy error of the runs."""
    print(
        f"\n{'scheme + rotor':<26}{'step':>9}{'forces':>8}{'max error':>11}{'at end':>11}   wall: forces, rotor, rest"
    )
    for run in runs:
        parts = run.forces, run.rotation, run.wall - run.forces - run.rotation
        shares = "".join(f"{100 * part / run.wall:6.0f} %" for part in parts) if run.forces else "  shares not measured"
        print(
            f"{run.scheme + ' + ' + run.rotor:<26}{run.h:>9.4g}{run.evaluations:>8}{abs(run.errors).max():>11.1e}"
            f"{run.errors[-1]:>11.1e}{run.wall:7.1f} s:{shares}"
        )
    print(f"\n{out}: trajectory.dcd, topology.pdb, energies.csv, energy_error.png")


def draw(runs: list[Outcome], file: Path) -> None:
    """Draw the relative energy error over time, on a linear and on a logarithmic scale."""
    figure, (upper, lower) = plt.subplots(2, figsize=(7.0, 5.6), sharex=True, layout="constrained")
    for run, colour, over in zip(runs, ("#0072B2", "#D55E00"), (2, 1), strict=False):
        label = f"{run.scheme} + {run.rotor}: step {run.h:.2g} ps, {run.evaluations} force evaluations"
        upper.plot(run.times, 1e5 * run.errors, color=colour, lw=1.4, label=label, zorder=over)
        lower.semilogy(run.times[1:], np.abs(run.errors[1:]), color=colour, lw=1.0, zorder=over)
    upper.set_ylabel("relative energy error, $10^{-5}$")
    lower.set_ylabel("its size")
    lower.set_xlabel("time (ps)")
    figure.suptitle("Soft dipolar spheres: error of the total energy")
    for axes in (upper, lower):
        axes.grid(True, which="major", alpha=0.3)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", fontsize=9)
    figure.savefig(file, dpi=150)


# %%
# The step in the first line of the printed table is six times as long as the step in the second line, because the first
# scheme has six stages. The last columns show how the time is distributed: even in such a small droplet, the free
# rotation costs little.
#
# ``--paper`` starts from the lattice of the paper, which is compressed, so that the spheres fly apart. With
# ``boundary=rb.ReactionField()``, :func:`openmm_exactrb.dipole_fluid` creates a liquid in a periodic box.

if __name__ == "__main__":
    main()
