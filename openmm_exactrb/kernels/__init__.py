"""Inner loops, in numpy (`plain`) and for numba (`compiled`): the same functions and arguments, results last.

In numpy there is what rigid bodies need. numba is imported when the first compiled module is loaded.
"""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Literal

#: With this environment variable set to 0 everything that has a form in numpy runs in numpy, unless asked for by name.
SWITCH = "OPENMM_EXACTRB_COMPILED"


def load(name: str, which: Literal["fastest", "numpy", "numba"] = "fastest") -> ModuleType:
    """Import a module of kernels.

    Parameters
    ----------
    name : str
        "bodies" (positions of the particles of rigid bodies, forces and torques), "exact" (the free rotation) or "sums"
        (double-double numbers); "clusters" (the free flow of constrained clusters) or "pairs" (dipoles) for numba only.
    which : {"fastest", "numpy", "numba"}, optional
        "fastest" is the compiled module where numba is installed and not refused by `SWITCH`.

    Raises
    ------
    ModuleNotFoundError
        If "numba" is asked for and not installed.
    """
    if which == "numba":
        require()
    compiled = which == "numba" or (which == "fastest" and available())
    return import_module(f"{__name__}.{'compiled' if compiled else 'plain'}.{name}")


def available() -> bool:
    """Return whether numba is installed and not refused by `SWITCH`; it is not imported."""
    return os.environ.get(SWITCH, "1") != "0" and find_spec("numba") is not None


def chosen(kernel: str) -> bool:
    """Return whether "auto", "openmm" or "compiled" means a compiled kernel here.

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


def require(what: str = "compiled kernels") -> None:
    """Raise ModuleNotFoundError if numba, which `what` needs, is not installed."""
    if find_spec("numba") is None:
        raise ModuleNotFoundError(f'{what} need numba: python -m pip install "openmm-exactrb[fast]"', name="numba")
