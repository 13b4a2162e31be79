"""The exact flow of the free rigid body, compiled, with the formulas and the names of `plain.exact`.

Steps with b G h <= 0.3 are computed by `_short` in blocks of bodies. `_short` has neither branches nor calls, so that
the loop over bodies is vectorised. Longer steps, steps with very large rotation angles, and steps of bodies that
have extreme momenta or rotate about axis 3, are computed by `_long`, one body at a time.
"""

import math

import numpy as np

from openmm_exactrb.kernels.build import compiled, inlined, inner
from openmm_exactrb.kernels.compiled.elliptic import LANDEN, jacobi, rescaled, third_kind, third_kind_short
from openmm_exactrb.kernels.compiled.formulas import product, separatrix_difference, sine_short, two_sum
from openmm_exactrb.kernels.compiled.rotations import (
    cosine_and_sine,
    keep_norm,
    norm_conserving,
    norm_defect,
    rotate,
    rotate_short,
    turned,
)
from openmm_exactrb.kernels.plain.exact import ON_SEPARATRIX, SAFE, SHORT, VANISHING

# Bodies per block. The distances between rows are known at compile time, so that the compiler knows that rows do not
# overlap.
_BLOCK = 64
_ROWS = 23
# The largest h G/I3 for which the reduction of the angle is exact to roundoff.
_LARGEST_ANGLE = 1e4
_SMALLEST, _LARGEST = SAFE


@inner
def _short_block(block):
    """Advance a block of bodies by short steps.

    The rows are b, rho, sigma, 1/I3, m (3), t, q (4), the new m (3), whether the step was short, and the low parts of q
    (4) and of m (3).
    """
    for i in range(_BLOCK):
        b, rho, sigma, inverse_I3 = block[i], block[_BLOCK + i], block[2 * _BLOCK + i], block[3 * _BLOCK + i]
        x1, x2, x3 = block[4 * _BLOCK + i], block[5 * _BLOCK + i], block[6 * _BLOCK + i]
        t0, t1, t2, t3, d1, d2, d3, is_short = _short(b, rho, sigma, inverse_I3, x1, x2, x3, block[7 * _BLOCK + i])
        q0, q1, q2, q3 = block[8 * _BLOCK + i], block[9 * _BLOCK + i], block[10 * _BLOCK + i], block[11 * _BLOCK + i]
        l0, l1, l2, l3 = block[16 * _BLOCK + i], block[17 * _BLOCK + i], block[18 * _BLOCK + i], block[19 * _BLOCK + i]
        p0, p1, p2, p3 = product(q0, q1, q2, q3, t0, t1, t2, t3)
        n0, n1, n2, n3 = q0 + p0, q1 + p1, q2 + p2, q3 + p3
        defect = 0.5 * norm_defect(q0, q1, q2, q3) - (n0 * l0 + n1 * l1 + n2 * l2 + n3 * l3)
        p0, l0 = two_sum(q0, p0 + n0 * defect + l0)
        p1, l1 = two_sum(q1, p1 + n1 * defect + l1)
        p2, l2 = two_sum(q2, p2 + n2 * defect + l2)
        p3, l3 = two_sum(q3, p3 + n3 * defect + l3)
        block[8 * _BLOCK + i] = p0 if is_short else q0
        block[9 * _BLOCK + i] = p1 if is_short else q1
        block[10 * _BLOCK + i] = p2 if is_short else q2
        block[11 * _BLOCK + i] = p3 if is_short else q3
        block[12 * _BLOCK + i], d1 = two_sum(x1, d1 + block[20 * _BLOCK + i])
        block[13 * _BLOCK + i], d2 = two_sum(x2, d2 + block[21 * _BLOCK + i])
        block[14 * _BLOCK + i], d3 = two_sum(x3, d3 + block[22 * _BLOCK + i])
        block[15 * _BLOCK + i] = 1.0 if is_short else 0.0
        block[16 * _BLOCK + i] = l0 if is_short else 0.0
        block[17 * _BLOCK + i] = l1 if is_short else 0.0
        block[18 * _BLOCK + i] = l2 if is_short else 0.0
        block[19 * _BLOCK + i] = l3 if is_short else 0.0
        block[20 * _BLOCK + i] = d1 if is_short else 0.0
        block[21 * _BLOCK + i] = d2 if is_short else 0.0
        block[22 * _BLOCK + i] = d3 if is_short else 0.0


@inlined
def _short(b, rho, sigma, inverse_I3, x1, x2, x3, t):
    """Return the rotation of a step minus the identity, the change of the momentum, and whether the step is short."""
    square_G = x1 * x1 + x2 * x2 + x3 * x3
    G = math.sqrt(square_G)
    hG = t * G
    flip = -1.0 if x3 < 0.0 else 1.0
    inverse_G = 1.0 / G
    y1, y2, y3 = flip * x1 * inverse_G, x2 * inverse_G, flip * x3 * inverse_G
    size = max(abs(y1), abs(y2))
    is_short = (
        (abs(b * hG) <= SHORT)
        & (abs(hG * inverse_I3) <= _LARGEST_ANGLE)
        & (G > _SMALLEST)
        & (G < _LARGEST)
        & (size > VANISHING)
    )

    x = sigma * (y3 * y3 + rho * y2 * y2)
    transverse = y1 * y1 + sigma * y2 * y2
    B, z = sigma * transverse, rho * transverse
    w = sine_short(b * hG, x, z)
    u = w * w
    cn, dn = math.sqrt(1.0 - x * u), math.sqrt(1.0 - z * u)
    half_angle = 0.5 * (hG * inverse_I3 + third_kind_short(w, x, z, B))
    cosine, sine = cosine_and_sine(half_angle)
    cn_less, dn_less = x * u / (1.0 + cn), z * u / (1.0 + dn)
    t0, t1, t2, t3, d1, d2, d3 = rotate_short(y1, y2, y3, cn, dn, w, cn_less, dn_less, sigma, rho, cosine, sine)
    d1, d2, d3 = norm_conserving(flip * d1 * G, d2 * G, flip * d3 * G, x1, x2, x3, square_G)
    return t0, flip * t1, t2, flip * t3, d1, d2, d3, is_short


@inner
def _long(body, block, i, means):
    """Advance body i of a block by a step of any length, from any momentum."""
    b, rho, sigma, inverse_I3, I1, I2, I3 = body
    t = block[7 * _BLOCK + i]
    m1, m2, m3 = block[4 * _BLOCK + i], block[5 * _BLOCK + i], block[6 * _BLOCK + i]
    largest = max(abs(m1), abs(m2), abs(m3))
    if not (largest < math.inf and abs(t) < math.inf):  # also true for nan
        for row in range(8, 15):
            block[row * _BLOCK + i] = math.nan
        return
    exponent = math.frexp(largest)[1]
    m1, m2, m3 = math.ldexp(m1, -exponent), math.ldexp(m2, -exponent), math.ldexp(m3, -exponent)
    square_G = m1 * m1 + m2 * m2 + m3 * m3
    if square_G == 0.0:
        block[12 * _BLOCK + i] = block[13 * _BLOCK + i] = block[14 * _BLOCK + i] = 0.0
        return
    G = math.sqrt(square_G)
    hG = t * math.ldexp(G, exponent)
    y1, y2, y3 = m1 / G, m2 / G, m3 / G

    distance, terms = separatrix_difference(I1, I2, I3, m1, m3)
    if abs(distance) <= ON_SEPARATRIX * terms:
        distance = 0.0
    elif I3 > I1:
        distance /= I2 * (I3 - I1)
    S = distance / (G * G)
    B = sigma * (y1 * y1 + sigma * y2 * y2)
    mirrored = S >= 0.0
    r, s = (rho, sigma) if mirrored else (sigma, rho)
    if mirrored:
        y1, y3 = y3, y1
    flip = math.copysign(1.0, y3)
    y1, y3 = flip * y1, flip * y3

    rA = r * (y3 * y3 + s * y2 * y2)
    c = math.sqrt(rA)
    kc2 = min(abs(S) / rA, 1.0) if rA > 0.0 else 1.0
    v = b * hG * c
    sn, cn, dn, half_turns = jacobi(v, kc2, means)
    w = sn / c if c > 0.0 else b * hG
    half_angle = 0.5 * (hG * inverse_I3 + third_kind(v, kc2, c, B, w, cn, dn, half_turns))
    extra_re, extra_im = (1.0, 0.0) if mirrored else (cn * dn, w)
    half_angle = -half_angle if mirrored else half_angle
    f1, f2, unit = rescaled(y1, y2)
    t0, t1, t2, t3, n1, n2, n3 = rotate(
        y1, y2, y3, f1, f2, unit, cn, dn, w, r, s, extra_re, extra_im, math.cos(half_angle), math.sin(half_angle)
    )
    t1, t3, n1, n3 = flip * t1, flip * t3, flip * n1, flip * n3
    if mirrored:
        t1, t2, t3, n1, n3 = -t3, -t2, -t1, n3, n1
    n1, n2, n3 = keep_norm(n1, n2, n3, m1, m2, m3, G, square_G)
    block[12 * _BLOCK + i] = math.ldexp(n1, exponent)
    block[13 * _BLOCK + i] = math.ldexp(n2, exponent)
    block[14 * _BLOCK + i] = math.ldexp(n3, exponent)
    q0, q1, q2, q3 = block[8 * _BLOCK + i], block[9 * _BLOCK + i], block[10 * _BLOCK + i], block[11 * _BLOCK + i]
    q0, q1, q2, q3 = turned(q0, q1, q2, q3, t0, t1, t2, t3)
    block[8 * _BLOCK + i], block[9 * _BLOCK + i], block[10 * _BLOCK + i], block[11 * _BLOCK + i] = q0, q1, q2, q3


@compiled("f2 f3 f3 f1 F3 F3")
def advance(body, q, m, t, q1, m1):
    """Advance bodies like `plain.exact.advance`; q1 and m1 may overwrite q and m."""
    block, means = np.zeros(_ROWS * _BLOCK), np.empty((2, LANDEN))
    each, every, summing = body.shape[1] > 1, t.shape[0] > 1, q.shape[0] > 1
    n = m.shape[2]
    for start in range(0, n, _BLOCK):
        length = min(_BLOCK, n - start)
        for i in range(length):
            for row in range(4):
                block[row * _BLOCK + i] = body[row, start + i if each else 0]
            block[7 * _BLOCK + i] = t[start + i if every else 0]
        for row in range(3):
            for i in range(length):
                block[(4 + row) * _BLOCK + i] = m[0, row, start + i]
                block[(20 + row) * _BLOCK + i] = m[1, row, start + i] if summing else 0.0
        for row in range(4):
            for i in range(length):
                block[(8 + row) * _BLOCK + i] = q[0, row, start + i]
                block[(16 + row) * _BLOCK + i] = q[1, row, start + i] if summing else 0.0
        for i in range(length, _BLOCK):  # padding, which must be finite
            for row in range(12):
                block[row * _BLOCK + i] = 1.0
        _short_block(block)
        for i in range(length):
            if block[15 * _BLOCK + i] == 0.0:
                _long(body[:, start + i if each else 0], block, i, means)
        for row in range(4):
            for i in range(length):
                q1[0, row, start + i] = block[(8 + row) * _BLOCK + i]
                if summing:
                    q1[1, row, start + i] = block[(16 + row) * _BLOCK + i]
        for row in range(3):
            for i in range(length):
                m1[0, row, start + i] = block[(12 + row) * _BLOCK + i]
                if summing:
                    m1[1, row, start + i] = block[(20 + row) * _BLOCK + i]
