"""How an Ewald sum of dipoles is split in two for a wanted error."""

from __future__ import annotations

import math

from openmm_exactrb.potentials import compiled

#: The most waves of a sum: so many take 100 MB, and 1 ms a dipole.
MOST_WAVES = 1_000_000


def splitting(
    n: int, box: tuple[float, float, float], cutoff: float, switch: float, tolerance: float
) -> tuple[float, float]:
    """Return inverse width of the clouds, alpha, and largest wave number, both in 1/nm.

    What is left out of either sum is a Gaussian, exp(-x²) with x = alpha switch or y = k_max/(2 alpha), times powers of
    x or y and of a, alpha times the distance between dipoles: the sums over random dipoles have these powers. The
    factors before them are the largest that were measured in liquids and gases of 8 to 256 dipoles.

    Parameters
    ----------
    n : int
        Number of dipoles.
    box : three float
        Edges in nm.
    cutoff, switch : float
        Where the sum over pairs ends, and where its switch begins, in nm.
    tolerance : float
        Error of forces and fields, as a part of their root mean square.

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
    waves = compiled.pair_sum().number_of_waves(box, 2.0 * alpha * y)
    if waves > MOST_WAVES:
        raise ValueError(
            f"an Ewald sum with a switch at {switch:g} nm and a tolerance of {tolerance:g} needs {waves:.2g} waves, "
            f"more than {MOST_WAVES}: let the switch begin farther out, or ask for less"
        )
    return alpha, 2.0 * alpha * y
