"""The subcommand ``exactrb tune``: `openmm_exactrb.tune` for files."""

from __future__ import annotations

import argparse
from pathlib import Path

import openmm

from openmm_exactrb.schemes import CATALOGUE
from openmm_exactrb.states import read_xml
from openmm_exactrb.tuning.advice import CANDIDATES, progress, tune

#: The help text of the subcommand.
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
    add("--json", action="store_true", help="print JSON instead of text")
    add("--quiet", action="store_true", help="no line per run on stderr")


def carry_out(args: argparse.Namespace) -> int:
    """Tune for a serialised System and State, and print the result.

    Parameters
    ----------
    args : argparse.Namespace
        With the options of `add_options`.

    Returns
    -------
    int
        The exit status, 1 if the target is not reached.

    Raises
    ------
    ValueError, ArithmeticError, OSError, ModuleNotFoundError, openmm.OpenMMException
        If a file or an option does not fit.
    """
    if args.output is not None:
        _refuse_picture(args.output)
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
    print(result.to_json() if args.json else result, flush=True)
    if args.output is not None:
        result.draw(args.output)
    return 0 if args.target is None or result.chosen is not None else 1


def _refuse_picture(file: Path) -> None:
    """Raise ValueError, OSError or ModuleNotFoundError, before all measurements, if the picture cannot be written."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            "--output needs matplotlib: python -m pip install matplotlib", name="matplotlib"
        ) from None
    kinds = FigureCanvasAgg.get_supported_filetypes()
    if file.suffix and file.suffix[1:].lower() not in kinds:
        raise ValueError(f"--output {file} is no picture: let it end with one of {', '.join(sorted(kinds))}")
    is_new = not file.exists()
    with file.open("ab"):
        pass
    if is_new:
        file.unlink()
