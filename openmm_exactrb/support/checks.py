"""Checks of a user's numbers, each with a message of one sentence."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from openmm_exactrb.support.messages import shown
from openmm_exactrb.support.types import Array, Indices


def number(value: Any, name: str, of: str = "") -> float:
    """Return a finite number as a float; raise ValueError, with the name and the unit (`of`), for anything else."""
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
    _checked(value, name, of, asked, lambda x: x == int(x) and x >= least)
    return int(value)


def force_groups(value: Any) -> int:
    """Return force groups, given as a set or a bit mask, as a bit mask; raise ValueError for anything else."""
    if _index(value) and -(2**31) <= value < 2**32:
        return int(value)
    groups: list[Any] = [*value] if _iterable(value) else [None]
    if not all(_index(group) and 0 <= group < 32 for group in groups):
        raise ValueError(f"force groups must be a set of integers from 0 to 31, or a bit mask, not {shown(value)}")
    return sum(1 << group for group in {*map(int, groups)})


def switch(value: Any, name: str) -> bool:
    """Return True or False; raise ValueError for anything else."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be True or False, not {shown(value)}")
    return value


def array(value: Any, name: str, asked: str = "real numbers in rows of equal length, without a unit") -> Array:
    """Return real numbers, which may be nan or infinite, as an array of floats.

    Raises
    ------
    ValueError
        If the value is complex, text, a Quantity, or has rows of different lengths; the message contains `asked`.
    """
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        given = np.asarray(value)
        if given.dtype.kind == "O":
            given = np.frompyfunc(float, 1, 1)(given)  # fails for None, which numpy would convert to nan
        if given.dtype.kind in "biufO" and not _has_unit(value):  # numpy would drop the unit
            return given.astype(np.float64, copy=False)
    raise ValueError(f"{name} must be {asked}, not {shown(value)}")


def lists_of_indices(value: Any, name: str) -> list[list[int]]:
    """Return lists of particle indices as lists of int, consuming iterators once; see `number`."""
    rows = [list(row) if _iterable(row) else None for row in value] if _iterable(value) else [None]
    fits = [row for row in rows if row is not None and all(map(_index, row))]
    if len(fits) < len(rows):
        given = shown(value)
        raise ValueError(f"{name} must be lists of particle indices, such as [[0, 1, 2], [3, 4, 5]], not {given}")
    return [list(map(int, row)) for row in fits]


def owners(bodies: Sequence[Sequence[int] | Indices], n_particles: int) -> Indices:
    """Return the index (n_particles,) of the body that contains each particle, -1 for particles of no body.

    A ValueError is raised if a particle does not exist or is named twice.
    """
    owner, numbers = np.full(n_particles, -1), np.repeat(np.arange(len(bodies)), [len(body) for body in bodies])
    particles = np.fromiter(chain.from_iterable(bodies), np.intp, len(numbers))
    for i in np.flatnonzero((particles < 0) | (particles >= n_particles)):
        named = f"the particles of body {numbers[i]} must be numbers from 0 to {n_particles - 1}, not {particles[i]}"
        raise ValueError(f"{named}: choose particles of the System")
    order = np.argsort(particles, kind="stable")
    for i in np.flatnonzero(np.diff(particles[order]) == 0):
        first, second = numbers[order[i : i + 2]]
        where = f"in body {first}" if first == second else f"in bodies {first} and {second}"
        raise ValueError(f"particle {particles[order[i]]} is named twice, {where}: name each particle once")
    owner[particles] = numbers
    return owner


def functions(value: Any, name: str) -> tuple[Any, ...]:
    """Return a sequence of functions as a tuple; raise ValueError for anything else."""
    given = tuple(value) if _iterable(value) else (None,)
    if not all(map(callable, given)):
        raise ValueError(f"{name} must be a sequence of functions, such as [on_a_plane], not {shown(value)}")
    return given


def _has_unit(value: Any) -> bool:
    """Return whether a value, or one in a list of values, is a Quantity."""
    return hasattr(value, "unit") or (isinstance(value, (list, tuple)) and any(hasattr(x, "unit") for x in value))


def _iterable(value: Any) -> bool:
    return np.iterable(value) and not isinstance(value, (str, bytes))


def _index(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _checked(value: Any, name: str, of: str, asked: str, fits: Any) -> float:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    plain = isinstance(value, (int, float, np.number)) and not isinstance(value, (bool, np.bool_, np.complexfloating))
    huge = isinstance(value, int) and abs(value) > sys.float_info.max  # beyond the range of float64
    if not plain or huge or not math.isfinite(value) or not fits(value):
        given = f"a number beyond {sys.float_info.max:.2g}" if huge else shown(value)
        raise ValueError(f"{name} must be {asked.format(f' of {of}' if of else '')}, not {given}")
    return float(value)
