"""The subcommand ``exactrb tune``, which applies `openmm_exactrb.tune` to files."""

from __future__ import annotations

import argparse

from openmm_exactrb.command import arguments, inputs
from openmm_exactrb.openmm_access.platforms import platform_of
from openmm_exactrb.tuning.advice import BUDGET, CANDIDATES, progress, tune

#: The purpose of the subcommand, in one sentence.
PURPOSE = "Find the cheapest scheme and step for a given energy error."

_TEMPERATURE = 300.0


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments for molecules and for tuning."""
    inputs.add_options(parser)
    positive, time = arguments.positive, arguments.time
    add = parser.add_argument_group("tuning").add_argument
    add("--target", type=positive, metavar="X", help="target standard deviation of the total energy, kJ/mol per body")
    add("--schemes", nargs="+", metavar="NAME", help=f"schemes to try (default: {', '.join(CANDIDATES)})")
    add(
        "--temperature",
        type=positive,
        metavar="K",
        help=f"temperature to which the start is brought, K (default without velocities: {_TEMPERATURE:g})",
    )
    add(
        "--horizon",
        type=time,
        metavar="T",
        help="length of the runs for which errors are predicted, in ps, or with a unit such as 30ps",
    )
    add(
        "--budget",
        type=positive,
        default=BUDGET,
        metavar="S",
        help="limit on the processor time, s (default: %(default)g)",
    )
    add(
        "--duration",
        type=time,
        metavar="T",
        help="length of the survey runs, in ps, or with a unit (default: from the forces and the budget)",
    )
    arguments.add_seed_and_platform(add, "velocities and noise")
    add("--quiet", action="store_true", help="do not print a line for each run")


def carry_out(args: argparse.Namespace) -> int:
    """Tune for the given molecules and print the result; return 1 if the target is not reached, otherwise 0."""
    platform = platform_of(args.platform)
    box = inputs.load(inputs.with_defaults(args))
    inputs.check_idle(args, box)
    result = tune(
        box.system,
        box.positions if box.state is None else box.state,
        target=args.target,
        schemes=args.schemes,
        temperature=args.temperature if box.moves else args.temperature or _TEMPERATURE,
        platform=platform,
        horizon=args.horizon,
        budget=args.budget,
        duration=args.duration,
        seed=args.seed,
        report=None if args.quiet else progress,
    )
    print(result, flush=True)
    return 0 if args.target is None or result.chosen is not None else 1
