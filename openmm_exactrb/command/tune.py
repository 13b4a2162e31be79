"""The subcommand ``exactrb tune``: `openmm_exactrb.tune` for files."""

from __future__ import annotations

import argparse
from pathlib import Path

import openmm

from openmm_exactrb.schemes import CATALOGUE
from openmm_exactrb.states import read_xml
from openmm_exactrb.tuning.advice import CANDIDATES, progress, tune

#: The purpose, in one sentence.
PURPOSE = "Find the cheapest scheme and step for a wanted energy error."


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments and options of `tune`."""
    add = parser.add_argument
    add("system", type=Path, help="the System, written by openmm.XmlSerializer")
    add("state", type=Path, help="a State with positions and velocities, written by openmm.XmlSerializer")
    add("--target", type=float, help="wanted standard deviation of the total energy, kJ/mol per body")
    add("--schemes", nargs="+", metavar="NAME", help=f"of {', '.join(CATALOGUE)} ({' '.join(CANDIDATES)})")
    add("--platform", metavar="NAME", help="OpenMM platform (the fastest)")
    add("--temperature", type=float, metavar="K", help="draw velocities; needed if those of the State are zero")
    add("--horizon", type=float, metavar="PS", help="length of the runs for which errors are promised, ps")
    add("--duration", type=float, metavar="PS", help="length of the runs of the survey, ps (from the forces)")
    add("--output", type=Path, metavar="FILE", help="a picture of error against cost; needs matplotlib")
    add("--quiet", action="store_true", help="no line per run on stderr")


def carry_out(args: argparse.Namespace) -> int:
    """Tune for a serialised System and State and print the result; return 1 if the target is not reached, else 0."""
    result = tune(
        read_xml(args.system, openmm.System),
        read_xml(args.state, openmm.State),
        target=args.target,
        schemes=args.schemes,
        temperature=args.temperature,
        platform=args.platform,
        horizon=args.horizon,
        duration=args.duration,
        report=None if args.quiet else progress,
    )
    print(result, flush=True)
    if args.output is not None:
        result.draw(args.output)
    return 0 if args.target is None or result.chosen is not None else 1
