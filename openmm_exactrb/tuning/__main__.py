"""The command: python -m openmm_exactrb.tuning system.xml state.xml --target 1e-4."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import openmm

from openmm_exactrb.schemes import CATALOGUE
from openmm_exactrb.tuning import CANDIDATES, tune
from openmm_exactrb.tuning.advice import progress


def main(arguments: Sequence[str] | None = None) -> int:
    """Tune for serialised System and State; return the exit status, 1 if the target is not reached."""
    args = _parser().parse_args(arguments)
    try:
        result = tune(
            _read(args.system, openmm.System),
            _read(args.state, openmm.State),
            target=args.target,
            schemes=args.schemes,
            temperature=args.temperature,
            platform=args.platform,
            horizon=args.horizon,
            duration=args.duration,
            report=None if args.quiet else progress,
        )
        if args.output is not None:
            result.draw(args.output)
    except (ValueError, ArithmeticError, OSError, ModuleNotFoundError, openmm.OpenMMException) as error:
        print(f"tune: {error}", file=sys.stderr)
        return 2
    print(result.to_json() if args.json else result)
    return 0 if args.target is None or result.chosen is not None else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m openmm_exactrb.tuning",
        description="Find the cheapest scheme and step for a wanted energy error.",
    )
    add = parser.add_argument
    add("system", type=Path, help="the System, written by openmm.XmlSerializer")
    add("state", type=Path, help="a State with positions and velocities, written by openmm.XmlSerializer")
    add("--target", type=float, help="wanted standard deviation of the total energy, kJ/mol a body")
    add("--schemes", nargs="+", metavar="NAME", help=f"of {', '.join(CATALOGUE)} ({' '.join(CANDIDATES)})")
    add("--platform", metavar="NAME", help="OpenMM platform (the fastest)")
    add("--temperature", type=float, metavar="K", help="draw velocities; needed where those of the State are zero")
    add("--horizon", type=float, metavar="PS", help="length of the runs for which errors are promised, ps")
    add("--duration", type=float, metavar="PS", help="length of the runs of the survey, ps (from the forces)")
    add("--output", type=Path, metavar="FILE", help="a picture of error over cost; needs matplotlib")
    add("--json", action="store_true", help="print JSON instead of text")
    add("--quiet", action="store_true", help="no line a run on stderr")
    return parser


def _read(file: Path, kind: type[Any]) -> Any:
    text = file.read_text()
    try:
        content = openmm.XmlSerializer.deserialize(text)
    except (openmm.OpenMMException, ValueError) as error:
        raise ValueError(f"{file} was not written by openmm.XmlSerializer: {error}") from None
    if not isinstance(content, kind):
        raise ValueError(f"{file} holds a {type(content).__name__}, not a {kind.__name__}")
    return content


if __name__ == "__main__":
    sys.exit(main())
