"""Random numbers that are looked up, not drawn one after the other: the twin in numpy.

Philox4x32-10 turns a counter and a key into 128 random bits: J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw
(2011), doi:10.1145/2063384.2063405. Here the key is the seed, and the counter says what the number is for: the body
(column), the stream and pair of rows, the step. So a number depends on nothing else, in particular not on threads,
on the order of calls, or on where a run was interrupted. Two numbers of a block become two normals: G. E. P. Box and
M. E. Muller (1958), doi:10.1214/aoms/1177706645.

The formulas are elementwise and use only what IEEE 754 rounds correctly, + - * / and the square root, and bits. Those
of `philox`, `unit`, `radius` and `direction` are the compiled twin's too, so that both give the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# What a formula takes and gives: arrays of uint64, of float64, and single ones where it is compiled.
Word = Any
Real = Any

#: A counter has the stream in the upper bits of a word and the pair of rows in the lower ones.
PAIRS = 256
#: What fits beside it.
STREAMS = 2**32 // PAIRS

_FACTORS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _32 = np.uint64(0xFFFFFFFF), np.uint64(32)

_NONE, _SWAPPED, _NEGATIVE, _TO_SIGN = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(62)
_MANTISSA, _12, _52 = np.uint64(2**52 - 1), np.uint64(12), np.uint64(52)
_ONE = np.float64(1.0).view(np.uint64)
_ROOT = np.float64(math.sqrt(0.5)).view(np.uint64)
_2_TO_52 = np.float64(2.0**52).view(np.uint64)
_BIASED = 2.0**52 + 1023.0

# log 2 as a number of 42 bits, so that its products with exponents are exact, and the rest.
_LOG_2 = float.fromhex("0x1.62e42fefa38p-1")
_LOG_2_REST = float.fromhex("0x1.ef35793c7673p-45")
_HALF_PI = 0.5 * math.pi

# Series of 2 artanh(s) - 2 s by s², of sin(t) - t by t³, and of cos(t) - 1 + t²/2 by t⁴. What they leave out is below
# 2^-54 of the result, since artanh needs |s| <= 3 - sqrt(8) and the others |t| <= pi/4.
_L3, _L5, _L7, _L9, _L11, _L13, _L15, _L17, _L19 = (2.0 / k for k in range(3, 20, 2))
_S3, _S5, _S7, _S9, _S11, _S13, _S15 = ((-1.0) ** (k // 2) / math.factorial(k) for k in range(3, 16, 2))
_C4, _C6, _C8, _C10, _C12, _C14, _C16 = ((-1.0) ** (k // 2) / math.factorial(k) for k in range(4, 17, 2))


def philox(c0: Word, c1: Word, c2: Word, c3: Word, k0: Word, k1: Word) -> tuple[Word, Word, Word, Word]:
    """Return four words of 32 random bits for four words of a counter and two of a key."""
    for _ in range(10):
        product0, product1 = _FACTORS[0] * c0, _FACTORS[1] * c2
        c0, c1, c2, c3 = (product1 >> _32) ^ c1 ^ k0, product1 & _LOW, (product0 >> _32) ^ c3 ^ k1, product0 & _LOW
        k0, k1 = (k0 + _WEYL[0]) & _LOW, (k1 + _WEYL[1]) & _LOW
    return c0, c1, c2, c3


def unit(high: Word, low: Word) -> Real:
    """Return a number of (0, 1), an odd multiple of 2^-53, from the upper 52 bits of two words."""
    return np.uint64(((high << _32 | low) >> _12) | _ONE).view(np.float64) - 1.0 + 2.0**-53


def radius(u: Real) -> Real:
    """Return sqrt(-2 log u), the distance of two normals from zero, for u in (0, 1)."""
    # u = m 2^k with m next to one: log u = k log 2 + 2 artanh(s).
    bits = np.float64(u).view(np.uint64) + (_ONE - _ROOT)
    k = np.uint64(bits >> _52 | _2_TO_52).view(np.float64) - _BIASED
    m = np.uint64((bits & _MANTISSA) + _ROOT).view(np.float64)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    rest = z * (_L3 + z * (_L5 + z * (_L7 + z * (_L9 + z * (_L11 + z * (_L13 + z * (_L15 + z * (_L17 + z * _L19))))))))
    return np.sqrt(-2.0 * (k * _LOG_2 + (2.0 * s + (s * rest + k * _LOG_2_REST))))


def direction(v: Real, choice: Word) -> tuple[Real, Real]:
    """Return a point of the unit circle for v in (0, 1) and one of its four quarters for two further bits."""
    t = (v - 0.5) * _HALF_PI
    z = t * t
    c = 1.0 + z * (-0.5 + z * (_C4 + z * (_C6 + z * (_C8 + z * (_C10 + z * (_C12 + z * (_C14 + z * _C16)))))))
    s = t + t * z * (_S3 + z * (_S5 + z * (_S7 + z * (_S9 + z * (_S11 + z * (_S13 + z * _S15))))))
    cosine, sine = np.float64(c).view(np.uint64), np.float64(s).view(np.uint64)
    swap = (cosine ^ sine) & (_NONE - (choice & _SWAPPED))
    sign = (choice & _NEGATIVE) << _TO_SIGN
    return np.uint64(cosine ^ swap ^ sign).view(np.float64), np.uint64(sine ^ swap ^ sign).view(np.float64)


def normals(seed: int, step: int, stream: int, first: int, last: int, out: Array) -> None:
    """Write standard normals into columns of an array.

    Parameters
    ----------
    seed, step : int
        Those of a signed number of 64 bits.
    stream : int
        Below `STREAMS`: what the numbers are for.
    first, last : int
        The columns [first, last) are written.
    out : (k, N) array
        ``out[i, j]`` depends on seed, step, stream, i and j only, whatever k and N. At most 2 `PAIRS` rows.
    """
    _fill(seed, step, stream, first, last, out, _normals)


def uniforms(seed: int, step: int, stream: int, first: int, last: int, out: Array) -> None:
    """Write numbers of (0, 1), odd multiples of 2^-53, into columns of an array; see `normals`."""
    _fill(seed, step, stream, first, last, out, _uniforms)


def _normals(a: Word, b: Word, c: Word, d: Word) -> tuple[Real, Real]:
    r = radius(unit(a, b))
    x, y = direction(unit(c, d), d)
    return r * x, r * y


def _uniforms(a: Word, b: Word, c: Word, d: Word) -> tuple[Real, Real]:
    return unit(a, b), unit(c, d)


def _fill(
    seed: int,
    step: int,
    stream: int,
    first: int,
    last: int,
    out: Array,
    pair: Callable[[Word, Word, Word, Word], tuple[Real, Real]],
) -> None:
    pairs = np.arange((len(out) + 1) // 2, dtype=np.uint64)[:, None] + np.uint64(stream * PAIRS)
    columns = np.arange(first, last, dtype=np.uint64)
    x, y = pair(*philox(columns, pairs, *_words(step), *_words(seed)))
    out[0::2, first:last] = x
    out[1::2, first:last] = y[: len(out) // 2]


def _words(number: int) -> tuple[Word, Word]:
    """Return the low and the high word of a number of 64 bits."""
    words = np.array([number & 0xFFFFFFFF, number >> 32 & 0xFFFFFFFF], dtype=np.uint64)
    return words[:1], words[1:]
