"""Bodies in a periodic box: particles that it has split brought into one image again, and the closest bodies."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import BodyState

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# As near, in nm, as positions have to be to be put on a shape.
_NEAR = 0.05


def rejoined(x: Array, bodies: RigidBodies, box: Array) -> Array:
    """Return positions (n_particles, 3) with the particles of each body, and of each cluster, in one image of a box."""
    for kind in bodies.kinds:
        x = joined(x, kind.particles, box, np.linalg.norm(kind.sites[:, :, None] - kind.sites[:, None], axis=3))
    for cluster in bodies.clusters.kinds:
        x = joined(x, cluster.particles, box)
    return x


def joined(x: Array, particles: Indices, box: Array, distances: Array | None = None) -> Array:
    """Return positions with the particles (n, k) of each body in one image of a box; the same array if they are.

    Bodies whose particles are at their distances, (1, k, k) or (n, k, k), are left alone; nan where nobody knows. In
    others, from the first particle on, the one that is nearest to those that have their place takes the image nearest
    to them: bodies may be longer than half the box, if no gap in them is.
    """
    X = x[particles]
    extent = np.ptp(X @ np.linalg.inv(box), axis=1).max(axis=1)
    wide = np.isfinite(extent) & (extent > 0.5)
    if not wide.any():
        return x
    if distances is not None:
        found = np.linalg.norm(X[wide, :, None] - X[wide, None], axis=3)
        known = distances if len(distances) == 1 else distances[wide]
        wide[wide] = ~(np.abs(found - known) <= _NEAR).all(axis=(1, 2))  # nan is not near
    y = x.copy()
    y[particles[wide]] = X[wide] + _images(X[wide], box) @ box
    return y


def _images(X: Array, box: Array) -> Array:
    """Return by how many vectors of the box each particle is to be shifted, (n, k, 3)."""
    inverse = np.linalg.inv(box)
    images, offered = np.zeros_like(X), np.zeros_like(X)
    missing, distance = np.ones(X.shape[:2], dtype=bool), np.full(X.shape[:2], np.inf)
    rows, last = np.arange(len(X)), np.zeros(len(X), dtype=np.intp)
    for _ in range(X.shape[1] - 1):
        missing[rows, last] = False
        gap = X - (X[rows, last] + images[rows, last] @ box)[:, None]
        shift = -np.round(gap @ inverse)
        length = np.linalg.norm(gap + shift @ box, axis=2)
        closer = length < distance
        distance[closer], offered[closer] = length[closer], shift[closer]
        last = np.where(missing, distance, np.inf).argmin(axis=1)
        images[rows, last] = offered[rows, last]
    return images


def closest_pair(state: BodyState, box: Array | None = None) -> str:
    """Name the two bodies whose centres are closest, across the sides of a periodic box (3, 3) too."""
    from scipy.spatial import cKDTree  # here, for a short import of the package

    R, images = state.R.T, np.zeros((1, 3))
    if box is not None:
        R = R - np.floor(R @ np.linalg.inv(box)) @ box
        images = np.array(list(itertools.product((0.0, 1.0, -1.0), repeat=3))) @ box
    places = (R + images[:, None]).reshape(-1, 3)
    distances, neighbours = map(np.asarray, cKDTree(places).query(R, k=2))
    body = int(np.argmin(distances[:, 1]))
    other = next((int(k) for k in neighbours[body] % len(R) if k != body), body)  # or an image of its own
    return f"the bodies {min(body, other)} and {max(body, other)}, {distances[body, 1]:.3g} nm apart"
