"""Counter-based random numbers, which depend only on the seed, the step and the stream.

The generator is NumPy's Philox4x64-10: J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw (2011),
doi:10.1145/2063384.2063405. It encrypts a counter of 256 bits with a key of 128 bits, and has no other state. In words
of 64 bits, the lowest first, the layout is::

    key     = (seed, 0)
    counter = (0, 0, stream, step)

The words of seed and step are those of signed numbers. A block of the counter is four words; the block of body n in an
array (..., N) has the lowest word n + 1, and the second word counts further blocks if the array has more than four
rows. Hence no draw depends on how many others preceded it, on where a run was interrupted, or on which engine makes the
step: kernels/random.cl of the device engine has the same numbers. The stream is the number of the substep in the step,
times `PURPOSES`, plus the purpose.

Normals are those of G. E. P. Box and M. E. Muller (1958), doi:10.1214/aoms/1177706645, of neighbouring words.
"""

from __future__ import annotations

import itertools
import math
import threading
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, Philox
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WORD = 2**64 - 1
# Words of a block.
_BLOCK = 4
# Of a gamma variate that are looked at together: one in twenty fails.
_ATTEMPTS = 8


class Purpose(IntEnum):
    """The purpose of random numbers of a substep; numbers for different purposes are independent."""

    TRANSLATION = 0
    ROTATION = 1
    METROPOLIS = 2


#: Number of purposes that a substep has room for.
PURPOSES = 16


class Instant(NamedTuple):
    """The position of a substep in a run: the seed, the step since the start, and the index of the substep."""

    seed: int
    step: int
    substep: int

    def stream(self, purpose: Purpose) -> int:
        """Return the stream of random numbers for a purpose."""
        return self.substep * PURPOSES + purpose

    def generator(self, purpose: Purpose) -> Generator:
        """Return the generator of random numbers for a purpose."""
        return generator(self.seed, self.step, self.stream(purpose))

    def normals(self, purpose: Purpose, shape: tuple[int, ...]) -> Array:
        """Return standard normal numbers for a purpose."""
        return normals(self.seed, self.step, self.stream(purpose), shape)

    def gamma(self, purpose: Purpose, shape: float) -> float:
        """Return one gamma variate for a purpose, independent of its first four normals of a body."""
        return gamma(self.seed, self.step, self.stream(purpose), shape)

    def uniform(self, purpose: Purpose) -> float:
        """Return one uniform number on [0, 1) for a purpose."""
        return float(self.generator(purpose).random())


def generator(seed: int, step: int, stream: int) -> Generator:
    """Return the generator at the first number of a stream; arguments have 64 bits, and seed and step are signed."""
    return Generator(Philox(**_address(seed, step, stream)))


def normals(seed: int, step: int, stream: int, shape: tuple[int, ...]) -> Array:
    """Return standard normal numbers of bodies, the last axis of the shape; for other arguments see `generator`."""
    *rows, n = shape
    count = math.prod(rows)
    blocks = [_normals_of(_raw(seed, step, stream, block, n)) for block in range(-(-count // _BLOCK))]
    return np.ascontiguousarray(np.concatenate([np.zeros((0, n)), *blocks])[:count].reshape(shape))


def gamma(seed: int, step: int, stream: int, shape: float) -> float:
    """Return a variate of the gamma distribution: G. Marsaglia and W. W. Tsang (2000), doi:10.1145/358407.358414.

    Attempts are the bodies of the second block. Other arguments are as of `generator`.
    """
    if shape <= 0.0:
        return 0.0
    d = (shape + 1.0 if shape < 1.0 else shape) - 1.0 / 3.0
    for n in itertools.count(_ATTEMPTS, _ATTEMPTS):
        words = _raw(seed, step, stream, 1, n)
        x, u = _normals_of(words)[0], _open_uniforms(words)
        root = 1.0 + x / math.sqrt(9.0 * d)
        v = np.where(root > 0.0, root, 1.0) ** 3
        (good,) = np.nonzero((root > 0.0) & (np.log(u[2]) < 0.5 * x * x + d * (1.0 - v + np.log(v))))
        if len(good):
            first = good[0]
            return float(d * v[first] * (u[3, first] ** (1.0 / shape) if shape < 1.0 else 1.0))
    raise AssertionError


def _raw(seed: int, step: int, stream: int, block: int, n: int) -> NDArray[np.uint64]:
    """Return words of a block of n bodies, (4, n)."""
    shared = _local.generator.bit_generator
    address = _address(seed, step, stream)
    address["counter"][1] = block
    shared.state = {"bit_generator": "Philox", "state": address, **_EMPTY}
    return np.ascontiguousarray(shared.random_raw(_BLOCK * n).reshape(n, _BLOCK).T)


def _open_uniforms(words: NDArray[np.uint64]) -> Array:
    """Return numbers in the open interval (0, 1): the 53 upper bits of words plus a half."""
    return np.asarray(((words >> np.uint64(11)) + 0.5) * 2.0**-53, dtype=np.float64)


def _normals_of(words: NDArray[np.uint64]) -> Array:
    """Return the four normals of each block (4, n)."""
    u = _open_uniforms(words)
    radius, angle = np.sqrt(-2.0 * np.log(u[::2])), 2.0 * np.pi * u[1::2]
    out = np.empty(u.shape)
    out[::2], out[1::2] = radius * np.cos(angle), radius * np.sin(angle)
    return out


def _address(seed: int, step: int, stream: int) -> dict[str, NDArray[np.uint64]]:
    """Return key and counter before the first number."""
    return {
        "key": np.array([seed & _WORD, 0], dtype=np.uint64),
        "counter": np.array([0, 0, stream, step & _WORD], dtype=np.uint64),
    }


class _Local(threading.local):
    """One generator per thread, because rewinding takes a tenth of the time of creation."""

    def __init__(self) -> None:
        self.generator = Generator(Philox())


_local = _Local()
# Apart from the address, the state of a generator that has drawn nothing.
_EMPTY = {"buffer": np.zeros(4, np.uint64), "buffer_pos": 4, "has_uint32": 0, "uinteger": 0}
