"""Jacobi's functions and the integral of the third kind for one body, compiled; see `mathematics.elliptic`."""

import math

import numpy as np

from openmm_exactrb.kernels.build import inlined, inner
from openmm_exactrb.kernels.plain.exact import VANISHING
from openmm_exactrb.mathematics.elliptic import RULES, SEPARATRIX_LIMIT, TINY_PHASE

#: Largest number of steps of Landen's transformation.
LANDEN = 24
(_N0, _N1, _N2, _N3, _N4), (_W0, _W1, _W2, _W3, _W4) = RULES[1][0].ravel().tolist(), RULES[1][1].tolist()


@inlined
def third_kind_short(w, x, z, b):
    """Integrate b s²/((1 + b s²) sqrt((1 - x s²)(1 - z s²))) from 0 to w."""
    u = w * w
    return w * (
        _W0 * _integrand(_N0 * u, x, z, b)
        + _W1 * _integrand(_N1 * u, x, z, b)
        + _W2 * _integrand(_N2 * u, x, z, b)
        + _W3 * _integrand(_N3 * u, x, z, b)
        + _W4 * _integrand(_N4 * u, x, z, b)
    )


@inlined
def _integrand(u, x, z, b):
    return b * u / ((1.0 + b * u) * math.sqrt((1.0 - x * u) * (1.0 - z * u)))


@inner
def jacobi(v, kc2, means):
    """Return sn, cn, dn and the half turns of v, as `elliptic.jacobi` does."""
    if kc2 == 0.0:
        bounded = min(max(v, -SEPARATRIX_LIMIT), SEPARATRIX_LIMIT)
        sech = 1.0 / math.cosh(bounded)
        return math.tanh(bounded), sech, sech, 0.0
    a, g, last = 1.0, math.sqrt(kc2), -1
    converged = False
    while not converged:
        last += 1
        means[0, last], means[1, last] = a, g
        converged = abs(a - g) <= 1e-8 * a or last == LANDEN - 1
        a, g = 0.5 * (a + g), math.sqrt(a * g)
    phase = v * a
    sine, cosine = math.sin(phase), math.cos(phase)
    if abs(sine) < TINY_PHASE:
        sn, cn, dn = v, math.copysign(1.0, cosine), 1.0
    else:
        t = cosine / sine
        c = a * t
        dn = 1.0
        for k in range(last, -1, -1):
            t = c * t
            c = dn * c
            dn = (means[1, k] + t) / (means[0, k] + t)
            t = c / means[0, k]
        sn = math.copysign(1.0 / math.hypot(1.0, c), sine)
        cn = c * sn
    odd = 1.0 if cn < 0.0 else 0.0
    return sn, cn, dn, odd + 2.0 * np.rint(0.5 * (phase / math.pi - odd))


@inner
def third_kind(v, kc2, c, b, w, cn, dn, half_turns):
    """Integrate b w²/(1 + b w²) over v/c from 0 to v, as `elliptic.third_kind` does."""
    if kc2 == 0.0:
        if b == 0.0:
            return 0.0
        beta, root = b / (c * c), math.sqrt(b)
        return beta / (1.0 + beta) * (v / c - math.atan(root * w) / root)
    reduced = -w if cn < 0.0 else w
    integral = b / 3.0 * reduced**3 * carlson_rj(cn * cn, dn * dn, 1.0, 1.0 + b * w * w)
    if half_turns != 0.0:
        beta = b / (c * c)
        integral += 2.0 / 3.0 * half_turns * beta / c * carlson_rj(0.0, kc2, 1.0, 1.0 + beta)
    return integral


@inner
def carlson_rj(x, y, z, p):
    """Return Carlson's integral R_J(x, y, z, p) for 0 <= x, y, z <= p, where at most one of x, y, z is zero.

    The duplication theorem is applied before the series of DLMF 19.36.1-2. B. C. Carlson, Numer. Algorithms 10, 13
    (1995), doi:10.1007/BF02198293.
    """
    delta = (p - x) * (p - y) * (p - z)
    mean = 0.2 * (x + y + z + 2.0 * p)
    spread = 400.0 * max(abs(mean - x), abs(mean - y), abs(mean - z), abs(mean - p))
    dx, dy, dz = mean - x, mean - y, mean - z
    scale, total = 1.0, 0.0
    while scale * spread >= mean:
        rx, ry, rz, rp = math.sqrt(x), math.sqrt(y), math.sqrt(z), math.sqrt(p)
        d = (rp + rx) * (rp + ry) * (rp + rz)
        root = math.sqrt(scale**3 * delta) / d
        total += scale / d * (math.atan(root) / root if root > 1e-9 else 1.0)
        step = rx * (ry + rz) + ry * rz
        x, y, z, p = 0.25 * (x + step), 0.25 * (y + step), 0.25 * (z + step), 0.25 * (p + step)
        mean = 0.25 * (mean + step)
        scale *= 0.25
    factor = scale / mean
    X, Y, Z = dx * factor, dy * factor, dz * factor
    P = -0.5 * (X + Y + Z)
    E2 = X * Y + X * Z + Y * Z - 3.0 * P * P
    E3 = X * Y * Z + 2.0 * E2 * P + 4.0 * P * P * P
    E4 = (2.0 * X * Y * Z + E2 * P + 3.0 * P * P * P) * P
    E5 = X * Y * Z * P * P
    series = (
        1.0
        - 3 / 14 * E2
        + E3 / 6
        + 9 / 88 * E2 * E2
        - 3 / 22 * E4
        - 9 / 52 * E2 * E3
        + 3 / 26 * E5
        - E2 * E2 * E2 / 16
        + 3 / 40 * E3 * E3
        + 3 / 20 * E2 * E4
        + 45 / 272 * E2 * E2 * E3
        - 9 / 68 * (E3 * E4 + E2 * E5)
    )
    return scale * series / (mean * math.sqrt(mean)) + 6.0 * total


@inlined
def rescaled(y1, y2):
    """Return (y1, y2)/unit and unit. The unit is 1, or a power of two if eighth powers would underflow.

    If y1 and y2 are both zero, return (0, 1) and the unit 0.
    """
    size = max(abs(y1), abs(y2))
    if size >= VANISHING:
        return y1, y2, 1.0
    if size == 0.0:
        return 0.0, 1.0, 0.0
    exponent = math.frexp(size)[1]
    return math.ldexp(y1, -exponent), math.ldexp(y2, -exponent), math.ldexp(1.0, exponent)
