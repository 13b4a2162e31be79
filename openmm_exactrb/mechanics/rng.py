"""Counter-based random numbers: each depends on the seed, the step and the stream, and on nothing else.

The generator is NumPy's Philox4x64-10: J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw (2011),
doi:10.1145/2063384.2063405. It encrypts a counter of 256 bits with a key of 128 bits, and has no other state. In words
of 64 bits, the lowest first, the layout is::

    key     = (seed, 0)
    counter = (0, 0, stream, step)

The words of seed and step are those of signed numbers. Only the two lower words of the counter run while the numbers of
an array are drawn, so that no two arrays share a block. Hence no draw depends on how many others preceded it, or on
where a run was interrupted. The stream is the number of the substep in the step, times `PURPOSES`, plus the purpose.

NumPy keeps the bits of Philox, but may improve the transformation to normals (NEP 19): a trajectory is repeated to the
bit with the same release of NumPy.
"""

from __future__ import annotations

import threading
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, Philox
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WORD = 2**64 - 1


class Purpose(IntEnum):
    """What random numbers of a substep are used for; numbers of different purposes are independent."""

    TRANSLATION = 0
    ROTATION = 1
    METROPOLIS = 2


#: Number of purposes that a substep has room for.
PURPOSES = 16


class Instant(NamedTuple):
    """The place of a substep in a run: the seed, the step since the run began, and the number of the substep in it."""

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

    def uniform(self, purpose: Purpose) -> float:
        """Return one number uniform on [0, 1) for a purpose."""
        return float(self.generator(purpose).random())


def generator(seed: int, step: int, stream: int) -> Generator:
    """Return the generator that starts at the first number of a stream; all are of 64 bits, seed and step signed."""
    return Generator(Philox(**_address(seed, step, stream)))


def normals(seed: int, step: int, stream: int, shape: tuple[int, ...]) -> Array:
    """Return standard normal numbers; arguments as of `generator`."""
    shared = _local.generator
    address = _address(seed, step, stream)
    shared.bit_generator.state = {"bit_generator": "Philox", "state": address, **_EMPTY}
    return shared.standard_normal(shape)


def _address(seed: int, step: int, stream: int) -> dict[str, NDArray[np.uint64]]:
    """Return key and counter in front of the first number."""
    return {
        "key": np.array([seed & _WORD, 0], dtype=np.uint64),
        "counter": np.array([0, 0, stream, step & _WORD], dtype=np.uint64),
    }


class _Local(threading.local):
    """A generator of each thread: to rewind one costs a tenth of making one."""

    def __init__(self) -> None:
        self.generator = Generator(Philox())


_local = _Local()
# Beside the address, the state of a generator that has drawn nothing.
_EMPTY = {"buffer": np.zeros(4, np.uint64), "buffer_pos": 4, "has_uint32": 0, "uinteger": 0}
