"""The command ``exactrb``, with its subcommands and one-line error messages."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence

import openmm

import openmm_exactrb
from openmm_exactrb.command import exec as exec_
from openmm_exactrb.command import info, run, tune
from openmm_exactrb.command.arguments import Parser
from openmm_exactrb.errors import BudgetSpentError

# Exceptions caused by a user's files and options.
_ERRORS = (ValueError, ArithmeticError, OSError, ModuleNotFoundError, BudgetSpentError, openmm.OpenMMException)
_NOBODY_READS = 141  # the exit status after SIGPIPE, a signal that Windows lacks
_COMMANDS = {"run": run, "exec": exec_, "tune": tune, "info": info}


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute a command line, by default that of the process, and return its exit status.

    The exit status is 0 on success, 1 if `exactrb tune` misses its target, 2 after an error, 130 after Ctrl-C, and 141
    if the program that reads the output has ended. `exactrb exec` has the exit status of its script. Errors are printed
    as one line on stderr.
    """
    args = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        warnings.showwarning = _warning_of(args.command)
        return _status(args)


def _warning_of(command: str) -> Callable[..., None]:
    """Return a function that prints a warning as one line on stderr."""

    def show(message: Warning | str, *_place: object) -> None:
        print(f"exactrb {command}: warning: {' '.join(str(message).split())}", file=sys.stderr)

    return show


def _status(args: argparse.Namespace) -> int:
    """Execute a command and return its exit status; print an error as one line on stderr."""
    try:
        status = int(_COMMANDS[args.command].carry_out(args))
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the program that reads the output, such as head, has ended
        _end_output()
        return _NOBODY_READS
    except _ERRORS as error:
        _end_output()
        print(f"exactrb {args.command}: {_told(error)}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, SystemError) as error:
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise  # not the SystemError to which OpenMM's wrapper converts the KeyboardInterrupt of Ctrl-C
        again = "; to resume the run, repeat the command with --resume" if args.command == "run" else ""
        begin = "\n" if sys.stderr.isatty() else ""  # ends the line that shows ^C or a progress bar
        print(f"{begin}exactrb {args.command}: SIGINT: stopped{again}", file=sys.stderr)
        return 128 + signal.SIGINT


def _end_output() -> None:
    """Write the rest of the output, or discard it if this is impossible, so that Python does not fail at its exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _told(error: Exception) -> str:
    """Return the message of an error as one line, without the error number of an OSError."""
    if isinstance(error, FileNotFoundError) and error.filename:
        return f"the file {error.filename} does not exist"
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def _parser() -> Parser:
    parser = Parser(prog="exactrb", description="Rigid-body dynamics with OpenMM and the exact free rotation.")
    parser.add_argument("--version", action="version", version=f"openmm-exactrb {openmm_exactrb.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, module in _COMMANDS.items():
        module.add_options(commands.add_parser(name, help=module.PURPOSE, description=module.PURPOSE))
    return parser


if __name__ == "__main__":
    sys.exit(main())
