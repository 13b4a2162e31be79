"""The shapes of rigid bodies: positions of particles in the principal axes, from distances or from positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from openmm_exactrb.mathematics.quaternions import matrix, turned
from openmm_exactrb.mechanics.bodies import Kind
from openmm_exactrb.mechanics.fit import RIGIDITY, best_attitudes
from openmm_exactrb.support.messages import listed
from openmm_exactrb.support.types import Array, Indices

# A body is flat or linear if its squared extent along an axis is less than this fraction of the largest.
_FLAT = 1e-10
# Particles within this distance (nm) of each other coincide.
_POINT = 1e-6
#: Largest accepted deviation from the distances of a body, relative to its largest distance. Deviations occur because
#: files contain rounded distances.
RESIDUAL = 1e-5
# Largest number of particles of a flat body with unconstrained distances, and smallest relative eigenvalue of a stress
# that keeps the body flat.
_LARGEST_FLAT, _RESISTING = 64, 1e-3
# Largest number of Newton iterations onto constraints, and the displacement, relative to the longest constraint, below
# which the iterations end.
_NEWTON, _AT_REST = 50, 1e-15


def kinds_from_distances(particles: Indices, masses: Array, distances: Array, positions: Array) -> list[Kind]:
    """Return the kind of bodies with given distances between all particles, and its mirror image if both occur."""
    kind = _kind(particles, masses, distances)
    if not kind.sites[0].any(axis=0).all():
        return [kind]
    X = positions[particles]
    relative = X - np.einsum("s,nsi->ni", masses / kind.mass, X)[:, None]
    mirrored = np.linalg.det(np.einsum("s,nsi,sj->nij", kind.weights, relative, kind.sites[0])) < 0.0
    image = replace(kind, sites=kind.sites * (-1.0, 1.0, 1.0))
    return [
        replace(k, particles=particles[chosen]) for k, chosen in ((kind, ~mirrored), (image, mirrored)) if chosen.any()
    ]


def on_constraints(particles: Indices, masses: Array, distances: Array, positions: Array) -> Array:
    """Project positions (n_particles, 3) onto the constraints, to the closest point in the mass metric.

    Newton's method starts from the given positions. Bodies without constraints are unchanged. Constraints that are
    redundant up to rounding errors are satisfied in the least-squares sense. A ValueError is raised if positions are
    not finite or Newton's method does not converge.
    """
    X = positions[particles]
    lost = ~np.isfinite(X).all(axis=2)
    if lost.any():
        raise ValueError(
            f"the position of particle {particles[lost][0]} is not finite: set finite positions before the first step"
        )
    first, second = np.nonzero(np.triu(~np.isnan(distances), 1))
    if not len(first):  # without constraints, the positions define the shape
        return positions
    number, lengths = np.arange(len(first)), distances[first, second]
    gradients = np.zeros((len(X), len(first), len(masses), 3))
    for _ in range(_NEWTON):
        apart = X[:, first] - X[:, second]
        gradients[:, number, first], gradients[:, number, second] = apart, -apart
        pushes = gradients / masses[:, None]
        inverse = np.linalg.pinv(np.einsum("ncki,ndki->ncd", gradients, pushes), hermitian=True, rcond=1e-12)
        excess = 0.5 * ((apart**2).sum(axis=2) - lengths**2)
        move = np.einsum("ncd,nd,ncki->nki", inverse, excess, pushes)
        X = X - move
        if np.abs(move).max() <= _AT_REST * lengths.max():
            break
    missed = np.abs(np.linalg.norm(X[:, first] - X[:, second], axis=2) - lengths).max(axis=1)
    bad = ~(missed <= RESIDUAL * lengths.max())
    if bad.any():
        raise ValueError(
            f"the constraints between particles {listed(particles[np.argmax(bad)])} cannot be satisfied from these "
            "positions: set positions close to the constrained distances"
        )
    whole = positions.copy()
    whole[particles] = X
    return whole


def kinds_from_positions(particles: Indices, masses: Array, positions: Array) -> list[Kind]:
    """Return the kinds of bodies with given masses, whose shapes are taken from their positions.

    If all bodies agree with the first within `RIGIDITY`, they share its shape. Otherwise each body has a separate
    shape.
    """
    X = positions[particles]
    kind = _with_shape_of(particles[:1], masses, X[:1], positions)
    relative = X - np.einsum("s,nsi->ni", masses / kind.mass, X)[:, None]
    attitudes = matrix(best_attitudes(kind.weights, kind.sites, relative)).transpose(2, 0, 1)
    residual = np.sqrt(((relative - turned(attitudes, kind.sites)) ** 2).sum(axis=2).max(axis=1))
    if residual[1:].max(initial=0.0) <= RIGIDITY:
        return [replace(kind, particles=particles)]
    each = [_with_shape_of(row[None], masses, x[None], positions) for row, x in zip(particles, X, strict=True)]
    sorts = (True, False), (True, True), (False, False)
    together = [[one for one in each if (one.turns, one.linear) == sort] for sort in sorts]
    return [_joined(some) for some in together if some]


def _with_shape_of(particles: Indices, masses: Array, X: Array, positions: Array) -> Kind:
    """Return the kind of one body (1, k) with the shape of its positions."""
    apart = np.linalg.norm(X[0][:, None] - X[0][None], axis=2)
    (kind,) = kinds_from_distances(particles, masses, apart, positions)
    return kind


def _joined(kinds: list[Kind]) -> Kind:
    """Return kinds of bodies with the same masses as a single kind that has a shape for each body."""
    particles, sites, inertia = (
        np.concatenate([getattr(kind, name) for kind in kinds]) for name in ("particles", "sites", "inertia")
    )
    return replace(kinds[0], particles=particles, sites=sites, inertia=inertia)


def held_rigid(distances: Array, x: Array) -> bool:
    """Return whether constraints restrict a cluster at positions x (k, 3) to the motions of a rigid body.

    Unconstrained entries of `distances` (k, k) are nan. A body passed as `bodies` has only such entries off the
    diagonal, and counts as rigid.
    """
    i, j = np.nonzero(np.triu(~np.isnan(distances), 1))
    every = len(i) == len(x) * (len(x) - 1) // 2
    if not len(i) or every or not np.isfinite(x).all():
        return not len(i) or every
    U, extents, axes = np.linalg.svd(x - x.mean(axis=0))
    dimensions = int((extents > np.sqrt(_FLAT) * extents[0]).sum())
    freedom = dimensions * len(x) - dimensions * (dimensions + 1) // 2
    if len(i) < freedom:
        return False
    rows = np.zeros((len(i), len(x), dimensions))
    direction = (x[i] - x[j]) @ axes[:dimensions].T
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), np.finfo(float).tiny)
    rows[np.arange(len(i)), i], rows[np.arange(len(i)), j] = direction, -direction
    rank: int = np.linalg.matrix_rank(rows.reshape(len(i), -1), tol=1e-6)
    return bool(rank >= freedom) and (dimensions == 3 or _kept_flat(distances, U[:, :dimensions]))


def _kept_flat(distances: Array, places: Array) -> bool:
    """Return whether constraints keep a flat or straight body with given coordinates (k, 1 or 2) in that shape.

    Constraints keep the body flat if they can carry a stress that is in equilibrium at each particle and resists all
    motions out of the plane (Connelly, Invent. Math. 66 (1982) 11). Such a stress is a positive definite matrix whose
    entries vanish for unconstrained distances. The function tests the stress closest to that of a body with all
    distances constrained. The result is False for bodies of more than `_LARGEST_FLAT` particles.
    """
    k = len(places)
    if k > _LARGEST_FLAT:
        return False
    affine = np.linalg.qr(np.column_stack([np.ones(k), places]), mode="complete")[0]
    out = affine[:, 1 + places.shape[1] :]
    i, j = np.nonzero(np.triu(np.isnan(distances), 1))
    entries = np.einsum("ca,cb->cab", out[i], out[j])
    entries = 0.5 * (entries + entries.transpose(0, 2, 1)).reshape(len(i), -1)
    identity = np.eye(out.shape[1]).ravel()
    stress = identity - np.linalg.lstsq(entries, entries @ identity, rcond=1e-10)[0]
    balanced = np.abs(entries @ stress).max() < 1e-9
    return bool(balanced and np.linalg.eigvalsh(stress.reshape(2 * out.shape[1:])).min() > _RESISTING)


def _kind(particles: Indices, masses: Array, distances: Array) -> Kind:
    """Return the kind of bodies with given distances (k, k), with their particles placed in the principal axes."""
    mass, k = float(masses.sum()), len(masses)
    if distances.max() <= _POINT:
        return Kind(particles, slice(0), masses, np.zeros((1, k, 3)), mass, np.zeros((1, 3)))
    # Classical scaling about the centre of mass: the eigenvalues of the weighted Gram matrix are the second moments,
    # and its eigenvectors give the positions.
    root = np.sqrt(masses)
    spread, axes = _scaled(distances, masses / mass, root)
    sites = axes * np.sqrt(spread) / root[:, None]
    if not spread.all():  # the body or its mass distribution is flat: find positions, then axes
        extent, directions = _scaled(distances, np.full(k, 1.0 / k), np.ones(k))
        if np.count_nonzero(extent) > np.count_nonzero(spread):
            places = directions * np.sqrt(extent)
            places -= masses @ places / mass
            sites = places @ np.linalg.eigh((masses * places.T) @ places)[1][:, ::-1]
            spread = masses @ sites**2
    residual = np.abs(np.linalg.norm(sites[:, None] - sites[None, :], axis=2) - distances).max()
    if residual > RESIDUAL * distances.max():
        raise ValueError(
            f"the constraints between particles {listed(particles[0])} cannot be satisfied in three dimensions "
            f"(the fitted positions violate them by up to {residual:.2g} nm): correct the lengths of "
            "these constraints"
        )
    # The largest spread comes first, so that the moments of inertia ascend and a linear body lies along axis 1.
    return Kind(particles, slice(0), masses, sites[None], mass, (spread.sum() - spread)[None])


def _scaled(distances: Array, weights: Array, root: Array) -> tuple[Array, Array]:
    """Return the three largest eigenvalues (3,), 0 if small, and eigenvectors (k, 3) of the Gram matrix of positions.

    The positions have the given distances and a weighted mean of 0, and are scaled by the square roots of the weights.
    """
    square = distances**2
    to_centre = square @ weights
    gram = 0.5 * (to_centre[:, None] + to_centre[None, :] - weights @ to_centre - square)
    moments, vectors = np.linalg.eigh(root[:, None] * gram * root)
    spread, axes, found = np.zeros(3), np.zeros((len(root), 3)), min(3, len(root))
    spread[:found] = np.maximum(moments[::-1][:found], 0.0)
    axes[:, :found] = vectors[:, ::-1][:, :found]
    spread[spread < _FLAT * spread[0]] = 0.0
    return spread, axes
