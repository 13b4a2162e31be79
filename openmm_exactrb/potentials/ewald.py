"""The splitting of an Ewald sum of dipoles for a given tolerance."""

from __future__ import annotations

import math

from openmm_exactrb import kernels

#: The most waves of a sum: so many take 100 MB, and 1 ms a dipole.
MOST_WAVES = 1_000_000


def splitting(
    n: int, box: tuple[float, float, float], cutoff: float, switch: float, tolerance: float
) -> tuple[float, float]:
    """Return the inverse width of the Gaussians, alpha, and the largest wave number (1/nm) for n dipoles.

    The truncation error of either sum is exp(-x²), x = alpha switch or y = k_max/(2 alpha), times powers of x or y and
    of a, alpha times the distance between dipoles, as sums over random dipoles have them. Their factors are the largest
    that were measured in liquids and gases of 8 to 256 dipoles. Lengths are in nm; the tolerance is relative to the
    root mean square of forces and fields.

    Raises
    ------
    ValueError
        If more than `MOST_WAVES` are needed.
    """
    switch = max(switch, 1e-3 * cutoff)  # refused below, and not a division by zero
    x = y = 3.0
    distance = (math.prod(box) / n) ** (1.0 / 3.0)
    for _ in range(60):
        a = x * distance / switch
        x = math.log(max(a**2.5 * x**1.5 / tolerance, math.e)) ** 0.5
        y = math.log(max(0.7 * a**2.5 * y**1.5 / tolerance, 0.9 * a**3 * y / tolerance, math.e)) ** 0.5
    alpha = x / switch
    waves = kernels.load("pairs", "numba").number_of_waves(box, 2.0 * alpha * y)
    if waves > MOST_WAVES:
        raise ValueError(
            f"an Ewald sum with a switch at {switch:g} nm and a tolerance of {tolerance:g} needs {waves:.2g} waves, "
            f"more than {MOST_WAVES}: let the switch begin farther out, or ask for less"
        )
    return alpha, 2.0 * alpha * y
