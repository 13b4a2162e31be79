"""Names and texts of what recipes hold, the same today and tomorrow: keys are made of them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import sys
from collections.abc import Mapping
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
        If it has none.
    """
    qualified = getattr(function, "__qualname__", None)
    if not callable(function) or qualified is None or "<" in qualified:
        raise TypeError(f"a function at the top level of a module is needed, which has a name, not {function!r}")
    return f"{_module(function.__module__)}.{qualified}"


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
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return "array", [value.dtype.str, list(value.shape), digest]
    if unit.is_quantity(value):
        return "quantity", [canonical(value._value, where), str(value.unit)]
    if isinstance(value, os.PathLike):
        return "path", os.fspath(value)
    if isinstance(value, ExactRigidBodyIntegrator):  # OpenMM's XML knows neither scheme nor friction
        return type(value).__qualname__, canonical(value.getSettings(), where)
    if isinstance(value, _SERIALISABLE):
        return "openmm", hashlib.sha256(openmm.XmlSerializer.serialize(value).encode()).hexdigest()
    if isinstance(value, Scheme):
        return "Scheme", canonical(_coefficients(value), where)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return type(value).__qualname__, canonical(fields, where)
    if isinstance(value, (FunctionType, type)):
        return "function", name_of(value)
    if type(value).__module__.startswith("openmm.app") and repr(value).isidentifier():  # PME, HBonds and the like
        return "option", repr(value)
    raise TypeError(f"argument {where} of a recipe cannot be {value!r}: hand over numbers, texts, or a file's path")


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
