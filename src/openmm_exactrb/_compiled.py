"""Compiled kernels when they are wanted: numba is looked for, imported late, and a first compilation is announced."""

from __future__ import annotations

import importlib
import importlib.util
import logging
from functools import cache
from types import ModuleType
from typing import Any

_log = logging.getLogger("openmm_exactrb")


def available() -> bool:
    """Tell whether numba is installed, without importing it."""
    return importlib.util.find_spec("numba") is not None


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
    return kernel != "openmm" and available()


def require() -> None:
    """Raise ModuleNotFoundError if numba is not installed."""
    if not available():
        raise ModuleNotFoundError(
            'the compiled kernel needs numba: python -m pip install "openmm-exactrb[fast]"', name="numba"
        )


@cache
def load(module: str) -> ModuleType:
    """Import a module of compiled kernels, such as "_pairs"."""
    require()
    events: Any = importlib.import_module("numba.core.event")
    events.register("numba:compile", _announcer(events))
    return importlib.import_module(f"openmm_exactrb.{module}")


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
