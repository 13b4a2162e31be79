"""Settings as text that is the same in every process, and differs where they do."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from types import CodeType
from typing import Any

import numpy as np
from openmm import unit

_ADDRESS = re.compile(r" at 0x[0-9a-f]+")


def text_of(value: Any) -> str:
    """Return a setting as text: arrays by a hash of all of their bytes, functions and classes by their names."""
    if isinstance(value, np.ndarray):
        return f"array {value.shape} of {value.dtype}, {hash_of(np.ascontiguousarray(value).tobytes())}"
    if unit.is_quantity(value):
        return f"{text_of(value._value)} {value.unit}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name}: {text_of(of)}" for name, of in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(text_of, value)) + "]"
    if callable(value) and hasattr(value, "__qualname__"):
        return f"{value.__module__}.{value.__qualname__}"
    return _ADDRESS.sub("", str(value))


def text_of_function(function: Any) -> str:
    """Return name and code of a function; what it remembers beside its code is not seen."""
    code = getattr(function, "__code__", None)
    return text_of(function) + (f", {hash_of(_bytes_of(code))}" if code else "")


def _bytes_of(code: CodeType) -> bytes:
    inner = [_bytes_of(constant) if isinstance(constant, CodeType) else repr(constant) for constant in code.co_consts]
    return code.co_code + repr((inner, code.co_names)).encode()


def hash_of(content: bytes) -> str:
    """Return the beginning of the SHA-256 of some bytes."""
    return f"hash {hashlib.sha256(content).hexdigest()[:16]}"
