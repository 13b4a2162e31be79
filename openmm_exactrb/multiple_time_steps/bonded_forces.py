"""Forces of bonds, angles, torsions, maps of two torsions and pairs of atoms in numpy, all terms of a kind at once.

Each term depends on one coordinate: a distance, an angle or a torsion. The force on a particle is -dV/d(coordinate)
times the gradient of the coordinate.

The gradient of a torsion follows A. Blondel and M. Karplus, J. Comput. Chem. 17, 1132 (1996),
doi:10.1002/(SICI)1096-987X(19960715)17:9<1132::AID-JCC5>3.0.CO;2-T.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from openmm_exactrb.multiple_time_steps.terms import Terms
from openmm_exactrb.support.types import Array, Indices

_CIRCLE = 2.0 * np.pi


def forces(x: Array, terms: Terms, out: Array) -> None:
    """Write the forces (n, 3) in kJ/mol/nm on particles at x (n, 3) in nm."""
    out[:] = 0.0
    _add_bonds(x, terms.bonds, terms.of_bonds, out)
    _add_pairs(x, terms.pairs, terms.of_pairs, out)
    _add_angles(x, terms.angles, terms.of_angles, out)
    _add_torsions(x, terms.torsions, terms.of_torsions, out)
    _add_impropers(x, terms.impropers, terms.of_impropers, out)
    _add_maps(x, terms.maps, terms.patches, out)


class _Angle(NamedTuple):
    """An angle or a torsion of each of k terms of n particles."""

    cosine: Array  #: times a positive number, (k,)
    sine: Array
    gradient: Array  #: of the angle (k, n, 3)

    def act(self, f: Array, members: Indices, out: Array) -> None:
        """Add the forces of the terms, where f (k,) is the derivative of -V with respect to the angle."""
        np.add.at(out, members, f[:, None, None] * self.gradient)


def _dot(u: Array, v: Array) -> Array:
    product: Array = np.einsum("ke,ke->k", u, v)
    return product


def _add_along(f: Array, u: Array, members: Indices, out: Array) -> None:
    """Add the forces f u (k, 3) on the first particles of pairs (k, 2), and the opposite forces on the second ones."""
    np.add.at(out, members, np.stack([f[:, None] * u, -f[:, None] * u], axis=1))


def _add_bonds(x: Array, bonds: Indices, of_bonds: Array, out: Array) -> None:
    u = x[bonds[:, 0]] - x[bonds[:, 1]]
    r, (length, strength) = np.sqrt(_dot(u, u)), of_bonds
    # A bond of zero length has no direction, and OpenMM applies no force either.
    _add_along(np.where(r != 0.0, strength * (length - r) / np.where(r != 0.0, r, 1.0), 0.0), u, bonds, out)


def _add_pairs(x: Array, pairs: Indices, of_pairs: Array, out: Array) -> None:
    u = x[pairs[:, 0]] - x[pairs[:, 1]]
    square, (charges, sigma, epsilon) = _dot(u, u), of_pairs
    s = (sigma * sigma / square) ** 3
    _add_along((charges / np.sqrt(square) + epsilon * (48.0 * s - 24.0) * s) / square, u, pairs, out)


def _angles(x: Array, angles: Indices) -> _Angle:
    u, v = x[angles[:, 0]] - x[angles[:, 1]], x[angles[:, 2]] - x[angles[:, 1]]
    normal = np.cross(u, v)
    sine = np.maximum(np.sqrt(_dot(normal, normal)), 1e-12)
    of_u = np.cross(u, normal) / (sine * _dot(u, u))[:, None]
    of_v = np.cross(normal, v) / (sine * _dot(v, v))[:, None]
    return _Angle(_dot(u, v), sine, np.stack([of_u, -(of_u + of_v), of_v], axis=1))


def _torsions(x: Array, torsions: Indices) -> _Angle:
    i, j, k, l = (x[column] for column in torsions.T)
    first, axis, last = i - j, j - k, l - k
    a, b, g = np.cross(first, axis), np.cross(last, axis), np.sqrt(_dot(axis, axis))
    aa, bb = _dot(a, a), _dot(b, b)
    scale = 1.0 / np.sqrt(aa * bb)
    of_first, of_last = (-g / aa)[:, None] * a, (g / bb)[:, None] * b
    of_axis = (_dot(first, axis) / (aa * g))[:, None] * a - (_dot(last, axis) / (bb * g))[:, None] * b
    gradient = np.stack([of_first, of_axis - of_first, -(of_axis + of_last), of_last], axis=1)
    return _Angle(scale * _dot(a, b), scale / g * _dot(np.cross(b, a), axis), gradient)


def _add_angles(x: Array, angles: Indices, of_angles: Array, out: Array) -> None:
    at, (c, s, strength) = _angles(x, angles), of_angles  # cosines and sines of the angles of lowest energy
    at.act(strength * np.arctan2(s * at.cosine - c * at.sine, c * at.cosine + s * at.sine), angles, out)


def _add_torsions(x: Array, torsions: Indices, of_torsions: Array, out: Array) -> None:
    """Add the forces of V = sum_n (a_n cos(n phi) + b_n sin(n phi))."""
    at, (a, b) = _torsions(x, torsions), of_torsions
    n = np.arange(1, len(a) + 1)[:, None]
    phi = n * np.arctan2(at.sine, at.cosine)
    at.act((n * (a * np.sin(phi) - b * np.cos(phi))).sum(axis=0), torsions, out)


def _add_impropers(x: Array, impropers: Indices, of_impropers: Array, out: Array) -> None:
    at, (phi0, strength, period) = _torsions(x, impropers), of_impropers
    away = np.arctan2(at.sine, at.cosine) - phi0
    at.act(-2.0 * strength * (away - period * np.round(away / period)), impropers, out)


def _add_maps(x: Array, maps: Indices, patches: Array, out: Array) -> None:
    """Add the forces of bicubic polynomials V = sum_kl c_kl u^(3-k) v^(3-l) of the positions in a patch of a map."""
    first, second = _torsions(x, maps[:, :4]), _torsions(x, maps[:, 4:8])
    size = maps[:, 9]
    (s, u), (t, v) = (_in_patches(at, size) for at in (first, second))
    c = patches[maps[:, 8] + s * size + t]
    first.act(-np.einsum("nkl,kn,ln->n", c, _slopes(u), _powers(v)), maps[:, :4], out)
    second.act(-np.einsum("nkl,kn,ln->n", c, _powers(u), _slopes(v)), maps[:, 4:8], out)


def _powers(u: Array) -> Array:
    return np.array([u**3, u**2, u, np.ones_like(u)])


def _slopes(u: Array) -> Array:
    return np.array([3.0 * u**2, 2.0 * u, np.ones_like(u), np.zeros_like(u)])


def _in_patches(at: _Angle, size: Indices) -> tuple[Indices, Array]:
    """Return the parts of the circle that contain angles, and the positions there; nan is in part 0."""
    angle = np.arctan2(at.sine, at.cosine) % _CIRCLE
    parts = np.clip(np.nan_to_num(angle / _CIRCLE * size), 0, size - 1).astype(np.int64)
    return parts, angle - parts * (_CIRCLE / size)
