"""Inner loops, which numba compiles when they are first loaded or called; `plain` contains the same loops in numpy."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType


def load(name: str) -> ModuleType:
    """Import and return a module of kernels.

    Parameters
    ----------
    name : str
        "bodies" (positions of the particles of rigid bodies, forces and torques), "exact" (the free rotation),
        "clusters" (the free flow of constrained clusters), "bonded" (bonds, angles and torsions), "inner_steps" (the
        inner steps of multiple time stepping), "pairs" and "mesh" (dipoles), "ellipsoids" (the Gay-Berne potential),
        "parameters" (the parameters of OpenMM's forces) or "random" (random numbers).
    """
    return import_module(f"{__name__}.compiled.{name}")
