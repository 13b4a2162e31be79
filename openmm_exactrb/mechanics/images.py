"""Reassembly of molecules that a periodic box has split, and the search for the closest bodies.

For each link between two particles, independently of other links, the module determines the shift by box vectors that
gives the link its length. Particles are then joined along a tree of links.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.links import Links, shortest_tree
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.support.messages import listed
from openmm_exactrb.support.types import Array, Indices

# A distance may be a link's length if they differ by less than `_NEAR` (nm), and counts as equal to this length if they
# differ by at most `_EQUAL` (nm).
_NEAR, _EQUAL = 0.02, 1e-4
# An image replaces the given vector if the error of its length is below this fraction of the error of the given vector.
_CLOSER = 0.5
# A bond is considered split if the distance of its atoms exceeds this multiple of its length.
_STRETCHED = 1.5
# The largest number of combinations of images that are tried where the links of a group are undecided.
_MOST_WAYS = 4096


@dataclass(frozen=True)
class Decided:
    """Numbers of box vectors by which the second ends of links are to be shifted relative to the first ends."""

    shifts: Array  #: (m, 3)
    doubtful: NDArray[np.bool_]  #: where neither an image nor the given vector has the link's length (m,)
    undecided: NDArray[np.bool_]  #: where several images match the length within 0.02 nm (m,)


def decided(x: Array, links: Links, box: Array) -> Decided:
    """Return the images of links: the given vector if its length fits, otherwise the image whose length fits best."""
    gap, inverse, half = x[links.pairs[:, 1]] - x[links.pairs[:, 0]], np.linalg.inv(box), half_width(box)
    found = Decided(np.zeros(gap.shape), *(np.zeros(len(gap), dtype=bool) for _ in range(2)))
    given, wanted = np.linalg.norm(gap, axis=1), np.nan_to_num(links.lengths)
    short = wanted < half - _NEAR
    (far,) = np.nonzero(np.isfinite(given) & ~(short & (given < half)))
    found.shifts[far] = -np.round(gap[far] @ inverse)
    nearest = np.linalg.norm(gap[far] + found.shifts[far] @ box, axis=1)
    hard = far[~(short[far] & (nearest < half))]  # other links have only one image shorter than half the box
    if len(hard):
        offered = lattice(2 + int(wanted[hard].max() / (2.0 * half)))
        for link in hard:
            shifts = found.shifts[link] + offered
            missed = np.abs(np.linalg.norm(gap[link] + shifts @ box, axis=1) - wanted[link])
            found.shifts[link] = shifts[np.argmin(missed)]
            found.undecided[link] = (missed < _NEAR).sum() > 1
    best = np.linalg.norm(gap[far] + found.shifts[far] @ box, axis=1)
    missed, missed_by_given = (np.abs(length - wanted[far]) for length in (best, given[far]))
    closer = missed < _CLOSER * missed_by_given
    kept = ~closer | (missed_by_given <= missed + _EQUAL)
    found.doubtful[far] = ~closer & found.shifts[far].any(axis=1) & (given[far] > _STRETCHED * wanted[far])
    found.shifts[far[kept]] = 0.0
    return found


def half_width(box: Array) -> float:
    """Return half the smallest distance (nm) between opposite sides of a box; a shorter vector has no shorter image."""
    return float(0.5 / np.linalg.norm(np.linalg.inv(box), axis=0).max())


def lattice(reach: int) -> Array:
    """Return all triples (n, 3) of integers from -reach to reach."""
    return np.array(list(itertools.product(range(-reach, reach + 1), repeat=3)), dtype=np.float64)


def joined(x: Array, links: Links, box: Array, found: Decided | None = None) -> Array:
    """Return positions (n_particles, 3) with linked particles in one image of a box, or x itself if unchanged.

    The first particle of each group is not moved. A ValueError is raised if two images fit equally well.
    """
    found = decided(x, links, box) if found is None else found
    if not found.shifts.any() and not found.undecided.any():
        return x
    total = links.along_tree(found.shifts)
    for group in np.unique(links.component[links.pairs[found.undecided, 0]]):
        particles = np.flatnonzero(links.component == group)
        total[particles] = _best_way(x[particles], links.among(particles), box, particles)
    moved = total.any(axis=1)
    if not moved.any():
        return x
    y = x.copy()
    y[moved] = x[moved] + total[moved] @ box
    return y


def _best_way(x: Array, links: Links, box: Array, names: Indices) -> Array:
    """Return the shifts (k, 3) of the particles of a group that give its links the best lengths."""

    def missed(total: Array) -> float:
        gap = np.diff((x + total @ box)[links.pairs], axis=1)[:, 0]
        return float(np.nanmax(np.abs(np.linalg.norm(gap, axis=1) - links.lengths)))

    given = np.zeros(x.shape)
    if missed(given) <= _EQUAL:
        return given
    shifts, of_tree = decided(x, links, box).shifts, links.tree[2]
    gap = x[links.pairs[:, 1]] - x[links.pairs[:, 0]]
    offered = [np.array([shift]) for shift in shifts]
    for link in of_tree[links.lengths[of_tree] >= half_width(box) - _NEAR]:
        around = -np.round(gap[link] @ np.linalg.inv(box)) + lattice(2 + int(links.lengths[link] / half_width(box)))
        near = np.abs(np.linalg.norm(gap[link] + around @ box, axis=1) - links.lengths[link]) < _NEAR
        offered[link] = around[near] if near.any() else offered[link]
    ways = itertools.islice(itertools.product(*offered), _MOST_WAYS)
    tried = [links.along_tree(np.array(way)) for way in ways]
    misses = np.array([missed(total) for total in tried])
    best = int(np.argmin(misses))
    if missed(given) <= misses[best] + _EQUAL:
        return given
    if (misses <= misses[best] + _EQUAL).sum() > 1:
        raise ValueError(
            f"the periodic box has split the group of particles {listed(names)}, and two images fit equally well: set "
            "positions in which this group is whole"
        )
    return tried[best]


class Shapes:
    """The links within bodies with known shapes, and within clusters with known constraints."""

    def __init__(self, bodies: RigidBodies) -> None:
        self._bodies = bodies

    def whole(self, x: Array, box: Array) -> Array:
        """Return positions (n_particles, 3) with each body and cluster in one image, or x itself if unchanged."""
        long = self._short.lengths.max(initial=0.0) >= half_width(box) - _NEAR
        return joined(x, self._braced if long else self._short, box)

    @cached_property
    def _short(self) -> Links:
        return self._links(braced=False)

    @cached_property
    def _braced(self) -> Links:
        """Links that distinguish the images of long bodies, for which the links of a tree do not suffice."""
        return self._links(braced=True)

    def _links(self, braced: bool) -> Links:
        n, pairs, lengths = self._bodies.n_particles, [np.zeros((0, 2), dtype=np.intp)], [np.zeros(0)]
        for kind in self._bodies.kinds:
            if kind.particles.shape[1] > 1:
                within = spanning_pairs(kind.sites, braced)
                apart = np.linalg.norm(kind.sites[:, within[:, 0]] - kind.sites[:, within[:, 1]], axis=2)
                pairs.append(kind.particles[:, within].reshape(-1, 2))
                lengths.append(np.broadcast_to(apart, (len(kind.particles), len(within))).ravel())
        for cluster in self._bodies.clusters.kinds:
            within = np.concatenate([cluster.pairs, cluster.implied])
            pairs.append(cluster.particles[:, within].reshape(-1, 2))
            of_kind = np.concatenate([cluster.lengths, cluster.implied_lengths])
            lengths.append(np.tile(of_kind, len(cluster.particles)))
        return Links(np.concatenate(pairs), np.concatenate(lengths), n)


def spanning_pairs(sites: Array, braced: bool) -> Indices:
    """Return pairs of particles of bodies (n, k, 3): a tree and, if `braced`, pairs with particle 0 or four others."""
    tree = shortest_tree(sites)
    if not braced:
        return tree
    number = np.arange(sites.shape[1])
    away, spanning = np.full(len(number), np.inf), [0]
    for _ in range(4):
        away = np.minimum(away, np.linalg.norm(sites[0] - sites[0, spanning[-1]], axis=1))
        spanning.append(int(np.argmax(away)))
    braces = [np.column_stack([np.full(len(number), k), number])[number != k] for k in spanning]
    return np.concatenate([tree, *braces])


def image_gaps(X: Array, box: Array | None) -> tuple[Array, Array]:
    """Return the longest gap (n,) in the minimum spanning tree of each body (n, k, 3), and the shifts of its particles.

    With a box, distances are those to the nearest images; the shifts (n, k, 3) are numbers of box vectors.
    """
    images, offered, longest = np.zeros_like(X), np.zeros_like(X), np.zeros(len(X))
    missing, distance = np.ones(X.shape[:2], dtype=bool), np.full(X.shape[:2], np.inf)
    rows, last = np.arange(len(X)), np.zeros(len(X), dtype=np.intp)
    for _ in range(X.shape[1] - 1):
        missing[rows, last] = False
        at = X[rows, last] if box is None else X[rows, last] + images[rows, last] @ box
        gap = X - at[:, None]
        shift = np.zeros_like(gap) if box is None else -np.round(gap @ np.linalg.inv(box))
        length = np.linalg.norm(gap if box is None else gap + shift @ box, axis=2)
        closer = length < distance
        distance[closer], offered[closer] = length[closer], shift[closer]
        last = np.where(missing, distance, np.inf).argmin(axis=1)
        longest = np.maximum(longest, distance[rows, last])
        images[rows, last] = offered[rows, last]
    return longest, images


def closest_pair(state: BodyState, box: Array | None = None) -> str:
    """Return a description of the two bodies with the closest centres, including images in a periodic box (3, 3)."""
    from scipy.spatial import cKDTree  # imported here, because it is slow to import

    R, images = state.R.T, np.zeros((1, 3))
    if box is not None:
        R = R - np.floor(R @ np.linalg.inv(box)) @ box
        images = np.array(list(itertools.product((0.0, 1.0, -1.0), repeat=3))) @ box
    places = (R + images[:, None]).reshape(-1, 3)
    distances, neighbours = map(np.asarray, cKDTree(places).query(R, k=2))
    body = int(np.argmin(distances[:, 1]))
    other = next((int(k) for k in neighbours[body] % len(R) if k != body), body)  # or an image of the body itself
    return f"the bodies {min(body, other)} and {max(body, other)}, {distances[body, 1]:.3g} nm apart"
