"""What is written twice, in numpy (`plain`) and for numba (`compiled`): the same functions and arguments, results last.

This is the one place that chooses between them. numba is imported where the compiled twins are first asked for.
"""

from __future__ import annotations

import os
from functools import cached_property
from importlib.util import find_spec
from types import ModuleType
from typing import Literal

#: With this environment variable set to 0 everything that is not asked for by name runs in numpy.
SWITCH = "OPENMM_EXACTRB_COMPILED"


class _Plain:
    @cached_property
    def bath(self) -> ModuleType:
        from openmm_exactrb.kernels.plain import bath

        return bath

    @cached_property
    def bodies(self) -> ModuleType:
        from openmm_exactrb.kernels.plain import bodies

        return bodies

    @cached_property
    def clusters(self) -> ModuleType:
        from openmm_exactrb.kernels.plain import clusters

        return clusters

    @cached_property
    def exact(self) -> ModuleType:
        from openmm_exactrb.kernels.plain import exact

        return exact

    @cached_property
    def noise(self) -> ModuleType:
        from openmm_exactrb.kernels.plain import noise

        return noise

    @cached_property
    def sums(self) -> ModuleType:
        from openmm_exactrb.kernels.plain import sums

        return sums


class _Compiled:
    @cached_property
    def bath(self) -> ModuleType:
        from openmm_exactrb.kernels.compiled import bath

        return bath

    @cached_property
    def bodies(self) -> ModuleType:
        from openmm_exactrb.kernels.compiled import bodies

        return bodies

    @cached_property
    def clusters(self) -> ModuleType:
        from openmm_exactrb.kernels.compiled import clusters

        return clusters

    @cached_property
    def exact(self) -> ModuleType:
        from openmm_exactrb.kernels.compiled import exact

        return exact

    @cached_property
    def noise(self) -> ModuleType:
        from openmm_exactrb.kernels.compiled import noise

        return noise

    @cached_property
    def sums(self) -> ModuleType:
        from openmm_exactrb.kernels.compiled import sums

        return sums


#: The modules that are written twice, all of them in numpy or all compiled, each imported when it is needed: `bath`
#: (friction and noise on momenta), `bodies` (particles of rigid bodies: places, forces and torques), `clusters` (the
#: free flow of clusters that distance constraints hold), `exact` (the free rotation), `noise` (random numbers that are
#: looked up by seed, step and body) and `sums` (unevaluated sums high + low).
Twins = _Plain | _Compiled

_PLAIN, _COMPILED = _Plain(), _Compiled()


def twins(which: Literal["fastest", "numpy", "numba"] = "fastest") -> Twins:
    """Return the kernels: compiled where numba is installed and not refused, or those that are asked for.

    Raises
    ------
    ModuleNotFoundError
        If "numba" is asked for and not installed.
    """
    if which == "numba":
        require()
    return _COMPILED if which == "numba" or (which == "fastest" and available()) else _PLAIN


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
        raise ModuleNotFoundError("compiled kernels need numba: python -m pip install numba", name="numba")
