"""The pair sum of soft dipoles in compiled double precision. Importing this imports numba: see `compiled`.

Every sphere sums over all others, so that a pair is computed twice: the rows are independent, the inner loop runs in
vector registers, and any number of threads gives the same bits.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.kernels import reordered as _compiled

Array = NDArray[np.float64]
Truncation = tuple[float, float, float, float, float, float]

# Fewer pairs than this are not worth a second thread, which costs about 50 microseconds.
_SHARED = 200_000


def soft_dipoles(
    x: Array,
    repulsion: float,
    coupling: float,
    truncation: Truncation | None = None,
    threads: int | None = None,
    attraction: float | None = None,
) -> tuple[float, Array]:
    """Return the energy and the forces on centres and tips, as `potentials.soft_dipole_force` defines them.

    Parameters
    ----------
    x : (2 n, 3) array
        Positions (nm): centre and tip of the first arrow, of the second, ...
    repulsion, coupling : float
        4 epsilon sigma^12 and (strength/length)².
    truncation : tuple of six floats, optional
        Edges of the box, squared cutoff, 1/(width of the switch in r²), strength of the reaction field. With it the
        boundaries are periodic.
    threads : int, optional
        All cores, or what NUMBA_NUM_THREADS says, where the pairs are worth it. Any number gives the same bits.
    attraction : float, optional
        4 epsilon sigma^6; without it there is nothing to pay for it.

    Returns
    -------
    energy : float
        In kJ/mol.
    forces : (2 n, 3) array
        In kJ/mol/nm.
    """
    n = len(x) // 2
    forces, energies = np.empty((2 * n, 3)), np.empty(n)
    if threads is None:
        threads = numba.config.NUMBA_NUM_THREADS if n * n > _SHARED else 1
    ours, *others = pairwise(n * k // threads for k in range(threads + 1))

    def sum_rows(first: int, last: int) -> None:
        _rows(first, last, x, repulsion, coupling, attraction, truncation, energies, forces)

    waiting = [_pool(os.getpid()).submit(sum_rows, *rows) for rows in others]
    sum_rows(*ours)
    for rows in waiting:
        rows.result()
    return 0.5 * float(energies.sum()), forces


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process; a fork needs its own."""
    return ThreadPoolExecutor(max(1, numba.config.NUMBA_NUM_THREADS - 1), f"soft-dipoles-{process}")


@_compiled
def _split(x):
    """Return centres and arrows (tip minus centre), component-first, with room to fill vector registers."""
    n = len(x) // 2
    arrows = np.zeros((6, (n + 7) // 8 * 8))
    for i in range(n):
        for k in range(3):
            arrows[k, i] = x[2 * i, k]
            arrows[3 + k, i] = x[2 * i + 1, k] - x[2 * i, k]
    return arrows


@_compiled
def pair(r2, uv, ur, vr, repulsion, coupling, attraction=None):
    """Return energy, and a, b, c of the force a r + c (ur v + vr u) on the centre and c vr r - b v on the tip."""
    i = 1.0 / r2
    core = repulsion * (i * i * i) * (i * i * i)
    slope = 12.0 * core
    if attraction is not None:
        i3 = attraction * (i * i * i)
        core -= i3
        slope -= 6.0 * i3
    b = coupling * i * math.sqrt(i)
    c = 3.0 * b * i
    return core + b * uv - c * ur * vr, i * slope + c * (uv - 5.0 * i * ur * vr), b, c


@_compiled
def truncated(r2, uv, energy, a, b, c, coupling, truncation):
    """Add the reaction field, and multiply by a switch S(r²) that is smooth to the third derivative."""
    _, _, _, end, rate, reaction = truncation
    b -= coupling * reaction
    energy -= coupling * reaction * uv
    s = min(1.0, max(0.0, (end - r2) * rate))
    S = s * s * s * s * (35.0 - s * (84.0 - s * (70.0 - 20.0 * s)))
    slope = -140.0 * rate * (s * (1.0 - s)) ** 3
    return S * energy, S * a - 2.0 * slope * energy, S * b, S * c


@_compiled
def _rows(first, last, sites, repulsion, coupling, attraction, truncation, energies, forces):
    """Sum twice the energy, and the forces, of some spheres with all others."""
    n, arrows = len(energies), _split(sites)
    for i in range(first, last):
        xi, yi, zi, ux, uy, uz = arrows[:, i]
        energy = fx = fy = fz = gx = gy = gz = turn = 0.0
        for j in range(arrows.shape[1]):
            x, y, z = xi - arrows[0, j], yi - arrows[1, j], zi - arrows[2, j]
            vx, vy, vz = arrows[3, j], arrows[4, j], arrows[5, j]
            if truncation is not None:
                x -= truncation[0] * np.rint(x / truncation[0])
                y -= truncation[1] * np.rint(y / truncation[1])
                z -= truncation[2] * np.rint(z / truncation[2])
            r2 = x * x + y * y + z * z if (j != i) & (j < n) else np.inf
            uv, ur, vr = ux * vx + uy * vy + uz * vz, ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
            e, a, b, c = pair(r2, uv, ur, vr, repulsion, coupling, attraction)
            if truncation is not None:
                e, a, b, c = truncated(r2, uv, e, a, b, c, coupling, truncation)
            energy += e
            fx, fy, fz = fx + a * x + c * ur * vx, fy + a * y + c * ur * vy, fz + a * z + c * ur * vz
            gx, gy, gz = gx + c * vr * x - b * vx, gy + c * vr * y - b * vy, gz + c * vr * z - b * vz
            turn += c * vr
        energies[i] = energy
        # The potential moves a centre at a fixed arrow: its particle loses what the tip gets.
        forces[2 * i] = fx + turn * ux - gx, fy + turn * uy - gy, fz + turn * uz - gz
        forces[2 * i + 1] = gx, gy, gz
