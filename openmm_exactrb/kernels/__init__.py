"""What is written twice, in numpy (`plain`) and for numba (`compiled`): the same functions and arguments, results last.

This is the one place that chooses between them. numba is imported where the compiled twins are first asked for.
"""

from __future__ import annotations

import os
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Literal, NamedTuple

#: With this environment variable set to 0 everything runs in numpy.
SWITCH = "OPENMM_EXACTRB_COMPILED"


class Twins(NamedTuple):
    """The modules that are written twice, all of them in numpy or all compiled.

    Attributes
    ----------
    bath : module
        Friction and noise on momenta.
    bodies : module
        Particles of rigid bodies: places, forces and torques.
    clusters : module
        The free flow of clusters with distance constraints, and the projection of their momenta.
    exact : module
        The free rotation.
    noise : module
        Random numbers that are looked up by seed, step and body.
    sums : module
        Unevaluated sums high + low.
    """

    bath: ModuleType
    bodies: ModuleType
    clusters: ModuleType
    exact: ModuleType
    noise: ModuleType
    sums: ModuleType


def twins(which: Literal["fastest", "numpy", "numba"] = "fastest") -> Twins:
    """Return the kernels: compiled where numba is installed and not refused, or those that are asked for.

    Raises
    ------
    ModuleNotFoundError
        If "numba" is asked for and not installed.
    """
    if which == "numba":
        require()
    return _compiled() if which == "numba" or (which == "fastest" and available()) else _plain()


@cache
def _plain() -> Twins:
    from openmm_exactrb.kernels.plain import bath, bodies, clusters, exact, noise, sums

    return Twins(bath, bodies, clusters, exact, noise, sums)


@cache
def _compiled() -> Twins:
    from openmm_exactrb.kernels.compiled import bath, bodies, clusters, exact, noise, sums

    return Twins(bath, bodies, clusters, exact, noise, sums)


def available() -> bool:
    """Tell whether numba is installed and not refused by `SWITCH`; it is not imported."""
    return os.environ.get(SWITCH, "1") != "0" and find_spec("numba") is not None


def chosen(kernel: str) -> bool:
    """Tell whether "auto", "openmm" or "compiled" stands for a compiled kernel here.

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
