"""The functions with which OpenMM returns integrators that it copied or read, or that are part of another integrator.

OpenMM represents such an integrator by an object of its own class, without the Python part of this package. These
functions are the only ones that the package replaces for this purpose.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import openmm

FUNCTIONS = (
    (openmm.XmlSerializer, "_cloneIntegrator"),
    (openmm.XmlSerializer, "_deserializeIntegrator"),
    (openmm.CompoundIntegrator, "getIntegrator"),
)


def hand_out(completed: Callable[[Any], Any], prepare: Callable[[str], None]) -> None:
    """Let OpenMM's functions return completed(integrator) instead of an integrator.

    Before OpenMM reads XML, the function `prepare` is called with the XML.
    """
    for owner, name in FUNCTIONS:
        function = _completing(getattr(owner, name), completed, prepare)
        static = isinstance(vars(owner)[name], staticmethod)
        setattr(owner, name, staticmethod(function) if static else function)


def _completing(
    method: Callable[..., Any], completed: Callable[[Any], Any], prepare: Callable[[str], None]
) -> Callable[..., Any]:
    @functools.wraps(method)
    def completing(*arguments: Any) -> Any:
        if isinstance(arguments[0], str):
            prepare(arguments[0])
        return completed(method(*arguments))

    return completing
