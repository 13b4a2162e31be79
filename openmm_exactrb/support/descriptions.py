"""Whether methods that describe one flow in several forms belong together.

The flow of a substep, for example, is a function of a state, moves in kernels, and a matrix for an oscillator. A class
that overrides one form and inherits another one has two different flows.
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

_T = TypeVar("_T")


def mismatch(thing: Any, description: str, *flows: str) -> str | None:
    """Return why a description of the flow of an object is that of another flow, or None.

    Parameters
    ----------
    thing : object
    description : str
        Name of the method or attribute that describes the flow.
    flows : str
        Names of the methods that define the flow. The description is valid unless one of them is overridden on the
        object itself, or in a class that precedes the class of the description in the order of method resolution.
    """
    for flow in flows:
        if _level(thing, flow) < _level(thing, description):
            return (
                f"{type(thing).__name__} overrides {flow}() but inherits {description}(), which describes another "
                f"flow: override {description}() as well"
            )
    return None


def _level(thing: Any, name: str) -> int:
    """Return the number of the first namespace with a name: that of the object is 0, and its classes follow."""
    spaces = own_methods(thing), *map(vars, type(thing).__mro__)
    return next(level for level, space in enumerate(spaces) if name in space)


def own_methods(thing: Any) -> dict[str, Any]:
    """Return the methods that an object itself has instead of those of its class."""
    kind, present = type(thing), getattr(thing, "__dict__", {})
    fields = getattr(kind, "__dataclass_fields__", {})
    return {n: value for n, value in present.items() if n not in fields and callable(getattr(kind, n, None))}


def changed(thing: _T, **fields: Any) -> _T:
    """Return a copy of an instance of a frozen dataclass with other values of fields, and with its own methods."""
    made = dataclasses.replace(thing, **fields)  # type: ignore[type-var]
    for name, method in own_methods(thing).items():
        object.__setattr__(made, name, method)
    return made
