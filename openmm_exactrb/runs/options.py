"""Options of a command line for runs."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

_OWN = ("out", "overwrite", "resume", "checkpoint")


class Words(NamedTuple):
    """What a user is told to add, so that a run goes on or begins anew."""

    resume: str
    overwrite: str


#: Of a run that a script makes itself, and of one that a command line asks for.
IN_SCRIPT, ON_COMMAND_LINE = Words("resume=True", "overwrite=True"), Words("--resume", "--overwrite")


def add_options(parser: argparse.ArgumentParser, folder: str) -> None:
    """Give a command line the options --out, --overwrite, --resume and --checkpoint."""
    add = parser.add_argument
    add("--out", type=Path, default=Path(folder), metavar="DIR", help="output folder (%(default)s)")
    add("--overwrite", action="store_true", help="replace the files of an earlier run")
    add("--resume", action="store_true", help="go on from the last checkpoint of the same command")
    add("--checkpoint", type=float, default=60.0, metavar="S", help="seconds between checkpoints (%(default)s)")


def arguments_of(
    args: argparse.Namespace, subfolder: str, free: Iterable[str], settings: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the arguments of `Run` that options ask for; see `Run.from_options`."""
    kept = {name: value for name, value in vars(args).items() if name not in {*_OWN, *free}}
    return {
        "folder": args.out / subfolder,
        "resume": args.resume,
        "overwrite": args.overwrite,
        "every": args.checkpoint,
        "settings": kept | dict(settings or {}),
        "words": ON_COMMAND_LINE,
    }
