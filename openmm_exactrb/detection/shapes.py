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
# Particles coincide if their distances are less than this fraction of the largest coordinate, which is roundoff.
_COINCIDENT = 1e-13
# Smallest extent (nm) of a body. Thermal rotation of a smaller one is by thousands of radians in a step.
_SMALLEST = 1e-6
# Bodies have the same shape if they agree within `RIGIDITY`, or within this part of the extent of a small body.
_ALIKE = 1e-3
#: Largest accepted deviation from the distances of a body, relative to its largest distance. Deviations occur because
#: files contain rounded distances.
RESIDUAL = 1e-5
# Principal axes are not unique if their moments differ by less than this fraction of the largest, which is roundoff.
_EQUAL = 1e-11
# A particle determines an axis if its distance along it exceeds this fraction of the largest, which no symmetric shape
# has as a ratio.
_SEEN = 0.1357
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


def on_constraints(particles: Indices, masses: Array, pairs: Indices, lengths: Array, positions: Array) -> Array:
    """Project positions (n_particles, 3) onto constraints, to the closest point in the mass metric.

    The constraints of each body of the array `particles` (N, n) have members `pairs` (m, 2), as indices of its n
    particles, and `lengths` (m,). Newton's method starts from the given positions. Constraints that are redundant up to
    rounding errors are satisfied in the least-squares sense. A ValueError is raised if Newton's method does not
    converge.
    """
    X = positions[particles]
    (first, second), number = pairs.T, np.arange(len(pairs))
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

    If all bodies agree with the first within `RIGIDITY`, or within a thousandth of the extent of a small body, they
    share its shape. Otherwise each body has a separate shape.
    """
    X = positions[particles]
    kind = _with_shape_of(particles[:1], masses, X[0])
    relative = X - np.einsum("s,nsi->ni", masses / kind.mass, X)[:, None]
    attitudes = matrix(best_attitudes(kind.weights, kind.sites, relative)).transpose(2, 0, 1)
    residual = np.sqrt(((relative - turned(attitudes, kind.sites)) ** 2).sum(axis=2).max(axis=1))
    if residual[1:].max(initial=0.0) <= min(RIGIDITY, _ALIKE * float(np.linalg.norm(relative[0], axis=1).max())):
        return [replace(kind, particles=particles)]
    each = [_with_shape_of(row[None], masses, x) for row, x in zip(particles, X, strict=True)]
    sorts = (True, False), (True, True), (False, False)
    together = [[one for one in each if (one.turns, one.linear) == sort] for sort in sorts]
    return [_joined(some) for some in together if some]


def _with_shape_of(particles: Indices, masses: Array, X: Array) -> Kind:
    """Return the kind of one body (1, k) at positions X (k, 3)."""
    if _coincide(particles, float(np.linalg.norm(X - X[0], axis=1).max()), _COINCIDENT * float(np.abs(X).max())):
        return _point(particles, masses)
    centred = X - X.mean(axis=0)
    extent, directions = np.linalg.eigh(centred.T @ centred)
    directions[:, 0] *= np.linalg.det(directions)  # a rotation, which keeps the handedness of the body
    kind = _in_principal_axes(particles, masses, centred @ directions[:, extent > _FLAT * extent[-1]])
    return replace(kind, sites=kind.sites @ _determined(kind.sites[0], kind.inertia[0]))


def _determined(sites: Array, moments: Array) -> Array:
    """Return the rotation (3, 3) from principal axes to those that the particles of a body determine.

    Principal axes are unique up to their signs, and up to rotations among axes with equal moments. Saved orientations
    and the noise of thermostats depend on the choice, so that this must be independent of the orientation of the body
    and of rounding errors: one of the first particles is on the positive side of an axis or, with equal moments, on
    this axis.
    """
    turn = np.eye(3)
    ends = np.flatnonzero(np.append(np.diff(moments) > _EQUAL * moments[2], True)) + 1
    for begin, end in zip([0, *ends[:-1]], ends, strict=True):
        rest = sites[:, begin:end].copy()
        for k in range(begin, end):
            distances = np.linalg.norm(rest, axis=1)
            first = int(np.argmax(distances > _SEEN * distances.max()))
            if distances[first] == 0.0:
                continue  # an axis across a flat or linear body
            turn[begin:end, k] = axis = rest[first] / distances[first]
            rest -= np.outer(rest @ axis, axis)
    turn[:, 2] *= np.linalg.det(turn)  # a rotation, which keeps the handedness of the body
    return turn


def _joined(kinds: list[Kind]) -> Kind:
    """Return kinds of bodies with the same masses as a single kind that has a shape for each body."""
    particles, sites, inertia = (
        np.concatenate([getattr(kind, name) for kind in kinds]) for name in ("particles", "sites", "inertia")
    )
    return replace(kinds[0], particles=particles, sites=sites, inertia=inertia)


def held_rigid(pairs: Indices, x: Array) -> bool:
    """Return whether constraints of `pairs` (m, 2) restrict particles at positions x (k, 3) to rigid motions."""
    i, j = pairs.T
    if len(i) == len(x) * (len(x) - 1) // 2:
        return True
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
    return bool(rank >= freedom) and (dimensions == 3 or _kept_flat(pairs, U[:, :dimensions]))


def _kept_flat(pairs: Indices, places: Array) -> bool:
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
    free = ~np.eye(k, dtype=bool)
    free[tuple(pairs.T)] = False
    i, j = np.nonzero(np.triu(free))
    entries = np.einsum("ca,cb->cab", out[i], out[j])
    entries = 0.5 * (entries + entries.transpose(0, 2, 1)).reshape(len(i), -1)
    identity = np.eye(out.shape[1]).ravel()
    stress = identity - np.linalg.lstsq(entries, entries @ identity, rcond=1e-10)[0]
    balanced = np.abs(entries @ stress).max() < 1e-9
    return bool(balanced and np.linalg.eigvalsh(stress.reshape(2 * out.shape[1:])).min() > _RESISTING)


def _coincide(particles: Indices, extent: float, roundoff: float = 0.0) -> bool:
    """Return whether the particles of bodies (N, k) coincide; raise ValueError if they nearly do."""
    if roundoff < extent <= _SMALLEST:
        raise ValueError(
            f"the particles {listed(particles[0])} form a rigid body with an extent of only {extent:.2g} nm, whose "
            f"rotation is too fast for any step: make the body larger than {_SMALLEST:g} nm, or let its particles "
            "coincide"
        )
    return extent <= roundoff


def _kind(particles: Indices, masses: Array, distances: Array) -> Kind:
    """Return the kind of bodies with given distances (k, k), with their particles placed in the principal axes."""
    if _coincide(particles, float(distances.max())):
        return _point(particles, masses)
    kind = _in_principal_axes(particles, masses, _scaled(distances))
    residual = np.abs(np.linalg.norm(kind.sites[0, :, None] - kind.sites[0], axis=2) - distances).max()
    if residual > RESIDUAL * distances.max():
        raise ValueError(
            f"the constraints between particles {listed(particles[0])} cannot be satisfied in three dimensions "
            f"(the fitted positions violate them by up to {residual:.2g} nm): correct the lengths of "
            "these constraints"
        )
    return kind


def _scaled(distances: Array) -> Array:
    """Return positions (k, 1 to 3) with given distances (k, k), which are those of a body, flat body or linear body.

    Classical scaling: the eigenvectors of the Gram matrix of the positions about their mean are the positions.
    """
    square = distances**2
    to_centre = square.mean(axis=1)
    gram = 0.5 * (to_centre[:, None] + to_centre - to_centre.mean() - square)
    extent, vectors = (a[..., -3:] for a in np.linalg.eigh(gram))
    large = extent > _FLAT * extent[-1]
    return np.asarray(vectors[:, large] * np.sqrt(extent[large]))


def _in_principal_axes(particles: Indices, masses: Array, places: Array) -> Kind:
    """Return the kind of bodies whose particles have given coordinates (k, 1 to 3) in any axes."""
    mass, sites = float(masses.sum()), np.zeros((len(masses), 3))
    places = places - masses @ places / mass
    axes = np.linalg.eigh((masses * places.T) @ places)[1][:, ::-1]
    axes[:, -1] *= np.linalg.det(axes)  # a rotation, which keeps the handedness of the positions
    sites[:, : len(axes)] = places @ axes
    spread = masses @ sites**2
    # The largest spread comes first, so that the moments of inertia ascend and a linear body lies along axis 1.
    return Kind(particles, slice(0), masses, sites[None], mass, (spread.sum() - spread)[None])


def _point(particles: Indices, masses: Array) -> Kind:
    """Return the kind of single particles, or of particles that coincide."""
    return Kind(particles, slice(0), masses, np.zeros((1, len(masses), 3)), float(masses.sum()), np.zeros((1, 3)))
