"""Numbers that a user hands over: looked at in one place, refused in one sentence."""

from __future__ import annotations

import math
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


def _checked(value: Any, name: str, of: str, asked: str, fits: Any) -> float:
    plain = isinstance(value, (int, float, np.number)) and not isinstance(value, (bool, np.bool_, np.complexfloating))
    if not plain or not math.isfinite(value) or not fits(value):
        raise ValueError(f"{name} must be {asked.format(f' of {of}' if of else '')}, not {value!r}")
    return float(value)
