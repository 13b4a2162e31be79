"""The library's kernels as functions of NumPy arrays, for the host engine and for free bodies.

Without the library, the same functions exist in NumPy: `openmm_exactrb.rotors.closed_form`,
`openmm_exactrb.constraints.geodesics`, `openmm_exactrb.multiple_time_steps.bonded_forces` and
`openmm_exactrb.random.philox`.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from openmm_exactrb.library.library import library, missing


def available() -> bool:
    """Return whether there is a library, which is compiled if necessary."""
    return missing() is None


def call(name: str, *arguments: Any) -> int:
    """Call a function of the library without Python's global lock, and return its result.

    Arguments are C-contiguous arrays, integers (int), numbers (double) and text. The function writes its results into
    arrays.
    """
    return int(getattr(library().exported, f"pi_{name}")(*map(passed, arguments)))


def passed(argument: Any) -> Any:
    """Return an argument as C takes it."""
    if isinstance(argument, np.ndarray):
        assert argument.flags.c_contiguous
        return ctypes.c_void_p(argument.ctypes.data)
    if isinstance(argument, str):
        return argument.encode()
    return ctypes.c_double(argument) if isinstance(argument, float) else ctypes.c_int(argument)
