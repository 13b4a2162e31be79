"""A priori root mean square errors of an Ewald sum of dipoles.

The errors are those of dipoles with random positions and directions, as in Kolafa and Perram, Mol. Simul. 9, 351
(1992), divided by the forces and fields of random dipoles on a cubic lattice. The errors in liquids are up to 2.4 times
as large; those in a gas with a cutoff only slightly longer than the distance between dipoles are up to 3.1 times as
large.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from openmm_exactrb.potentials import compiled
from openmm_exactrb.potentials.switching import switched
from openmm_exactrb.support.types import Array

#: Bound of the error in units of the estimate: the largest measured ratio is 3.1.
SAFETY = 3.5

# Mean square of fields and forces: sums of 2/r^6 and 10/r^8 over a cubic lattice with lattice constant 1.
_FIELD2, _FORCE2 = 16.8, 69.5


_NODES = np.polynomial.legendre.leggauss(24)


def of_pairs(alpha: float, cutoff: float, switch: float, distance: float) -> float:
    """Return the error from screened dipoles beyond the start of the switch, for a mean distance of dipoles (nm)."""
    x, weights = _NODES
    bounds = np.array([[switch, cutoff], [cutoff, cutoff + 4.0 / alpha]])
    half = 0.5 * (bounds[:, 1:] - bounds[:, :1])
    r, weights = (bounds[:, :1] + half * (1.0 + x)).ravel(), (half * weights).ravel()
    gauss = 2.0 * alpha / math.sqrt(math.pi) * np.exp(-((alpha * r) ** 2))
    b = (np.vectorize(math.erfc)(alpha * r) / r + gauss) / r**2
    c = (3.0 * b + 2.0 * alpha**2 * gauss) / r**2
    d = (5.0 * c + 4.0 * alpha**4 * gauss) / r**2
    S, slope = switched(r, cutoff, switch)
    field = b**2 - 2.0 / 3.0 * b * c * r**2 + c**2 * r**4 / 3.0
    force = 5.0 / 3.0 * c**2 * r**2 - 2.0 / 3.0 * c * d * r**4 + d**2 * r**6 / 9.0
    energy = b**2 / 3.0 - 2.0 / 9.0 * b * c * r**2 + c**2 * r**4 / 9.0
    both = b * r * (5.0 / 9.0 * c - d * r**2 / 9.0) - c * r**3 * (c / 3.0 - d * r**2 / 9.0)
    force = (1.0 - S) ** 2 * force + 2.0 * (1.0 - S) * slope * both + slope**2 * energy
    shells = 4.0 * math.pi * r**2 * weights
    forces, fields = (
        distance**5 * (shells @ force) / _FORCE2,
        distance**3 * (shells @ ((1.0 - S) ** 2 * field)) / _FIELD2,
    )
    return math.sqrt(max(forces, fields, 1e-300))


def of_mesh(alpha: float, step: float, order: int, distance: float) -> float:
    """Return the error of a mesh with a given spacing."""
    return math.exp(np.interp(math.log(alpha * step), _LOGARITHMS, _of_meshes(step, order, distance)))


def finest_splitting(step: float, order: int, distance: float, error: float) -> float:
    """Return the largest alpha for which a mesh has at most the given error."""
    return math.exp(np.interp(math.log(error), _of_meshes(step, order, distance), _LOGARITHMS)) / step


def _of_meshes(step: float, order: int, distance: float) -> Array:
    """Return the logarithms of the errors of meshes for all `_WIDTHS`."""
    force, field = _table(order)
    ratio = distance / step
    itself = 1.0 + 0.3 * (_WIDTHS * ratio) ** 3  # a dipole's force on itself, as measured in a gas
    return np.asarray(0.5 * np.log(itself * np.maximum(force * ratio**5 / _FORCE2, field * ratio**3 / _FIELD2)))


def shortest_cutoff(alpha: float, part: float, distance: float, error: float, longest: float) -> float:
    """Return the shortest cutoff at which pairs have at most the given error, but not more than `longest`.

    The switch begins at the fraction `part` of the cutoff.
    """
    low, high = min(1.0 / alpha, longest), longest
    if of_pairs(alpha, high, part * high, distance) > error:
        return longest
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if of_pairs(alpha, middle, part * middle, distance) <= error else (middle, high)
    return high


def widest_splitting(cutoff: float, switch: float, distance: float, error: float) -> float:
    """Return the smallest alpha for which pairs have at most the given error."""
    low, high = 1.0 / cutoff, 30.0 / max(switch, 0.1 * cutoff)
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if of_pairs(middle, cutoff, switch, distance) <= error else (middle, high)
    return high


_WIDTHS = np.geomspace(0.08, 1.2, 40)  # alpha times the step of the mesh
_LOGARITHMS = np.log(_WIDTHS)


@lru_cache
def _table(order: int) -> Array:
    """Return mean squares (2, widths) of the errors of forces and fields, per mu^4 and mu², for step and density 1.

    A pair of aliases q and q' of a wave k has the error G' W(q) W(q'), minus G(q) if q = q', where G' is the influence
    function of the mesh. The squares of these errors, times q² q'² for fields and q^4 q'² for forces, are summed over
    aliases and integrated over the waves of the mesh.
    """
    x, weights = np.polynomial.legendre.leggauss(20)
    axis, weights = 0.5 * math.pi * (1.0 + x), math.pi * weights  # for both signs of the wave numbers
    k = [axis[:, None, None], axis[:, None], axis]
    volume = weights[:, None, None] * weights[:, None] * weights
    k2 = k[0] ** 2 + k[1] ** 2 + k[2] ** 2
    W2, second, fourth = compiled.load("mesh").alias_sums(k, (1.0, 1.0, 1.0), order)
    q = np.linspace(math.pi, math.pi + 15.0, 600)  # waves outside the mesh, in shells around the cube
    shells = 4.0 * math.pi * q**2 * np.clip(3.0 - 3.0 * math.pi / q, 0.0, 1.0) * (q[1] - q[0])
    rows = []
    for width in _WIDTHS:
        exact, beyond = (np.exp(s / (-4.0 * width * width)) / s for s in (k2, q**2))
        mesh = exact * W2 * k2**3 / (second * fourth)
        force = (volume * (second * fourth * mesh**2 - 2.0 * mesh * k2**3 * W2 * exact + k2**3 * exact**2)).sum()
        field = (volume * (second**2 * mesh**2 - 2.0 * mesh * k2**2 * W2 * exact + k2**2 * exact**2)).sum()
        force, field = (
            value + 1e-16 * (volume * k2**power * exact**2).sum()  # smaller differences are roundoff
            for value, power in ((force, 3), (field, 2))
        )
        rows.append([force + (shells * q**6 * beyond**2).sum(), 3.0 * (field + (shells * q**4 * beyond**2).sum())])
    return np.maximum(2.0 / (9.0 * math.pi) * np.array(rows).T, 1e-300)
