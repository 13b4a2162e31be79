"""The switch S(r) of the energy of a pair, proportional to the integral of (s (1 - s))^6 over s."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.support.types import Array


def switched(r: Array, cutoff: float, switch: float) -> tuple[Array, Array]:
    """Return S and dS/dr at distances r; S is 1 up to `switch` and 0 beyond `cutoff`."""
    rate = 1.0 / (cutoff**2 - switch**2)
    s = np.clip(rate * (cutoff**2 - r**2), 0.0, 1.0)
    t = 2.0 * s - 1.0
    S = 0.5 + np.polynomial.polynomial.polyval(t**2, [3003, -6006, 9009, -8580, 5005, -1638, 231]) * t / 2048.0
    return S, -24024.0 * rate * r * (s * (1.0 - s)) ** 6


def sharp_volume(cutoff: float, switch: float) -> float:
    """Return 3 integral S(r) r² dr, the cube of the radius of a sharp sphere with the volume of the switched one."""
    x, weights = np.polynomial.legendre.leggauss(15)  # exact: a polynomial of degree 28
    r = switch + 0.5 * (cutoff - switch) * (1.0 + x)
    return switch**3 + 1.5 * (cutoff - switch) * float(weights @ (switched(r, cutoff, switch)[0] * r**2))
