"""Types of command-line options: numbers within a range, and times with or without a unit; common options."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Iterable
from typing import Any, NoReturn

_PICOSECONDS = {"": 1.0, "fs": 1e-3, "ps": 1.0, "ns": 1e3, "us": 1e6}
_TIME = re.compile(r"([-+.0-9e]+)\s*([a-z]*)", re.IGNORECASE)
_LARGEST = 2**31 - 1  # OpenMM stores a seed in 32 bits


class Parser(argparse.ArgumentParser):
    """A parser with one-line error messages."""

    def error(self, message: str) -> NoReturn:
        """Print the error as one line without the usage, and exit with status 2."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _option(convert: Callable[[str], Any], fits: Callable[[Any], bool], description: str) -> Callable[[str], Any]:
    """Return an argparse type that converts text and accepts only values within a range."""

    def checked(text: str) -> Any:
        try:
            value = convert(text)
            if math.isfinite(value) and fits(value):
                return value
        except ValueError:
            pass
        raise argparse.ArgumentTypeError(f"{text!r} is not {description}")

    return checked


def _picoseconds(text: str) -> float:
    match = _TIME.fullmatch(text.strip())
    if match is None or match[2].lower() not in _PICOSECONDS:
        raise ValueError(text)
    return float(match[1]) * _PICOSECONDS[match[2].lower()]


def one_of(names: Iterable[str]) -> dict[str, Any]:
    """Return the argparse arguments for an option that takes one of several names, in upper or lower case."""
    by_case = {name.lower(): name for name in names}
    return {"type": lambda text: by_case.get(text.lower(), text), "choices": [*by_case.values()]}


_UNITS = "in ps, or with a unit such as 4fs, 100ps or 1ns"
positive = _option(float, lambda value: value > 0.0, "a positive number")
count = _option(int, lambda value: value >= 1, "a whole number of at least 1")
seed = _option(int, lambda value: 1 <= value <= _LARGEST, f"a whole number from 1 to {_LARGEST}")
time = _option(_picoseconds, lambda value: value > 0.0, f"a positive time {_UNITS}")
_time_with_unit = _option(_picoseconds, lambda value: value > 0.0, "a positive time with a unit, such as 4fs")
time_or_zero = _option(_picoseconds, lambda value: value >= 0.0, f"a time of at least 0 {_UNITS}")


def flag(name: str) -> str:
    """Return the command-line option for a Python argument, such as --inner-steps for innerSteps."""
    return "--" + re.sub("([A-Z])", r"-\1", name).lower()


def time_with_unit(text: str) -> float:
    """Convert text with a unit to a positive time in ps."""
    value = float(_time_with_unit(text))
    if not text.strip()[-1].isalpha():
        raise argparse.ArgumentTypeError(
            f"{text!r} has no unit: write {text}fs for femtoseconds, or {text}ps for picoseconds"
        )
    return value


def time_or_auto(text: str) -> float | None:
    """Convert text with a unit to a positive time in ps, or "auto" to None."""
    return None if text == "auto" else time_with_unit(text)


def add_seed_and_platform(add: Callable[..., Any], seeded: str) -> None:
    """Add --seed, with a description of what it determines, and --platform."""
    add("--seed", type=seed, default=1, metavar="N", help=f"seed of {seeded} (default: %(default)s)")
    add("--platform", metavar="NAME", help="OpenMM platform (default: the fastest)")
