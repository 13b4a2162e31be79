"""Functions that are called before and after methods of a Context, since OpenMM has no callbacks."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from typing import Any

import openmm


def _nothing() -> None:
    pass


def watch(
    context: openmm.Context,
    name: str,
    before: Callable[[], None] = _nothing,
    after: Callable[[], None] = _nothing,
    concerns: Callable[..., bool] = lambda *arguments, **options: True,
) -> None:
    """Call functions before and after relevant calls of a method of a Context."""
    method = getattr(type(context), name)
    reference = weakref.ref(context)

    @functools.wraps(method)
    def noticing(*arguments: Any, **options: Any) -> Any:
        if not concerns(*arguments, **options):
            return method(reference(), *arguments, **options)
        before()
        try:
            return method(reference(), *arguments, **options)
        finally:
            after()

    setattr(context, name, noticing)
