"""Recipes: a function and its arguments, with a key that is the same in every process."""

from __future__ import annotations

import copy
import hashlib
import inspect
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

from openmm_exactrb.ensemble.names import canonical, files_in, full_name, name_of, shown
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
        or a System, State, Force or Integrator of OpenMM. The recipe keeps copies: what is changed later does not
        change it. Large ones travel with every recipe: hand over the path of a file, or a function that builds,
        instead. A ``pathlib.Path`` to a file stands for what is in it too; name by a text what the function writes.

    Raises
    ------
    TypeError
        If the function is not found by its name in its module, as a method of an object is not; if it does not take
        these arguments; or if one of them has no stable text, as an array with a mask has none.

    Attributes
    ----------
    function : callable
    arguments : dict
        Copies of them, as they were when the recipe was made.
    key : str
        Hash of the function's name, the arguments and the version of this package, with the content of files. It does
        not know the function's code, nor what is in a folder: after a change there take another folder of results.
    files : tuple of (str, str)
        Paths of the files among the arguments, and hashes of what was in them. A worker that finds another content
        does not compute.

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
    key: str
    files: tuple[tuple[str, str], ...]
    _arguments: Mapping[str, Any]

    def __init__(self, function: Callable[..., Any], /, **arguments: Any) -> None:
        name = name_of(function)
        try:
            inspect.signature(function).bind(**arguments)
        except TypeError as error:
            raise TypeError(f"{name} cannot be called with these arguments: {error}") from None
        kept = {argument: _kept(value, argument) for argument, value in arguments.items()}
        texts = {argument: text for argument, (_, text) in kept.items()}
        words = json.dumps([package_version(), name, texts], sort_keys=True)
        object.__setattr__(self, "function", function)
        object.__setattr__(self, "key", hashlib.sha256(words.encode()).hexdigest()[:32])
        object.__setattr__(self, "files", tuple(file for text in texts.values() for file in files_in(text)))
        object.__setattr__(self, "_arguments", {argument: value for argument, (value, _) in kept.items()})

    @property
    def arguments(self) -> dict[str, Any]:
        """Copies of the arguments, as they were when the recipe was made."""
        return copy.deepcopy(dict(self._arguments))

    def __repr__(self) -> str:
        values = (f"{name}={shown(value)}" for name, value in self._arguments.items())
        return f"Recipe({', '.join([full_name(self.function), *values])})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Recipe) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


class _Kept(NamedTuple):
    """An argument as it was when it was handed over, and what stands for it in a key."""

    value: Any
    text: Any


def _kept(value: Any, where: str) -> _Kept:
    """Return a copy of an argument, which changes of the original do not reach; a copy already is one."""
    if isinstance(value, _Kept):
        return value
    text = canonical(value, where)
    try:
        return _Kept(copy.deepcopy(value), text)
    except TypeError as error:
        raise TypeError(f"argument {where} of a recipe must be what copy.deepcopy can copy: {error}") from None


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
        They share one copy of each value.

    Raises
    ------
    TypeError
        If an argument is an axis and fixed, an axis is no list of values, or as for a `Recipe`.

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
        if name in fixed:
            raise TypeError(f"argument {name} is an axis and fixed: give it once")
    columns = [[_kept(value, name) for value in values] for name, values in axes.items()]
    same = {name: _kept(value, name) for name, value in fixed.items()}
    return [Recipe(function, **dict(zip(axes, values, strict=True)), **same) for values in product(*columns)]


def package_version() -> str:
    """Return the version of this package as keys hold it."""
    return version("unknown")
