"""Short texts of values for messages."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from typing import Any

import numpy as np


def shown(value: Any) -> str:
    """Return a value as a short text of one line, without addresses in memory."""
    if hasattr(value, "__qualname__"):
        return f"the {'class' if isinstance(value, type) else 'function'} {value.__qualname__}"
    text = " ".join(reprlib.repr(value.item() if isinstance(value, np.generic) else value).split())
    return f"an object of type {type(value).__name__}" if text.startswith("<") else text


def listed(particles: Iterable[int]) -> str:
    """Return the indices of particles, separated by commas; of more than eight, only the first four and last two."""
    names = [str(particle) for particle in particles]
    return ", ".join(names if len(names) < 9 else [*names[:4], "...", *names[-2:]])
