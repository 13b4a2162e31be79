"""The random numbers of `openmm_exactrb.mechanics.rng`, compiled."""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from openmm_exactrb.kernels.build import compiled

_A, _B = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_KEY_A, _KEY_B = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)


@intrinsic
def _high_product(typingctx, a, b):
    """Return the upper 64 bits of the product of two 64-bit integers."""

    def generate(context, builder, signature, values):
        a, b = (builder.zext(value, ir.IntType(128)) for value in values)
        return builder.trunc(builder.lshr(builder.mul(a, b), ir.IntType(128)(64)), ir.IntType(64))

    return types.uint64(types.uint64, types.uint64), generate


@compiled("i i i i F2")
def uniforms(seed, step, stream, block, u):
    """Write four random numbers in the open interval (0, 1) for each body, from its own counter, to u (4, n)."""
    for body in range(u.shape[1]):
        k0, k1 = np.uint64(seed), np.uint64(0)
        c0, c1, c2, c3 = np.uint64(body + 1), np.uint64(block), np.uint64(stream), np.uint64(step)
        for _ in range(10):
            c0, c1, c2, c3 = _high_product(_B, c2) ^ c1 ^ k0, _B * c2, _high_product(_A, c0) ^ c3 ^ k1, _A * c0
            k0, k1 = k0 + _KEY_A, k1 + _KEY_B
        for row, word in enumerate((c0, c1, c2, c3)):
            u[row, body] = (np.float64(word >> np.uint64(11)) + 0.5) * 2.0**-53
