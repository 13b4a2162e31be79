"""The subcommand ``exactrb run``: a trajectory of a user's own system."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import openmm
from openmm import app

from openmm_exactrb.baths.words import splitting
from openmm_exactrb.command import arguments, boxes, ensembles, outcome, prepared
from openmm_exactrb.command.progress import Progress
from openmm_exactrb.context.platforms import mixed, platform_of
from openmm_exactrb.reporters import EnergyReporter
from openmm_exactrb.rotors import ROTORS
from openmm_exactrb.runs import Run
from openmm_exactrb.schemes import WITH_BATH
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.tuning import CANDIDATES

#: What it is for, in one sentence.
PURPOSE = "Run a simulation: trajectory, energies and a picture in a folder; --resume goes on after any accident."

_TRAJECTORIES = {"dcd": app.DCDReporter, "xtc": app.XTCReporter}
# What may differ where a run goes on: files and force field are known by the System that they make.
_FREE = ("command", "duration", "files", "forcefield", "picture", "quiet")
# Of options that not every run takes: one that is named where it does nothing is refused.
_DEFAULTS: dict[str, Any] = {
    "cutoff": 0.9,
    "ewald_tolerance": 1e-5,
    "constraints": "none",
    "temperature": 300.0,
    "friction": 1.0,
    "pressure": 1.0,
    "target": 1e-3,
    "equilibration": 5.0,
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Give a command line its arguments and options."""
    _add_what_moves(parser.add_argument_group("what moves"))
    _add_how(parser.add_argument_group("how it moves"))
    _add_files(parser)


def _add_what_moves(group: Any) -> None:
    add = group.add_argument
    add("files", nargs="*", type=Path, metavar="FILE", help="a PDB or PDBx file, or system.xml and state.xml of OpenMM")
    add("--forcefield", nargs="+", default=[], metavar="FILE", help="force field files, as openmm.app.ForceField takes")
    add("--solvate", type=arguments.count, metavar="N", help="put N molecules of water around it; alone without a file")
    add("--water", choices=boxes.WATERS, help="water model for --solvate (the one that a force field is named after)")
    add("--cutoff", type=arguments.positive, metavar="NM", help=f"of PME, in a periodic box, nm {_default('cutoff')}")
    add(
        "--ewald-tolerance",
        type=arguments.positive,
        metavar="X",
        help=f"ewaldErrorTolerance {_default('ewald_tolerance')}",
    )
    add("--constraints", choices=boxes.CONSTRAINTS, help=f"beside rigid water {_default('constraints')}")


def _add_how(group: Any) -> None:
    add = group.add_argument
    add("--ensemble", choices=ensembles.ENSEMBLES, default="nve", help="constant energy, temperature, pressure (nve)")
    add("--temperature", type=arguments.positive, metavar="K", help=f"K {_default('temperature')}")
    add("--friction", type=arguments.positive, metavar="X", help=f"of nvt and npt, 1/ps {_default('friction')}")
    add("--pressure", type=arguments.positive, metavar="BAR", help=f"of npt, bar {_default('pressure')}")
    add("--duration", type=arguments.time, default=10.0, metavar="T", help="ps, or such as 1ns (%(default)s)")
    add(
        "--step",
        type=arguments.time_or_auto,
        metavar="T",
        help="a whole step of the scheme, ps, or such as 4fs; auto measures scheme and step (auto)",
    )
    add("--target", type=arguments.positive, metavar="X", help=f"error for auto, kJ/mol per body {_default('target')}")
    add("--scheme", metavar="NAME", help=f"splitting scheme; auto tries {', '.join(CANDIDATES)}")
    add("--rotor", choices=ROTORS, default="exact", metavar="NAME", help=f"free rotation: {', '.join(ROTORS)} (exact)")
    add(
        "--equilibration",
        type=arguments.time_or_zero,
        metavar="T",
        help=f"of a start without velocities, ps, or such as 5ps {_default('equilibration')}",
    )
    add("--seed", type=arguments.seed, default=1, metavar="N", help="of velocities, noise and barostat (%(default)s)")
    add("--platform", metavar="NAME", help="OpenMM platform (the fastest)")


def _add_files(parser: argparse.ArgumentParser) -> None:
    Run.add_options(parser, "out/run")
    add = parser.add_argument
    add("--trajectory", choices=_TRAJECTORIES, default="dcd", help="format (%(default)s)")
    add("--interval", type=arguments.time, default=0.1, metavar="T", help="between frames and lines, ps (%(default)s)")
    add("--no-picture", dest="picture", action="store_false", help="draw none at the end")
    add("--quiet", action="store_true", help="nothing on stderr but errors")


def _default(name: str) -> str:
    return f"({_DEFAULTS[name]})"


def _refuse_scheme(args: argparse.Namespace) -> None:
    """Raise ValueError if there is no such scheme in the ensemble, or it cannot be measured."""
    if args.scheme is None:
        return
    (look_up if args.ensemble == "nve" else splitting)(args.scheme)
    if args.step is None and args.scheme in WITH_BATH:
        raise ValueError(f"--step auto measures without a bath, and {args.scheme} has one within it: give a --step.")


def _with_defaults(args: argparse.Namespace) -> argparse.Namespace:
    """Return the options with those that were not named."""
    named = {name: value for name, value in vars(args).items() if value is not None}
    return argparse.Namespace(**vars(args) | _DEFAULTS | named)


def _refuse_idle(args: argparse.Namespace, box: boxes.Box) -> None:
    """Raise ValueError if an option was named that does nothing."""
    for name, why in _idle(args, box):
        if getattr(args, name) is not None:
            raise ValueError(f"leave out --{name.replace('_', '-')}: {why}")


def _idle(args: argparse.Namespace, box: boxes.Box) -> Iterator[tuple[str, str]]:
    """Yield the options that do nothing to a run, and why."""
    if box.state is not None:
        for name in ("constraints", "cutoff", "ewald_tolerance", "water"):
            yield name, "a System has its forces and constraints already"
    if box.topology.getPeriodicBoxVectors() is None:
        for name in ("cutoff", "ewald_tolerance"):
            yield name, "there is no cutoff without a periodic box"
    if not args.solvate:
        yield "water", "it is the water of --solvate"
    if args.ensemble != "npt":
        yield "pressure", "only --ensemble npt has one"
    if args.ensemble == "nve":
        yield "friction", "only --ensemble nvt and npt have one"
    if args.step is not None:
        yield "target", "only --step auto has one"
    if box.moves:
        yield "equilibration", "a State with velocities is taken as it is"
    if box.moves and args.ensemble == "nve":
        yield "temperature", "a State with velocities is taken as it is"


def carry_out(args: argparse.Namespace) -> int:
    """Run what the options describe; return the exit status 0.

    Raises
    ------
    ValueError, ArithmeticError, OSError, openmm.OpenMMException
        With what is to be done, in one sentence.
    SystemExit
        After a signal, with a checkpoint written.
    """
    settled = _with_defaults(args)
    job = Run.from_options(settled, free=_FREE)
    _refuse_scheme(args)
    platform = platform_of(args.platform)
    box = boxes.load(settled)
    _refuse_idle(args, box)
    ensembles.couple(box.system, settled)
    with job.alone():
        prepared.claim(job, settled, box, platform, [*_reporters(settled), outcome.PICTURE])
        _simulate(job, settled, box, platform)
    return 0


def _simulate(job: Run, args: argparse.Namespace, box: boxes.Box, platform: openmm.Platform) -> None:
    """Prepare a run, carry it out, and print and draw what came of it."""
    start = prepared.start_of(job, args, box, platform)
    options, step = prepared.step_of(job, args, box, start, platform)
    ensembles.pace(box.system, step)
    integrator = ensembles.integrator_of(args, options, step)
    simulation = app.Simulation(box.topology, box.system, integrator, platform, mixed(platform))
    boxes.begin_at(simulation, start)

    for name, maker in _reporters(args).items():
        job.add_reporter(maker, name, max(1, round(args.interval / step)))
    steps = math.ceil(args.duration / step - 1e-9)
    tell = Progress(f"{args.ensemble}, {simulation.integrator.getScheme().name}", steps, step, args.quiet)
    job.advance(simulation, steps, tell)
    tell.close()
    if args.picture:
        outcome.draw(job.folder, args.ensemble, simulation.integrator.degreesOfFreedom(), job.folder / outcome.PICTURE)
    print("\n".join(outcome.summary(simulation, job, args.ensemble)))


def _reporters(args: argparse.Namespace) -> dict[str, Callable[..., Any]]:
    """Return what makes the reporter of each file."""
    reporters = {f"trajectory.{args.trajectory}": _TRAJECTORIES[args.trajectory], outcome.ENERGIES: EnergyReporter}
    if args.ensemble == "npt":
        reporters[outcome.VOLUME] = partial(app.StateDataReporter, step=True, time=True, volume=True, density=True)
    return reporters
