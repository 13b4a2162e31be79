"""Loops over pairs, which numba compiles."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType


def load(name: str) -> ModuleType:
    """Import and return a module of this package, whose functions are compiled when it is first imported or called."""
    return import_module(f"{__name__}.{name}")
