"""What compiled kernels share: whether numba is there, how functions are compiled, and a word to who waits for it."""

from __future__ import annotations

import importlib
import logging
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

_log = logging.getLogger("openmm_exactrb")

Function = Callable[..., Any]


#: With this environment variable set to 0 everything runs in numpy.
SWITCH = "OPENMM_EXACTRB_COMPILED"


def available() -> bool:
    """Tell whether numba is installed and not refused by `SWITCH`; it is not imported."""
    return os.environ.get(SWITCH, "1") != "0" and find_spec("numba") is not None


def chosen(kernel: str) -> bool:
    """Tell whether "auto", "openmm" or "compiled" stands for the compiled kernel here.

    Raises
    ------
    ValueError
        If the name is unknown.
    ModuleNotFoundError
        If "compiled" is asked for and numba is not installed.
    """
    if kernel not in ("auto", "openmm", "compiled"):
        raise ValueError(f"unknown kernel {kernel!r}: choose one of auto, openmm, compiled")
    if kernel == "compiled":
        require()
    return kernel == "compiled" or (kernel == "auto" and available())


def require() -> None:
    """Raise ModuleNotFoundError if numba is not installed."""
    if find_spec("numba") is None:
        raise ModuleNotFoundError(
            'compiled kernels need numba: python -m pip install "openmm-exactrb[fast]"', name="numba"
        )


@cache
def load(module: str) -> ModuleType:
    """Import a module of this package that holds compiled kernels, such as "pairs_compiled".

    Raises
    ------
    ModuleNotFoundError
        If numba is not installed.
    """
    require()
    events: Any = importlib.import_module("numba.core.event")
    events.register("numba:compile", _announcer(events))
    return importlib.import_module(f"openmm_exactrb.{module}")


def in_threads(function: Callable[[int, int], None], work: NDArray[np.int64], threads: int) -> None:
    """Call ``function(first, last)`` on ranges of about equal work, each in a thread of its own, this one included.

    Parameters
    ----------
    function : callable
    work : (n,) array
        What each of n items costs, in any unit.
    threads : int
    """
    if threads == 1:  # spares the microseconds of what follows
        function(0, len(work))
        return
    done = np.cumsum(work)
    ours, *others = pairwise(
        [0, *np.searchsorted(done, done[-1] / threads * np.arange(1, threads)).tolist(), len(work)]
    )
    waiting = [_pool(os.getpid()).submit(function, *part) for part in others]
    function(*ours)
    for part in waiting:
        part.result()


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process; a fork needs its own."""
    return ThreadPoolExecutor(max(1, cores() - 1), f"openmm-exactrb-{process}")


def cores() -> int:
    """Return all cores, or what NUMBA_NUM_THREADS says."""
    return int(importlib.import_module("numba").config.NUMBA_NUM_THREADS)


@cache
def _announcer(events: Any) -> Any:
    """Return a listener that says once what the first run waits for."""

    class Announcer(events.Listener):  # type: ignore[misc]
        told = False

        def on_start(self, event: Any) -> None:
            ours = event.data["dispatcher"].py_func.__module__.startswith("openmm_exactrb.")
            if ours and not self.told:
                self.told = True
                _log.warning("compiling kernels: a few seconds, once; the next process finds them in the cache")

        def on_end(self, event: Any) -> None:
            pass

    return Announcer()


def compiled(arguments: str) -> Callable[[Function], Function]:
    """Compile a function when it is defined, or load it from numba's cache on disk.

    Compiled code runs without Python's global lock, and divides as IEEE 754 says.

    Parameters
    ----------
    arguments : str
        What the function takes: "f" for a float, "i" for an integer, and for contiguous arrays of them their number
        of axes behind it; a capital letter is an array that the function writes to. "f2 F1" is a matrix and a result.
    """
    from numba import njit, types

    scalars = {"f": types.float64, "i": types.int64}

    def type_of(word: str) -> Any:
        scalar, axes = scalars[word[0].lower()], word[1:]
        return types.Array(scalar, int(axes), "C", readonly=word[0].islower()) if axes else scalar

    signature = types.void(*map(type_of, arguments.split()))
    decorate: Callable[[Function], Function] = njit(signature, error_model="numpy", nogil=True, cache=True)
    return decorate


def reordered(function: Function) -> Function:
    """Compile a function for the arguments of its first call, with sums reordered and products fused.

    nan and inf stay what they are, no square root or division is approximated.
    """
    from numba import njit

    flags = {"reassoc", "contract", "arcp", "nsz"}
    fast: Function = njit(error_model="numpy", nogil=True, cache=True, fastmath=flags)(function)
    return fast


def inner(function: Function) -> Function:
    """Mark a function that compiled ones call."""
    from numba import njit

    callee: Function = njit(error_model="numpy", nogil=True)(function)
    return callee


def inlined(function: Function) -> Function:
    """Mark a function that becomes a part of those that call it."""
    from numba import njit

    part: Function = njit(error_model="numpy", inline="always")(function)
    return part
