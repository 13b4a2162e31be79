"""Numbers that a user hands over: looked at in one place, refused in one sentence."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable
from typing import Any

import numpy as np


def number(value: Any, name: str, of: str = "") -> float:
    """Return a finite number as a float.

    Parameters
    ----------
    value : object
    name : str
        What it is, for the message.
    of : str, optional
        Its unit, for the message.

    Raises
    ------
    ValueError
        If it is no number, or not finite.
    """
    return _checked(value, name, of, "a finite number{}", lambda x: True)


def positive(value: Any, name: str, of: str = "") -> float:
    """Return a finite number above zero as a float; see `number`."""
    return _checked(value, name, of, "a positive number{}", lambda x: x > 0.0)


def not_negative(value: Any, name: str, of: str = "") -> float:
    """Return a finite number of at least zero as a float; see `number`."""
    return _checked(value, name, of, "a number{} of at least 0", lambda x: x >= 0.0)


def whole(value: Any, name: str, least: int = 1, of: str = "") -> int:
    """Return a whole number of at least `least`; see `number`."""
    asked = f"a whole number{{}} of at least {least}"
    return int(_checked(value, name, of, asked, lambda x: x == int(x) and x >= least))


def lists_of_indices(value: Any, name: str) -> list[list[int]]:
    """Return lists of numbers of particles as lists of int; see `number`."""
    if not _iterable(value) or not all(_iterable(row) and all(map(_index, row)) for row in value):
        given = reprlib.repr(value)
        raise ValueError(f"{name} must be lists of numbers of particles, such as [[0, 1, 2], [3, 4, 5]], not {given}")
    return [list(map(int, row)) for row in value]


def _iterable(value: Any) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, (str, bytes))


def _index(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _checked(value: Any, name: str, of: str, asked: str, fits: Any) -> float:
    plain = isinstance(value, (int, float, np.number)) and not isinstance(value, (bool, np.bool_, np.complexfloating))
    if not plain or not math.isfinite(value) or not fits(value):
        raise ValueError(f"{name} must be {asked.format(f' of {of}' if of else '')}, not {value!r}")
    return float(value)
