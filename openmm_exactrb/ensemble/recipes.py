"""Recipes: a function and its arguments, with a key that is the same in every process."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from openmm_exactrb.ensemble.names import canonical, name_of, shown
from openmm_exactrb.version import version


@dataclass(frozen=True, init=False, eq=False)
class Recipe:
    """One run: a function, and the arguments that it is called with.

    Parameters
    ----------
    function : callable
        A function at the top level of a module that the workers can import, or of the script that is run. It returns
        what JSON can hold: numbers, texts, lists, mappings with texts as keys, and numpy arrays, which become lists.
        For the same numbers at every call it takes all that it depends on as arguments, seeds too.
    **arguments
        Numbers, texts, lists, mappings, numpy arrays, paths, Quantities, functions, dataclasses such as a `Scheme`,
        or a System, State, Force or Integrator of OpenMM. Large ones travel with every recipe: hand over the path of a
        file, or a function that builds, instead.

    Raises
    ------
    TypeError
        If the function cannot be found by name, does not take these arguments, or one of them has no stable text.

    Attributes
    ----------
    key : str
        Hash of the function's name, the arguments and the version of this package. It does not know the function's
        code: after a change there take another folder.

    Examples
    --------
    >>> from openmm_exactrb import dipole_fluid
    >>> recipe = Recipe(energies, build=dipole_fluid, n=8, step=0.05, duration=1.0, seed=3)
    >>> recipe
    Recipe(openmm_exactrb.ensemble.energies, build=dipole_fluid, n=8, step=0.05, duration=1.0, seed=3)
    >>> recipe == Recipe(energies, seed=3, n=8, step=0.05, duration=1.0, build=dipole_fluid)
    True
    """

    function: Callable[..., Any]
    arguments: Mapping[str, Any]
    key: str

    def __init__(self, function: Callable[..., Any], /, **arguments: Any) -> None:
        name = name_of(function)
        try:
            inspect.signature(function).bind(**arguments)
        except TypeError as error:
            raise TypeError(f"{name} cannot be called with these arguments: {error}") from None
        text = {argument: canonical(value, argument) for argument, value in arguments.items()}
        words = json.dumps([package_version(), name, text], sort_keys=True)
        object.__setattr__(self, "function", function)
        object.__setattr__(self, "arguments", dict(arguments))
        object.__setattr__(self, "key", hashlib.sha256(words.encode()).hexdigest()[:32])

    def __repr__(self) -> str:
        values = (f"{name}={shown(value)}" for name, value in self.arguments.items())
        return f"Recipe({', '.join([name_of(self.function), *values])})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Recipe) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


def sweep(function: Callable[..., Any], axes: Mapping[str, Iterable[Any]], **fixed: Any) -> list[Recipe]:
    """Make the recipes of all combinations of arguments.

    Parameters
    ----------
    function : callable
    axes : mapping
        Argument to its values. The last one varies fastest.
    **fixed
        Arguments that are the same in all recipes.

    Returns
    -------
    list of Recipe

    Examples
    --------
    >>> from openmm_exactrb import dipole_fluid
    >>> axes = {"seed": range(100), "scheme": ["V2", "SRKN4_6b"]}
    >>> len(sweep(energies, axes, build=dipole_fluid, step=0.05, duration=1.0))
    200
    """
    for name, values in axes.items():
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise TypeError(f"axis {name} must be a list of values, not {values!r}")
    return [Recipe(function, **dict(zip(axes, values, strict=True)), **fixed) for values in product(*axes.values())]


def package_version() -> str:
    """Return the version of this package as keys hold it."""
    return version("unknown")
