"""Whether methods that describe one flow in several forms belong together.

The flow of a substep, for example, is a function of a state, moves in kernels, and a matrix for an oscillator. A class
that overrides one form and inherits another one has two different flows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, ClassVar, TypeVar

_T = TypeVar("_T")


class Described:
    """The base of base classes whose subclasses describe a flow in several forms."""

    _as_defined: ClassVar[dict[str, Any]] = {}

    def __init_subclass__(cls) -> None:
        """Keep the attributes with which a class is defined, so that those replaced afterwards are recognised."""
        super().__init_subclass__()
        cls._as_defined = {name: value for name, value in vars(cls).items() if not name.startswith("_")}


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
    alone = _overridden_alone(thing, description, flows)
    return _sentence(thing, alone, description) if alone in flows else None


def unperformed(thing: Any, description: str, *flows: str) -> str | None:
    """Return why the flow of an object is not that of its description, which is overridden alone, or None.

    The arguments are those of `mismatch`. A description that a class adds to the flow of its base class, which has
    none, is not alone.
    """
    alone = _overridden_alone(thing, description, flows)
    return _sentence(thing, description, flows[0]) if alone == description else None


def _sentence(thing: Any, overridden: str, inherited: str) -> str:
    return (
        f"{type(thing).__name__} overrides {overridden}() but inherits {inherited}(), which describes another flow: "
        f"override {inherited}() as well"
    )


def _overridden_alone(thing: Any, description: str, flows: tuple[str, ...]) -> str | None:
    """Return the description, or the flow, that was overridden without the other after both belonged together."""
    alone, known = None, False
    for names in _overridden(thing, (*flows, description)):
        if flow := next((name for name in flows if name in names), None):
            alone, known = None if description in names else flow, True
        elif names and known:
            alone = None if alone in flows else description
    return alone


def _overridden(thing: Any, names: tuple[str, ...]) -> Iterator[set[str]]:
    """Yield which of these names are defined in each class, from the most general one, and in the object itself.

    The definition of a class is followed by the names that were added or replaced afterwards. A class that derives
    directly from `Described` defines neither a flow nor its description.
    """
    for kind in reversed(type(thing).__mro__):
        present = vars(kind)
        if Described not in kind.__bases__:
            defined = present.get("_as_defined", present)
            yield {name for name in names if name in defined}
            yield {name for name in names if name in present and present[name] is not defined.get(name)}
    yield own_methods(thing).keys() & set(names)


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
