"""The subcommand ``exactrb exec``, which runs a Python script with integrators of this package instead of OpenMM's."""

from __future__ import annotations

import argparse
import errno
import os
import runpy
import sys
import threading
import traceback
from pathlib import Path
from types import TracebackType

from openmm_exactrb.command import arguments
from openmm_exactrb.replacement import replace_integrators

#: The purpose of the subcommand, in one sentence.
PURPOSE = (
    "Run a Python script in which LangevinMiddleIntegrator, LangevinIntegrator and VerletIntegrator of OpenMM are "
    "integrators of this package with the same arguments."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments for the step, the script and its arguments."""
    parser.usage = "%(prog)s [options] script.py [arguments of the script]"
    add = parser.add_argument
    interval = (
        "step of all these integrators, with a unit such as 8fs, instead of the steps of the script; the script makes "
        "as many steps as before"
    )
    add("--interval", type=arguments.time_with_unit, metavar="T", help=interval)
    same = (
        "keep the simulated time: divide numbers of steps, and the intervals of reporters and barostats, by the ratio "
        "of the steps; an error if a number of steps cannot be divided"
    )
    add("--same-time", action="store_true", help=same)
    heavy = "let the hydrogens of each System that createSystem returns have 3 amu, including those of water"
    add("--heavy-hydrogens", action="store_true", help=heavy)
    add("script", metavar="script.py", help="the script")
    add("arguments", nargs=argparse.REMAINDER, help="arguments of the script")


def carry_out(args: argparse.Namespace) -> int:
    """Run the script and return its exit status, which is 1 after an error that Python would print."""
    script = Path(args.script)
    if not script.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), args.script)
    options = {"same_time": args.same_time, "heavy_hydrogens": args.heavy_hydrogens}
    with replace_integrators(args.interval, **options, report=_tell):
        try:
            _run(script, args.arguments)
        except Exception as error:
            error.__traceback__ = _within(script, error)
            traceback.print_exception(error)
            return 1
    return 0


def _run(script: Path, given: list[str]) -> None:
    """Run a script as Python does, until its last thread ends."""
    before = sys.argv, sys.path[:]
    sys.argv = [str(script), *given]
    sys.path[0] = str(script.resolve().parent)
    try:
        runpy.run_path(str(script), run_name="__main__")
    finally:
        for thread in threading.enumerate():
            if not thread.daemon and thread is not threading.current_thread():
                thread.join()
        sys.argv, sys.path[:] = before


def _within(script: Path, error: Exception) -> TracebackType | None:
    """Return the traceback of an error from the first line of the script on, as Python prints it."""
    trace = found = error.__traceback__
    while found is not None and found.tb_frame.f_code.co_filename != str(script):
        found = found.tb_next
    return found or trace


def _tell(text: str) -> None:
    print(f"exactrb exec: {text}", file=sys.stderr)
