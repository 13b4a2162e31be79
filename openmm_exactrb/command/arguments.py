"""What options take: numbers in their range, with or without a unit."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Any, NoReturn

from openmm_exactrb import checks

_PICOSECONDS = {"": 1.0, "fs": 1e-3, "ps": 1.0, "ns": 1e3, "us": 1e6}
_TIME = re.compile(r"([-+.0-9e]+)\s*([a-z]*)", re.IGNORECASE)
_LARGEST = 2**31 - 1  # OpenMM keeps a seed in 32 bits


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2 and one line, without the usage."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def checked(kind: Callable[[str], Any], check: Callable[..., Any], *details: Any) -> Callable[[str], Any]:
    """Return an argparse type: text as a number of a kind that passes one of `openmm_exactrb.checks`."""

    def convert(text: str) -> Any:
        try:
            return check(kind(text), "it", *details)
        except ValueError as error:
            raise argparse.ArgumentTypeError(_sentence(text, error)) from None

    return convert


def time(text: str) -> float:
    """Return a positive time in ps, of text such as 0.004, 4fs or 1ns."""
    return _time(text, checks.positive, "a positive time")


def time_or_zero(text: str) -> float:
    """Return a time of at least zero in ps."""
    return _time(text, checks.not_negative, "a time of at least 0")


def time_or_auto(text: str) -> float | None:
    """Return a positive time in ps, or None for "auto"."""
    return None if text == "auto" else time(text)


def _time(text: str, check: Callable[..., float], asked: str) -> float:
    match = _TIME.fullmatch(text.strip())
    try:
        if match is None or match[2].lower() not in _PICOSECONDS:
            raise ValueError("is no time")
        return check(float(match[1]) * _PICOSECONDS[match[2].lower()], "it")
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not {asked}: give it in ps, or with a unit, such as 4fs, 100ps or 1ns"
        ) from None


def _seed(value: int, name: str) -> int:
    if checks.whole(value, name, 1) > _LARGEST:
        raise ValueError(f"{name} must be a whole number from 1 to {_LARGEST}, not {value}")
    return value


def _sentence(text: str, error: ValueError) -> str:
    wanted = re.fullmatch(r"it must be (.*), not .*", str(error))
    return f"{text!r} is not {wanted[1]}" if wanted else f"{text!r} is not a number"


positive = checked(float, checks.positive)
count = checked(int, checks.whole)
seed = checked(int, _seed)
