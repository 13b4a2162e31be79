"""Text that represents a value identically in every process, for job keys and the identity of runs."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import openmm
from openmm import unit

_SERIALISABLE = (openmm.System, openmm.State, openmm.Force, openmm.Integrator)


def digest(content: bytes) -> str:
    """Return the first half of the SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(content).hexdigest()[:32]


def qualified_name(function: Any) -> str:
    """Return the module and name of a function or class; a script has the name under which it would be imported."""
    module, main = function.__module__, sys.modules.get("__main__")
    if module == "__main__" and main is not None:
        spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
        module = spec.name if spec is not None else Path(file).stem if file else module
    return f"{module}.{function.__qualname__}"


def stable_text(value: Any, name_of: Callable[[Any], str] = qualified_name) -> str:
    """Return JSON that is equal for equal values, in this process and in later ones.

    Parameters
    ----------
    value : object
        None, numbers, str, lists, mappings, numpy arrays, paths, Quantities, dataclasses, functions, classes, options
        such as PME, objects that OpenMM can serialise, and integrators of this package. The text of a path includes the
        content of the file.
    name_of : callable, optional
        Function that returns the name of a function or class.

    Raises
    ------
    TypeError
        If the value contains any other object.
    """
    try:
        return json.dumps(value, sort_keys=True, default=partial(_described, name_of))
    except TypeError as error:
        if not str(error).startswith("keys must be"):
            raise
        raise TypeError("cannot contain a mapping whose keys are not text: use text as keys") from None


def _described(name_of: Callable[[Any], str], value: Any) -> Any:
    """Return a JSON value for an object that JSON itself cannot represent."""
    if isinstance(value, np.generic):
        return value.item()
    if type(value) in (np.ndarray, np.memmap) and value.dtype.kind in "biufc":  # the bytes omit masks
        return {"array": [value.dtype.str, value.shape, digest(np.ascontiguousarray(value).tobytes())]}
    if unit.is_quantity(value):
        return {"quantity": [value._value, str(value.unit)]}
    if isinstance(value, os.PathLike):
        return {"path": [os.fspath(value), digest_of_file(value)]}
    if isinstance(value, openmm.Integrator) and hasattr(value, "getSettings"):  # the XML also contains the state
        return {qualified_name(type(value)): value.getSettings()}
    if isinstance(value, _SERIALISABLE):
        return {"openmm": digest(openmm.XmlSerializer.serialize(value).encode())}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {qualified_name(type(value)): fields}
    if isinstance(value, (FunctionType, type)):
        return {"function": name_of(value)}
    if type(value).__module__.startswith("openmm.app") and repr(value).isidentifier():  # such as PME and HBonds
        return {"option": repr(value)}
    kind = type(value).__name__
    raise TypeError(
        f"cannot contain an object of type {kind}: use numbers, text, lists, mappings, arrays, or the path of a file"
    )


def digest_of_file(path: str | os.PathLike[str]) -> str | None:
    """Return the digest of a file's content; None if there is no such file."""
    return digest(Path(path).read_bytes()) if Path(path).is_file() else None
