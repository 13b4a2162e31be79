"""Which random numbers a letter of a step gets: addresses in the noise instead of a generator with a state."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Kernels(Protocol):
    """Noise in numpy or compiled: modules with these two functions."""

    def normals(self, seed: int, step: int, stream: int, first: int, last: int, out: Array, /) -> None:
        """Write standard normals into the columns [first, last) of an array (k, N)."""

    def uniforms(self, seed: int, step: int, stream: int, first: int, last: int, out: Array, /) -> None:
        """Write numbers of (0, 1) into the columns [first, last) of an array (k, N)."""


class Purpose(IntEnum):
    """What numbers are for: those of different purposes have nothing in common."""

    TRANSLATION = 0
    ROTATION = 1
    TRANSLATION_DECISIONS = 2
    ROTATION_DECISIONS = 3
    METROPOLIS = 4


#: Purposes that a letter has room for.
PURPOSES = 16


class Instant(NamedTuple):
    """Where in a run a letter stands: all that its noise depends on, besides the body.

    Attributes
    ----------
    seed : int
    step : int
        Number of the step since the run began, as a checkpoint has it.
    letter : int
        Place of the letter in the step, from 0 to 2^20 - 1.
    """

    seed: int
    step: int
    letter: int

    def stream(self, purpose: Purpose) -> int:
        """Return the stream of numbers for a purpose here."""
        return self.letter * PURPOSES + purpose


@dataclass(frozen=True)
class Draws:
    """Random numbers by instant and purpose.

    Attributes
    ----------
    kernels : Kernels
    """

    kernels: Kernels

    def normals(self, at: Instant, purpose: Purpose, shape: tuple[int, int]) -> Array:
        """Return standard normals (k, N), column i for body i."""
        out = np.empty(shape)
        self.kernels.normals(at.seed, at.step, at.stream(purpose), 0, shape[1], out)
        return out

    def uniforms(self, at: Instant, purpose: Purpose, shape: tuple[int, int]) -> Array:
        """Return numbers of (0, 1) (k, N), column i for body i."""
        out = np.empty(shape)
        self.kernels.uniforms(at.seed, at.step, at.stream(purpose), 0, shape[1], out)
        return out

    def uniform(self, at: Instant, purpose: Purpose) -> float:
        """Return one number of (0, 1) for a decision."""
        return float(self.uniforms(at, purpose, (1, 1))[0, 0])
