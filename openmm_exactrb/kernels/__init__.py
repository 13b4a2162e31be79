"""Inner loops, compiled by numba when the first of them is loaded; `plain` contains the exact rotation in numpy."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType


def load(name: str) -> ModuleType:
    """Import a module of `compiled` by its name, which compiles it or finds it in numba's cache."""
    return import_module(f"{__name__}.compiled.{name}")
