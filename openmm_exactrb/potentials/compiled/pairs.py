"""The sum over pairs of soft dipoles, compiled in double precision.

Without a box, or in one too small for cells, the sum of every sphere runs over all others, and each pair is computed
twice. Rows are then independent, the inner loop is vectorised, and results are bit-identical for any number of threads.
"""

from __future__ import annotations

import numpy as np

from openmm_exactrb.kernels.build import at_first_call
from openmm_exactrb.kernels.threads import cores, in_threads
from openmm_exactrb.potentials.compiled import mesh
from openmm_exactrb.potentials.compiled.cells import cells, near_pairs
from openmm_exactrb.potentials.compiled.ewald import number_of_waves, reciprocal_space
from openmm_exactrb.potentials.compiled.pair import pair
from openmm_exactrb.support.types import Array

Switch = tuple[float, float, float, float, float, float, float, float, float, float]
EwaldNumbers = tuple[float, float, float] | tuple[float, mesh.Edges, int, float]

# The largest work, in the units of `_work`, that a single thread performs. With an Ewald sum, a pair costs as much as
# ten waves of a dipole, and three times as much as without screening.
_SHARED = 200_000


def soft_dipoles(
    x: Array,
    repulsion: float,
    coupling: float,
    truncation: Switch | None = None,
    threads: int | None = None,
    attraction: float = 0.0,
    minimum: tuple[float, float] | None = None,
    ewald: EwaldNumbers | None = None,
) -> tuple[float, Array]:
    """Return the energy and the forces of `potentials.SoftDipoles`, whose `energy_and_forces` describes x and threads.

    repulsion, coupling and attraction are 4 epsilon sigma^12, (strength/length)² and 4 epsilon sigma^6. `minimum`
    contains the squared distance at which the energy of the spheres is truncated, and the shift of this energy.
    `truncation` contains, in this order: the edges of the box and the square of the longer cutoff; the squared cutoff
    of the dipoles, 1/(width of their switching function in r²) and the strength of the reaction field; the squared
    cutoff of the spheres, 1/(width of their switching function in r²) and the energy that is subtracted from the energy
    of the spheres.
    """
    if ewald and truncation is None:
        raise ValueError(
            "an Ewald sum of dipoles needs a periodic box: pass box=(a, b, c), its edges in nm, to soft_dipole_force"
        )
    n = len(x) // 2
    threads = threads or (cores() if _work(n, truncation, ewald) > _SHARED else 1)
    alpha, arrows = ewald and ewald[0], _split(x)
    law = repulsion, coupling, attraction, minimum, alpha, truncation
    room = cells(truncation[:3], truncation[3]) if truncation else None
    if truncation and room:
        energy, force, field = near_pairs(arrows, n, room, law, threads)
    else:
        energies, force, field = np.empty(n), *np.empty((2, 3, n))
        rows = np.ones(n, dtype=np.int64)
        in_threads(lambda *part: _rows(*part, arrows, *law, energies, force, field), rows, threads)
        energy = 0.5 * float(energies.sum())
    if ewald and truncation:
        far, push, pull = _images(arrows, n, truncation[:3], ewald, threads)
        energy, force, field = energy + coupling * far, force + coupling * push, field + coupling * pull
    forces = np.empty((2 * n, 3))
    # `force` is for a displacement of the centre with a fixed arrow, so the centre's particle has `force` minus the
    # force on the tip.
    forces[0::2], forces[1::2] = (force - field).T, field.T
    return energy, forces


def _work(n: int, truncation: Switch | None, ewald: EwaldNumbers | None) -> float:
    """Return the work in units of the work for a pair."""
    waves = number_of_waves(truncation[:3], ewald[1]) if truncation and ewald and len(ewald) == 3 else 0.0
    return n * (n + waves / 10)


def _images(arrows: Array, n: int, edges: mesh.Edges, ewald: EwaldNumbers, threads: int) -> tuple[float, Array, Array]:
    """Return the energy, forces and fields (3, n) of the sum in reciprocal space, divided by the coupling."""
    if len(ewald) == 3:
        alpha, k_max, dielectric = ewald
        energy, forces, fields = reciprocal_space(arrows[:3], arrows[3:], edges, alpha, k_max, dielectric, threads)
        return energy, forces[:, :n], fields[:, :n]
    alpha, steps, order, dielectric = ewald
    x, y, z = (mesh.fast_size(edge / step) for edge, step in zip(edges, steps, strict=True))
    if min(x, y, z) < mesh.spline(order).shape[2]:
        raise ValueError(
            f"the shortest edge of the box, {min(edges):g} nm, is too short for the mesh of the Ewald sum, because "
            f"splines of order {order} do not fit into {min(x, y, z)} points: create the force again for a box of this "
            "size"
        )
    r, u = arrows[:3, :n].copy(), arrows[3:, :n].copy()
    return mesh.reciprocal_space(r, u, edges, alpha, (x, y, z), order, dielectric, threads)


@at_first_call
def _split(x):
    """Return the components of centres and of arrows (tip minus centre) as rows, padded to full vector registers."""
    n = len(x) // 2
    arrows = np.zeros((6, (n + 7) // 8 * 8))
    for i in range(n):
        for k in range(3):
            arrows[k, i] = x[2 * i, k]
            arrows[3 + k, i] = x[2 * i + 1, k] - x[2 * i, k]
    return arrows


@at_first_call
def _rows(first, last, arrows, repulsion, coupling, attraction, minimum, alpha, truncation, energies, forces, fields):
    """Write the forces and fields of given spheres, and twice their energies, as sums over all other spheres."""
    n = len(energies)
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
            e, a, b, c = pair(r2, uv, ur, vr, repulsion, coupling, attraction, minimum, alpha, truncation)
            energy += e
            fx, fy, fz = fx + a * x + c * ur * vx, fy + a * y + c * ur * vy, fz + a * z + c * ur * vz
            gx, gy, gz = gx + c * vr * x - b * vx, gy + c * vr * y - b * vy, gz + c * vr * z - b * vz
            turn += c * vr
        energies[i] = energy
        forces[0, i], forces[1, i], forces[2, i] = fx + turn * ux, fy + turn * uy, fz + turn * uz
        fields[0, i], fields[1, i], fields[2, i] = gx, gy, gz
