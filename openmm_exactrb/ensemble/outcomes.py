"""What became of a recipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from openmm_exactrb.ensemble.recipes import Recipe


@dataclass(frozen=True)
class Outcome:
    """What became of a recipe.

    Attributes
    ----------
    recipe : Recipe
    result : object
        What its function returned, as JSON holds it; None if it failed.
    error : str or None
        Type and message of what it failed with.
    traceback : str or None
        Where that happened.
    seconds : float
        Wall time of the call, on its worker.
    kept : bool
        Whether it was on disk already.
    """

    recipe: Recipe
    result: Any = None
    error: str | None = None
    traceback: str | None = None
    seconds: float = 0.0
    kept: bool = False


def plain(value: Any) -> Any:
    """Return a result as it comes back from JSON, so that a fresh one equals a kept one.

    Raises
    ------
    TypeError
        If JSON cannot hold it.
    """
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: plain(item) for key, item in value.items()}
    raise TypeError(
        f"a result must be numbers, texts, lists, mappings with texts as keys, or numpy arrays, not {value!r}"
    )
