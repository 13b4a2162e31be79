"""Copies of integrators, including those of users' subclasses, which may have different arguments."""

from __future__ import annotations

from typing import Any


def own_attributes(integrator: Any, arguments: dict[str, Any]) -> dict[str, Any]:
    """Return the attributes that a user's subclass added to an integrator created with these arguments."""
    known = vars(_made(type(integrator), arguments))
    return {name: value for name, value in vars(integrator).items() if name not in known}


def restored(kind: Any, attributes: dict[str, Any], arguments: dict[str, Any], settings: dict[str, Any]) -> Any:
    """Return an integrator of a class with the given attributes, arguments and settings of another integrator."""
    integrator = _made(kind, arguments)
    vars(integrator).update(attributes)
    for name, value in settings.items():
        getattr(integrator, f"set{name}")(value)
    return integrator


def _made(kind: Any, arguments: dict[str, Any]) -> Any:
    """Return an integrator of a class, initialised by the class of this package that it is or derives from."""
    ours = next(base for base in kind.__mro__ if base.__module__.split(".")[0] == "openmm_exactrb")
    integrator = kind.__new__(kind)
    ours.__init__(integrator, **arguments)
    return integrator
