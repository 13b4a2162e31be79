"""The pair sum of soft dipoles in compiled double precision.

Every sphere sums over all others, so that a pair is computed twice: rows are independent, the inner loop is vectorised,
and any number of threads gives the same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.kernels.build import reordered
from openmm_exactrb.kernels.compiled.ewald import number_of_waves, reciprocal_space
from openmm_exactrb.kernels.compiled.pair import pair, truncated
from openmm_exactrb.kernels.threads import cores, in_threads

Array = NDArray[np.float64]
Truncation = tuple[float, float, float, float, float, float]
Ewald = tuple[float, float, float]

# Fewer pairs than this are not worth a second thread. Ten waves of a dipole cost as much as three pairs, and a screened
# pair as much as three others.
_SHARED = 200_000


def soft_dipoles(
    x: Array,
    repulsion: float,
    coupling: float,
    truncation: Truncation | None = None,
    threads: int | None = None,
    attraction: float | None = None,
    minimum: tuple[float, float] | None = None,
    ewald: Ewald | None = None,
) -> tuple[float, Array]:
    """Return the energy (kJ/mol) and the forces (kJ/mol/nm) of `potentials.soft_dipole_force`.

    Parameters
    ----------
    x : (2 n, 3) array
        Positions (nm): centre and tip of the first arrow, of the second, ...
    repulsion, coupling : float
        4 epsilon sigma^12 and (strength/length)².
    truncation : tuple of six floats, optional
        For periodic boundaries: edges of the box, squared cutoff, 1/(width of the switch in r²), strength of the
        reaction field.
    threads : int, optional
        By default all cores, where the pairs are worth it. Any number gives the same bits.
    attraction : float, optional
        4 epsilon sigma^6.
    minimum : (squared distance, depth), optional
        Where the energy of the spheres ends, raised by the depth (Weeks, Chandler and Andersen).
    ewald : (alpha, k_max, dielectric), optional
        Inverse width of the Gaussians of an Ewald sum, its largest wave number, and relative permittivity outside.
    """
    if ewald and truncation is None:
        raise ValueError("an Ewald sum needs a box")
    n = len(x) // 2
    waves = number_of_waves(truncation[:3], ewald[1]) if ewald and truncation else 0
    threads = threads or (cores() if n * (n + waves / 10) > _SHARED else 1)
    forces, energies = np.empty((2 * n, 3)), np.empty(n)
    alpha = ewald and ewald[0]

    def sum_rows(*rows: int) -> None:
        _rows(*rows, x, repulsion, coupling, attraction, minimum, alpha, truncation, energies, forces)

    in_threads(sum_rows, np.ones(n, dtype=np.int64), threads)
    energy = 0.5 * float(energies.sum())
    if ewald and truncation:
        arrows = _split(x)
        far, pull, field = reciprocal_space(arrows[:3], arrows[3:], truncation[:3], *ewald, threads)
        energy += coupling * far
        forces[0::2] += coupling * (pull - field).T[:n]
        forces[1::2] += coupling * field.T[:n]
    return energy, forces


@reordered
def _split(x):
    """Return centres and arrows (tip minus centre), component-first, padded to full vector registers."""
    n = len(x) // 2
    arrows = np.zeros((6, (n + 7) // 8 * 8))
    for i in range(n):
        for k in range(3):
            arrows[k, i] = x[2 * i, k]
            arrows[3 + k, i] = x[2 * i + 1, k] - x[2 * i, k]
    return arrows


@reordered
def _rows(first, last, sites, repulsion, coupling, attraction, minimum, alpha, truncation, energies, forces):
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
            e, a, b, c = pair(r2, uv, ur, vr, repulsion, coupling, attraction, minimum, alpha)
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
