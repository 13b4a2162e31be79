"""Names and texts of what recipes hold, the same today and tomorrow: keys are made of them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.schemes import Scheme

_SERIALISABLE = (openmm.System, openmm.State, openmm.Force, openmm.Integrator)


def name_of(function: Any) -> str:
    """Return a function's name, by which a worker finds it and a later call knows it.

    Raises
    ------
    TypeError
        If it has none, or its module has something else there: a method bound to an object, a changed copy.
    """
    if not callable(function) or not _is_found(function):
        raise TypeError(
            f"a function at the top level of a module is needed, which is found there by its name, not {function!r}"
        )
    return full_name(function)


def _is_found(function: Any) -> bool:
    """Tell whether a function, or class, is what its module has under its name."""
    found: Any = sys.modules.get(getattr(function, "__module__", None) or "")
    for part in getattr(function, "__qualname__", "<none>").split("."):
        found = getattr(found, part, None)
    return found is function


def full_name(function: Any) -> str:
    """Return the name of a function, or class, with that of its module."""
    return f"{_module(function.__module__)}.{function.__qualname__}"


def _module(name: str) -> str:
    """Return the name of a module; that of a script is the one under which it would be imported."""
    main = sys.modules.get("__main__")
    if name != "__main__" or main is None:
        return name
    spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
    return str(spec.name) if spec is not None else Path(file).stem if file else name


def canonical(value: Any, where: str) -> Any:
    """Return what stands for an argument in JSON: the same for equal values, today and tomorrow.

    Parameters
    ----------
    value : object
    where : str
        Name of the argument, for the message.

    Raises
    ------
    TypeError
        If nothing stable stands for it.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [canonical(item, where) for item in value]
    if isinstance(value, Mapping):
        pairs = [[canonical(key, where), canonical(item, where)] for key, item in value.items()]
        return {"mapping": sorted(pairs, key=lambda pair: json.dumps(pair[0]))}
    kind, text = _tagged(value, where)
    return {kind: text}


def _tagged(value: Any, where: str) -> tuple[str, Any]:
    """Return what kind of object an argument is, and what stands for it."""
    if isinstance(value, np.ndarray) and type(value) not in (np.ndarray, np.memmap):  # a mask is not among its bytes
        raise TypeError(
            f"argument {where} of a recipe cannot be a {type(value).__name__}: hand over numpy.asarray of it, and a "
            "mask as an argument of its own"
        )
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return "array", [value.dtype.str, list(value.shape), digest]
    if unit.is_quantity(value):
        return "quantity", [canonical(value._value, where), str(value.unit)]
    if isinstance(value, os.PathLike):
        return _path(value)
    if isinstance(value, ExactRigidBodyIntegrator):  # OpenMM's XML knows neither scheme nor friction
        return _class(value), canonical(value.getSettings(), where)
    if isinstance(value, _SERIALISABLE):
        return "openmm", hashlib.sha256(openmm.XmlSerializer.serialize(value).encode()).hexdigest()
    if isinstance(value, Scheme):
        return "Scheme", canonical(_coefficients(value), where)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return _class(value), canonical(fields, where)
    if isinstance(value, (FunctionType, type)):
        return "function", name_of(value)
    if type(value).__module__.startswith("openmm.app") and repr(value).isidentifier():  # PME, HBonds and the like
        return "option", repr(value)
    raise TypeError(f"argument {where} of a recipe cannot be {value!r}: hand over numbers, texts, or a file's path")


def _path(value: os.PathLike[str]) -> tuple[str, Any]:
    """Return what stands for a path; where a file is, the hash of what is in it too."""
    text = os.fspath(value)
    return ("file", [text, _digest(text)]) if Path(text).is_file() else ("path", text)


def _digest(file: str) -> str:
    """Return a hash of what is in a file."""
    with Path(file).open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def files_in(text: Any) -> Iterator[tuple[str, str]]:
    """Yield the files in what stands for an argument, each with the hash of what was in it."""
    if isinstance(text, dict) and "file" in text:
        name, digest = text["file"]
        yield name, digest
    elif isinstance(text, (dict, list)):
        for part in text.values() if isinstance(text, dict) else text:
            yield from files_in(part)


def refuse_other_files(files: Iterable[tuple[str, str]]) -> None:
    """Refuse files that have another content here and now.

    Parameters
    ----------
    files : iterable of (str, str)
        Paths, and hashes of what was in them; see `files_in`.

    Raises
    ------
    RuntimeError
        If one is not here, or another one.
    """
    for name, digest in files:
        if not Path(name).is_file() or _digest(name) != digest:
            raise RuntimeError(
                f"the file {name} is not here as it was when the recipe was made: put it back, or make the recipe anew"
            )


def _class(value: Any) -> str:
    """Return the name of an object's class; folders of results know those of this package without a module."""
    kind = type(value)
    return kind.__qualname__ if kind.__module__.startswith("openmm_exactrb.") else full_name(kind)


def _coefficients(scheme: Scheme) -> dict[str, Any]:
    """Return what a scheme is by its coefficients; folders of results know it by these names."""
    names = ("name", "order", "stages", "kind", "first", "a", "b", "reference", "generalised", "c")
    fields = {name: getattr(scheme, name) for name in names}
    fields["processor"] = tuple(({"A": "drift", "B": "kick"}.get(letter, letter), c) for letter, c in scheme.processor)
    if any(letter not in "ABC" for letter, _ in scheme.word):
        fields["word"] = scheme.word
    return fields


def shown(value: Any) -> str:
    """Return a short text of an argument."""
    if isinstance(value, (FunctionType, type)):
        return value.__qualname__
    if isinstance(value, Scheme):
        return value.name
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
