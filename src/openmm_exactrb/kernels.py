"""What compiled kernels share: whether numba is there, how functions are compiled, and a word to who waits for it."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

Function = Callable[..., Any]


#: With this environment variable set to 0 everything runs in numpy.
SWITCH = "OPENMM_EXACTRB_COMPILED"


def available() -> bool:
    """Tell whether numba is installed and not refused by `SWITCH`; it is not imported."""
    return os.environ.get(SWITCH, "1") != "0" and find_spec("numba") is not None


def require() -> None:
    """Refuse to go on without numba.

    Raises
    ------
    ImportError
        If it is not installed.
    """
    if find_spec("numba") is None:
        raise ImportError("compiled kernels need numba: pip install openmm-exactrb[fast]")


@contextmanager
def announced(what: str, patience: float = 1.5) -> Iterator[None]:
    """Say on stderr what is being compiled, if it takes longer than `patience` seconds."""
    text = f"openmm-exactrb: compiling {what} for this machine, once; later runs load it\n"
    message = threading.Timer(patience, sys.stderr.write, (text,))
    message.daemon = True
    message.start()
    try:
        yield
    finally:
        message.cancel()


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
