"""Inner loops, in numpy (`plain`: what rigid bodies need) and for numba (`compiled`), with the same arguments.

numba is imported when the first compiled module is loaded.
"""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Literal

#: Environment variable; set to 0, whatever has a form in numpy runs in numpy, unless numba is asked for by name.
SWITCH = "OPENMM_EXACTRB_COMPILED"


def load(name: str, which: Literal["fastest", "numpy", "numba"] = "fastest") -> ModuleType:
    """Import a module of kernels.

    Parameters
    ----------
    name : str
        "bodies" (positions of the particles of rigid bodies, forces and torques) or "exact" (the free rotation); for
        numba only "clusters" (the free flow of constrained clusters), "bonded" (bonds, angles and torsions),
        "inner_steps" (of multiple time stepping), "pairs" (dipoles) or "ellipsoids".
    which : {"fastest", "numpy", "numba"}, optional
        "fastest" is the compiled module where numba is installed and not switched off by `SWITCH`.

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
    """Return whether numba is installed and not switched off by `SWITCH`; it is not imported."""
    return os.environ.get(SWITCH, "1") != "0" and find_spec("numba") is not None


def require(what: str = "compiled kernels") -> None:
    """Raise ModuleNotFoundError if numba, which `what` needs, is not installed."""
    if find_spec("numba") is None:
        raise ModuleNotFoundError(f'{what} need numba: python -m pip install "openmm-exactrb[fast]"', name="numba")
