"""The subcommand ``exactrb run``, which simulates a user's system."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

import openmm
from openmm import app

from openmm_exactrb.averages import PressureOffset, pressure_offset
from openmm_exactrb.command import analysis, arguments, equilibration, inputs, progress, setup
from openmm_exactrb.integrators.integrator import DEFAULT
from openmm_exactrb.library.library import missing
from openmm_exactrb.openmm_access.platforms import mixed, platform_of
from openmm_exactrb.reporters import EnergyReporter
from openmm_exactrb.runs import Run
from openmm_exactrb.schemes import WITH_THERMOSTAT, Scheme, splitting
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.thermostats import Langevin
from openmm_exactrb.tuning.advice import BUDGET, CANDIDATES

#: The purpose of the subcommand, in one sentence.
PURPOSE = (
    "Run a simulation, and write a trajectory, energies and a picture to a folder; --resume continues an "
    "interrupted run."
)

_TRAJECTORIES = {"dcd": app.DCDReporter, "xtc": app.XTCReporter}
# Options that may differ when a run is resumed. Files and the force field are compared through the System that they
# define.
_FREE = ("command", "duration", "files", "forcefield", "picture", "quiet")
# Defaults of options that raise an error if a run does not use them.
_DEFAULTS: dict[str, Any] = {
    "temperature": 300.0,
    "friction": 1.0,
    "pressure": 1.0,
    "target": 1e-3,
    "budget": BUDGET,
    "equilibrate": None,  # see `equilibration.length_of`
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of ``exactrb run``."""
    inputs.add_options(parser)
    _add_dynamics(parser.add_argument_group("dynamics").add_argument)
    Run.add_options(parser, "out/run")
    add = parser.add_argument
    trajectory = arguments.one_of(_TRAJECTORIES)
    add("--trajectory", **trajectory, default="dcd", help="trajectory format (default: %(default)s)")
    interval = "time between frames, and between lines of energies, ps (default: %(default)s)"
    add("--interval", type=arguments.time, default=0.1, metavar="T", help=interval)
    add("--no-picture", dest="picture", action="store_false", help="draw no picture at the end")
    add("--quiet", action="store_true", help="print only errors on stderr")


def _add_dynamics(add: Callable[..., Any]) -> None:
    """Add the arguments of the ensemble, the times and the integrator."""
    positive, shown = arguments.positive, {name: f"(default: {of})" for name, of in _DEFAULTS.items()}
    ensembles = arguments.one_of(setup.ENSEMBLES)
    add(
        "--ensemble",
        **ensembles,
        default="nve",
        help="constant energy, temperature, or temperature and pressure (default: %(default)s)",
    )
    add("--temperature", type=positive, metavar="K", help=f"temperature, K {shown['temperature']}")
    add("--friction", type=positive, metavar="X", help=f"friction of nvt and npt, 1/ps {shown['friction']}")
    add("--pressure", type=positive, metavar="BAR", help=f"pressure of npt, bar {shown['pressure']}")
    offset = (
        "averages.csv of a run at constant volume, from which the step-size error of the barostat's pressure is "
        "corrected"
    )
    add("--pressure-offset", metavar="CSV", help=offset)
    add(
        "--duration",
        type=arguments.time,
        default=10.0,
        metavar="T",
        help="length of the run, in ps, or with a unit such as 1ns (default: %(default)s)",
    )
    add(
        "--step",
        type=arguments.time_or_auto,
        metavar="T",
        help="time step with a unit such as 4fs, or auto to tune the step (default: auto)",
    )
    between = "time between two force evaluations, with a unit such as 2fs, instead of --step"
    add("--force-interval", type=arguments.time_with_unit, metavar="T", help=between)
    add("--target", type=positive, metavar="X", help=f"energy error for --step auto, kJ/mol per body {shown['target']}")
    add("--budget", type=positive, metavar="S", help=f"processor time for --step auto, s {shown['budget']}")
    add("--scheme", metavar="NAME", help=f"splitting scheme; --step auto tries {', '.join(CANDIDATES)}")
    for name, option in setup.OPTIONS:
        add(arguments.flag(name), dest=name, **option)
    start = (
        "length of the equilibration of a start without velocities, in ps, or with a unit such as 5ps (default: a "
        "fifth of --duration, at most 5 ps)"
    )
    add("--equilibrate", type=arguments.time_or_zero, metavar="T", help=start)
    arguments.add_seed_and_platform(add, "velocities, noise and barostat")


def carry_out(args: argparse.Namespace) -> int:
    """Run the simulation that the options describe; return the exit status 0."""
    settled = inputs.with_defaults(args, _DEFAULTS)
    if args.resume and not args.files and not args.solvate:
        raise ValueError(
            f"--resume needs the files and options with which the run in {args.out} was started: repeat the command "
            "that started the run, and add --resume"
        )
    job = Run.from_options(settled, free=_FREE)
    scheme = _scheme_of(args)
    if args.force_interval is not None:
        if args.step is not None:
            raise ValueError("--step and --force-interval are mutually exclusive: omit one of these options")
        args.step = settled.step = args.force_interval * scheme.forces
    platform = platform_of(args.platform)
    offset = None if args.pressure_offset is None else pressure_offset(args.pressure_offset)
    box = inputs.load(settled)
    inputs.check_idle(args, box, _idle(args, box))
    setup.couple(box.system, settled)
    with job.lock():
        equilibration.claim(job, settled, [*_reporters(settled), analysis.PICTURE])
        _simulate(job, settled, box, platform, offset)
    return 0


def _scheme_of(args: argparse.Namespace) -> Scheme:
    """Return the scheme, by default the one of the ensemble; raise ValueError if it is unknown or cannot be tuned."""
    known, default = (look_up, DEFAULT) if args.ensemble == "nve" else (splitting, Langevin.scheme)
    scheme = known(args.scheme or default)
    if args.step is None and args.force_interval is None and args.scheme in WITH_THERMOSTAT:
        raise ValueError(
            f"--step auto tunes at constant energy, but {args.scheme} contains a thermostat: set --step to a time "
            "such as 4fs"
        )
    return scheme


def _idle(args: argparse.Namespace, box: inputs.Box) -> list[tuple[bool, str, str]]:
    """Return conditions, each with the options that have no effect under it and the reason."""
    return [
        (args.ensemble != "npt", "pressure pressure_offset", "without --ensemble npt"),
        (args.ensemble == "nve", "friction", "without --ensemble nvt or npt"),
        (args.step is not None, "target budget", "without --step auto"),
        (box.moves, "equilibrate", "because a State with velocities is used unchanged"),
        (box.moves and args.ensemble == "nve", "temperature", "because a State with velocities is used unchanged"),
    ]


def _simulate(
    job: Run,
    args: argparse.Namespace,
    box: inputs.Box,
    platform: openmm.Platform,
    offset: PressureOffset | None,
) -> None:
    """Equilibrate the system, run the simulation, and print and draw the results."""
    with progress.waiting("compiling the library", args.quiet):
        missing()  # compiles it, once on a machine
    start = equilibration.start_of(job, args, box, platform)
    options, step = equilibration.step_of(job, args, box, start, platform)
    setup.pace(box.system, step)
    integrator = setup.integrator_of(args, options, step)
    setup.correct_pressure(box.system, offset, integrator, args.temperature)
    simulation = app.Simulation(box.topology, box.system, integrator, platform, mixed(platform))
    inputs.begin_at(simulation, start)

    for name, reporter in _reporters(args).items():
        job.add_reporter(reporter, name, max(1, round(args.interval / step)))
    steps = integrator.stepsFor(args.duration)
    print(f"{args.duration:g} ps are {steps} steps of {integrator!r}", flush=True)
    with progress.counted(f"{args.ensemble}, {integrator.getScheme().name}", steps, "step", args.quiet) as tell:
        job.advance(simulation, steps, tell)
    if args.picture:
        analysis.draw(job.folder, args.ensemble)
    print("\n".join(analysis.summary(simulation, job, args.ensemble)))


def _reporters(args: argparse.Namespace) -> dict[str, Callable[..., Any]]:
    """Return the reporter class of each output file."""
    reporters = {f"trajectory.{args.trajectory}": _TRAJECTORIES[args.trajectory], analysis.ENERGIES: EnergyReporter}
    if args.ensemble == "npt":
        reporters[analysis.VOLUME] = partial(app.StateDataReporter, step=True, time=True, volume=True, density=True)
    return reporters
