"""The random numbers of `openmm_exactrb.random.rng` in numpy: the generator Philox4x64-10, for any number of bodies.

J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw (2011), doi:10.1145/2063384.2063405.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.random.constants import PHILOX_FIRST, PHILOX_KEY, PHILOX_ROUNDS, PHILOX_SECOND_KEY, PHILOX_THIRD
from openmm_exactrb.support.types import Array

Words = NDArray[np.uint64]

_HALF, _LOW = np.uint64(32), np.uint64(0xFFFFFFFF)
_MULTIPLIERS = np.array([[PHILOX_FIRST], [PHILOX_THIRD]], dtype=np.uint64)
_INCREMENTS = np.array([[PHILOX_KEY], [PHILOX_SECOND_KEY]], dtype=np.uint64)


def uniforms(seed: int, step: int, stream: int, block: int, u: Array) -> None:
    """Write four random numbers in the open interval (0, 1) for each body, from its own counter, to u (4, n)."""
    words = np.array([[0], [block], [stream], [step]]).astype(np.uint64).repeat(u.shape[1], axis=1)
    words[0] = np.arange(1, u.shape[1] + 1, dtype=np.uint64)
    key = np.array([[seed], [0]]).astype(np.uint64)
    for _ in range(PHILOX_ROUNDS):
        even, odd = words[::2], words[1::2]
        high, low = _high_product(_MULTIPLIERS, even), _MULTIPLIERS * even
        words = np.stack([high[1] ^ odd[0] ^ key[0], low[1], high[0] ^ odd[1] ^ key[1], low[0]])
        key = key + _INCREMENTS
    u[...] = ((words >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53


def _high_product(a: Words, b: Words) -> Words:
    """Return the upper 64 bits of the products of two integers of 64 bits."""
    a_high, a_low, b_high, b_low = a >> _HALF, a & _LOW, b >> _HALF, b & _LOW
    middle = a_high * b_low + (a_low * b_low >> _HALF)
    other = a_low * b_high + (middle & _LOW)
    product: Words = a_high * b_high + (middle >> _HALF) + (other >> _HALF)
    return product
