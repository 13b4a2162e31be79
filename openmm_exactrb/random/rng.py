"""Counter-based random numbers, which depend only on the seed, the step and the stream.

The generator is NumPy's Philox4x64-10: J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw (2011),
doi:10.1145/2063384.2063405. The generator encrypts a counter of 256 bits with a key of 128 bits, and has no other
state. In words of 64 bits, the lowest first, the layout is::

    key     = (seed, 0)
    counter = (0, 0, stream, step)

Seed and step are encoded as signed integers. Each value of the counter yields a block of four words. In an array (...,
N), the counter of body n has the lowest word n + 1. The second word is the index of the block. An array of more than
four rows has several blocks. Hence a random number does not depend on how many numbers were drawn before it, on where a
run was interrupted, or on the engine that performs the step. In the native engine, random.cl generates the same
numbers. The stream is the index of the heat exchange in the step times `PURPOSES`, plus the purpose.

Normal variates are computed from neighbouring words by the method of G. E. P. Box and M. E. Muller (1958),
doi:10.1214/aoms/1177706645.
"""

from __future__ import annotations

import itertools
import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from openmm_exactrb.library import functions
from openmm_exactrb.random import philox
from openmm_exactrb.support.types import Array

# Number of words in a block.
_BLOCK = 4
# Number of attempts at a gamma variate that are evaluated together. One attempt in twenty fails.
_ATTEMPTS = 8


class Purpose(IntEnum):
    """The purpose of the random numbers of a substep; numbers for different purposes are independent."""

    TRANSLATION = 0
    ROTATION = 1
    METROPOLIS = 2


#: Number of purposes that are reserved for each substep.
PURPOSES = 16


class Instant(NamedTuple):
    """The identity of a random substep, such as a heat exchange: seed, number of the step, and index in the step."""

    seed: int
    step: int
    substep: int

    def uniforms(self, purpose: Purpose, n: int) -> Array:
        """Return uniform random numbers (n,) in (0, 1) for a purpose, one for each of n bodies."""
        first: Array = self._uniforms(purpose, 0, 1, n)[0]
        return first

    def normals(self, purpose: Purpose, shape: tuple[int, ...]) -> Array:
        """Return standard normal numbers for a purpose; the last axis of the shape runs over bodies."""
        *rows, n = shape
        count = math.prod(rows)
        return _normals_of(self._uniforms(purpose, 0, -(-count // _BLOCK), n))[:count].reshape(shape)

    def gamma(self, purpose: Purpose, shape: float) -> float:
        """Return a gamma variate of a given shape for a purpose, independent of the first four normals of each body.

        The method is that of G. Marsaglia and W. W. Tsang (2000), doi:10.1145/358407.358414. Successive attempts use
        the numbers of successive bodies in the second block.
        """
        if shape <= 0.0:
            return 0.0
        d = (shape + 1.0 if shape < 1.0 else shape) - 1.0 / 3.0
        for n in itertools.count(_ATTEMPTS, _ATTEMPTS):
            u = self._uniforms(purpose, 1, 1, n)
            x = _normals_of(u)[0]
            root = 1.0 + x / math.sqrt(9.0 * d)
            v = np.where(root > 0.0, root, 1.0) ** 3
            (good,) = np.nonzero((root > 0.0) & (np.log(u[2]) < 0.5 * x * x + d * (1.0 - v + np.log(v))))
            if len(good):
                first = good[0]
                return float(d * v[first] * (u[3, first] ** (1.0 / shape) if shape < 1.0 else 1.0))
        raise AssertionError

    def _uniforms(self, purpose: Purpose, first: int, blocks: int, n: int) -> Array:
        """Return uniform random numbers (4 blocks, n) in the open interval (0, 1), from blocks of n bodies."""
        u = np.empty((_BLOCK * blocks, n))
        for block in range(blocks):
            rows = u[_BLOCK * block : _BLOCK * (block + 1)]
            instant = self.seed, self.step, self.substep * PURPOSES + purpose, first + block
            if functions.available():
                functions.call("uniforms", n, np.array(instant, dtype=np.int64), rows)
            else:
                philox.uniforms(*instant, rows)
        return u


def _normals_of(u: Array) -> Array:
    """Return standard normal numbers from uniform numbers; each pair of neighbouring rows yields two rows."""
    radius, angle = np.sqrt(-2.0 * np.log(u[::2])), 2.0 * np.pi * u[1::2]
    out = np.empty(u.shape)
    out[::2], out[1::2] = radius * np.cos(angle), radius * np.sin(angle)
    return out
