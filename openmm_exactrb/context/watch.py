"""Methods of one Context that are replaced, or preceded and followed by calls, since OpenMM has no callbacks.

The object gets a subclass of its class, so that other Contexts keep the methods of OpenMM.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import openmm

#: The methods that can be replaced or watched.
METHODS = "createCheckpoint", "getState", "reinitialize", "setState", "setStepCount", "setVelocitiesToTemperature"
# The attribute of a Context with the functions that act instead of its methods.
_FUNCTIONS = "_exactrb_functions"


def _nothing() -> None:
    pass


def replace(context: openmm.Context, name: str, function: Callable[..., Any]) -> None:
    """Let a method of a Context return function(original, context, ...), instead of that of an earlier call."""
    if (functions := vars(context).get(_FUNCTIONS)) is None:
        functions = vars(context)[_FUNCTIONS] = {}
        kind: Any = type(context)
        context.__class__ = _replaceable(kind)
    functions[name] = function


def watch(
    context: openmm.Context,
    name: str,
    before: Callable[[], None] = _nothing,
    after: Callable[[], None] = _nothing,
    concerns: Callable[..., bool] = lambda *arguments, **options: True,
) -> None:
    """Call functions before and after relevant calls of a method of a Context."""

    def noticing(original: Callable[..., Any], context: Any, *arguments: Any, **options: Any) -> Any:
        if not concerns(*arguments, **options):
            return original(context, *arguments, **options)
        before()
        try:
            return original(context, *arguments, **options)
        finally:
            after()

    replace(context, name, noticing)


@functools.cache
def _replaceable(kind: type[Any]) -> type[Any]:
    """Return a subclass of a class of Contexts, of the same name, in which methods can be replaced."""
    names = {"__module__": kind.__module__, "__qualname__": kind.__qualname__, "__doc__": kind.__doc__}
    return type(kind.__name__, (kind,), names | {name: _method(getattr(kind, name)) for name in METHODS})


def _method(original: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(original)
    def method(self: Any, *arguments: Any, **options: Any) -> Any:
        function = vars(self)[_FUNCTIONS].get(original.__name__)
        return function(original, self, *arguments, **options) if function else original(self, *arguments, **options)

    return method
