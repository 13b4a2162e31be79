"""The compiled pair sum of this room: who asks for it, and where it is."""

from __future__ import annotations

from typing import Any

from openmm_exactrb import kernels


def pair_sum() -> Any:
    """Return the module of the compiled pair sum, `soft_dipoles` and `number_of_waves`; the first call imports numba.

    Raises
    ------
    ModuleNotFoundError
        If numba is not installed.
    """
    return kernels.load("pairs", "numba")


def chosen(kernel: str, *, needed: bool) -> bool:
    """Tell whether "auto", "openmm" or "compiled" stands for the compiled kernel here.

    Parameters
    ----------
    kernel : str
    needed : bool
        Whether no other will do: that of an Ewald sum.

    Raises
    ------
    ValueError
        If the name is unknown, or stands for another kernel than the one that is needed.
    ModuleNotFoundError
        If it is asked for or needed and numba is not installed.
    """
    if needed:
        kernels.require()
    if not kernels.chosen(kernel):
        if needed:
            raise ValueError(
                "only the compiled kernel has an Ewald sum: ask for kernel='compiled', or for boundary=ReactionField()"
            )
        return False
    return True
