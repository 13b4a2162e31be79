"""Jobs and their results. A job is a function with its arguments and a key that is the same in every process."""

from __future__ import annotations

import copy
import inspect
import json
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from typing import Any

import openmm

from openmm_exactrb.support.messages import shown
from openmm_exactrb.support.stable_text import digest, qualified_name, stable_text
from openmm_exactrb.support.version import version


class Job:
    """One run of an ensemble: a function and its arguments.

    Parameters
    ----------
    function : callable
        A function at the top level of a script or of a module that the workers can import. Its result must consist of
        values that JSON can represent, or numpy arrays, which become lists, and must depend only on the arguments,
        including seeds.
    **arguments
        Numbers, text, lists, mappings, numpy arrays, paths, Quantities, functions, dataclasses such as a `Scheme`, or a
        System, State, Force or Integrator of OpenMM. The job keeps copies and sends them to the worker. Instead of a
        large object, pass the path of a file or a function that builds the object. Use a ``pathlib.Path`` for a file
        that the function reads, and a str for a file that it writes.

    Raises
    ------
    TypeError
        If the function cannot be found by its name in its module or does not accept the arguments, or if an argument is
        of an unsupported type.

    Attributes
    ----------
    function : callable
    key : str
        Hash of the function's name, the arguments, the content of files that a ``pathlib.Path`` names, and the versions
        of this package and OpenMM. The hash does not include the function's code. After changing the code, use another
        folder.

    Examples
    --------
    >>> from openmm_exactrb.ensemble import Job
    >>> job = Job(free_rotor, inertia=[1, 1, 2], q0=[1, 0, 0, 0], m0=[0.1, 0.2, 0.3], t=5.0)
    >>> job
    Job(openmm_exactrb.rotors.front.free_rotor, inertia=[1, 1, 2], q0=[1, 0, 0, 0], m0=[0.1, 0.2, 0.3], t=5.0)
    >>> job == Job(free_rotor, t=5.0, m0=[0.1, 0.2, 0.3], q0=[1, 0, 0, 0], inertia=[1, 1, 2])
    True
    """

    def __init__(self, function: Callable[..., Any], /, **arguments: Any) -> None:
        try:
            name = _importable_name(function)
        except TypeError as error:
            raise TypeError(f"the function of a job {error}") from None
        inspect.signature(function).bind(**arguments)  # raises a TypeError here, not on a worker
        texts = {argument: _text(argument, value) for argument, value in arguments.items()}
        self.function = function
        self.key = digest(json.dumps([*versions(), name, texts], sort_keys=True).encode())
        self._arguments = copy.deepcopy(arguments)

    @property
    def arguments(self) -> dict[str, Any]:
        """Copies of the arguments, as they were when the job was created."""
        return copy.deepcopy(self._arguments)

    def __repr__(self) -> str:
        texts = {name: getattr(value, "__qualname__", shown(value)) for name, value in self._arguments.items()}
        values = (f"{name}={text}" for name, text in texts.items())
        return f"Job({', '.join([qualified_name(self.function), *values])})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Job) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


@dataclass(frozen=True)
class Result:
    """The result of a job."""

    job: Job
    #: Value that the function returned, as represented in JSON; None if it failed.
    value: Any = None
    #: Type and message of the exception, and its traceback, if the function failed.
    error: str | None = None
    traceback: str | None = None
    #: Wall time of the call on the worker, in s.
    seconds: float = 0.0
    #: Whether the result was read from disk.
    cached: bool = False


def sweep(function: Callable[..., Any], axes: Mapping[str, Iterable[Any]], **fixed: Any) -> list[Job]:
    """Create jobs for all combinations of arguments.

    Parameters
    ----------
    function : callable
    axes : mapping
        The values of each argument that varies. The last argument varies fastest.
    **fixed
        Arguments that are the same in all jobs.

    Returns
    -------
    list of Job

    Raises
    ------
    TypeError
        If a `Job` cannot be created, or the values of an axis are a str.

    Examples
    --------
    >>> from openmm_exactrb.ensemble import sweep
    >>> axes = {"t": range(100), "m0": [[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]]}
    >>> len(sweep(free_rotor, axes, inertia=[1, 1, 2], q0=[1, 0, 0, 0]))
    200
    """
    for name, values in axes.items():
        if isinstance(values, str):
            raise TypeError(f"axis {name} must be a list of values, not {shown(values)}")
    return [Job(function, **dict(zip(axes, values, strict=True)), **fixed) for values in product(*axes.values())]


def versions() -> list[str]:
    """Return the versions of this package and of OpenMM, which are part of the keys of jobs."""
    return [version("unknown"), openmm.Platform.getOpenMMVersion()]


def _importable_name(function: Any) -> str:
    """Return the name by which a worker finds a function or class."""
    try:
        found = attrgetter(function.__qualname__)(sys.modules[function.__module__])
    except (AttributeError, KeyError):
        found = None
    if found is not function or not callable(function):
        raise TypeError(f"must be a module-level function, not {shown(function)}")
    return qualified_name(function)


def _text(argument: str, value: Any) -> str:
    try:
        return stable_text(value, _importable_name)
    except TypeError as error:
        raise TypeError(f"argument {argument} of a job {error}") from None
