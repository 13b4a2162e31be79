"""The arithmetic of a pair of soft dipoles, inlined into the sums over pairs."""

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from openmm_exactrb.kernels.build import at_first_call, inlined

# Distance in widths of the Gaussian beyond which a screened dipole is neglected: exp(-6.5²) is 4e-19.
_FAR = 6.5


def _polynomial(coefficients):
    """Return a function that evaluates a polynomial as four independent polynomials in x^4."""
    C = np.zeros((-(-len(coefficients) // 4), 4))
    C.flat[: len(coefficients)] = coefficients
    highest, rest = tuple(map(float, C[-1])), C[-2::-1].copy()

    @inlined
    def polynomial(x):
        a, b, c, d = highest
        square = x * x
        fourth = square * square
        for k in range(len(rest)):
            a, b = a * fourth + rest[k, 0], b * fourth + rest[k, 1]
            c, d = c * fourth + rest[k, 2], d * fourth + rest[k, 3]
        return (a + b * x) + (c + d * x) * square

    return polynomial


def _scaled_erfc(t):  # importing scipy for erfcx would take half as long as importing numba
    x = 2.0 * (1.0 + t) / (1.0 - t)
    return math.exp(x * x) * math.erfc(x)


# Polynomials, because library calls would not be vectorised. They approximate the 32nd root of exp(-s) in s about its
# middle, and exp(x²) erfc(x) in t = (x - 2)/(x + 2).
_MIDDLE = 0.5 * _FAR**2
_root_of_exp = _polynomial([math.exp(-_MIDDLE / 32.0) / math.factorial(k) for k in range(17)])
_erfcx = _polynomial(
    Chebyshev.interpolate(np.vectorize(_scaled_erfc), 19, [-1.0, (_FAR - 2.0) / (_FAR + 2.0)])
    .convert(kind=Polynomial)
    .coef
)


@inlined
def screened(r2, i, alpha):
    """Return B1, B2, B3 of a pair with the energy B1 u.v - B2 u.r v.r, where dB1/dr = -r B2 and dB2/dr = -r B3."""
    s = min(alpha * alpha * r2, _FAR**2)
    x = math.sqrt(s)
    gauss = _root_of_exp((_MIDDLE - s) / 32.0)
    for _ in range(5):
        gauss *= gauss
    slope = 2.0 / math.sqrt(math.pi) * x * gauss
    b1 = gauss * _erfcx((x - 2.0) / (x + 2.0)) + slope
    b2 = 3.0 * b1 + 2.0 * s * slope
    b3 = 5.0 * b2 + 4.0 * s * s * slope
    b = i * alpha / x  # 1/r³ within the range of the screened dipole
    return b * b1, b * i * b2, b * i * i * b3


@inlined
def pair(r2, uv, ur, vr, repulsion, coupling, attraction, minimum, alpha, truncation):
    """Return the energy, and a, b, c of the force a r + c (ur v + vr u) on the centre and c vr r - b v on the tip."""
    i = 1.0 / r2
    core = repulsion * (i * i * i) * (i * i * i)
    slope = 12.0 * core
    i3 = attraction * (i * i * i)
    core -= i3
    slope -= 6.0 * i3
    if minimum is not None:
        core = core + minimum[1] if r2 < minimum[0] else 0.0
        slope = slope if r2 < minimum[0] else 0.0
    if alpha is None:
        b = coupling * i * math.sqrt(i)
        c = 3.0 * b * i
        d = 5.0 * c * i
    else:
        b, c, d = screened(r2, i, alpha)
        b, c, d = coupling * b, coupling * c, coupling * d
    if truncation is None:
        return core + b * uv - c * ur * vr, i * slope + c * uv - d * ur * vr, b, c
    return truncated(r2, uv, core, i * slope, b * uv - c * ur * vr, c * uv - d * ur * vr, b, c, coupling, truncation)


@at_first_call
def truncated(r2, uv, core, slope, energy, a, b, c, coupling, truncation):
    """Add the reaction field to the dipole part, and multiply the dipole and sphere parts by switching functions.

    A switching function S(r²) has six continuous derivatives. The energy of the spheres is shifted before it is
    switched.
    """
    _, _, _, _, end, rate, reaction, end_of_core, rate_of_core, shift = truncation
    b -= coupling * reaction
    energy -= coupling * reaction * uv
    core -= shift
    S, dS = switched(r2, end, rate)
    T, dT = switched(r2, end_of_core, rate_of_core)
    return S * energy + T * core, S * a - 2.0 * dS * energy + T * slope - 2.0 * dT * core, S * b, S * c


@inlined
def switched(r2, end, rate):
    """Return the switching function S(r²) and its derivative with respect to r²."""
    s = min(1.0, max(0.0, (end - r2) * rate))
    t = 2.0 * s - 1.0
    u = t * t
    odd = 3003.0 - u * (6006.0 - u * (9009.0 - u * (8580.0 - u * (5005.0 - u * (1638.0 - u * 231.0)))))
    return 0.5 + t * odd / 2048.0, -12012.0 * rate * (s * (1.0 - s)) ** 6
