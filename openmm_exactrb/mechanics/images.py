"""Reassembly of molecules that a periodic box has split, and the search for the closest bodies.

For each link between two particles, independently of other links, the module determines the shift by box vectors that
gives the link its length. Particles are then joined along a tree of links.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.fit import congruent
from openmm_exactrb.mechanics.links import Links
from openmm_exactrb.mechanics.shortest_links import shortest_links
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
# Number of links whose images are tried together, which limits the memory that they need.
_TOGETHER = 5000
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
    for some in np.array_split(hard, 1 + len(hard) // _TOGETHER) if len(hard) else ():
        shifts = found.shifts[some, None] + lattice(2 + int(wanted[hard].max() / (2.0 * half)))
        missed = np.abs(np.linalg.norm(gap[some, None] + shifts @ box, axis=2) - wanted[some, None])
        found.shifts[some] = shifts[np.arange(len(some)), missed.argmin(axis=1)]
        found.undecided[some] = (missed < _NEAR).sum(axis=1) > 1
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
    best, misses = given, []
    for way in itertools.islice(itertools.product(*offered), _MOST_WAYS):
        total = links.along_tree(np.array(way))
        misses.append(missed(total))
        best = total if misses[-1] == min(misses) else best
    least = min(misses)
    if missed(given) <= least + _EQUAL:
        return given
    if sum(miss <= least + _EQUAL for miss in misses) > 1:
        raise ValueError(
            f"the periodic box has split the group of particles {listed(names)}, and two images fit equally well: set "
            "positions in which this group is whole"
        )
    return best


class Shapes:
    """The links within bodies with known shapes, and within clusters with known constraints."""

    def __init__(self, bodies: RigidBodies) -> None:
        self._bodies = bodies

    def whole(self, x: Array, box: Array) -> Array:
        """Return positions (n_particles, 3) with each body and cluster in one image, or x itself if unchanged."""
        short = half_width(box) - _NEAR
        if self._stars.lengths.max(initial=0.0) < short:
            return joined(x, self._stars, box)
        if self._kept(x):
            return x
        return joined(x, self._trees if self._trees.lengths.max(initial=0.0) < short else self._braced, box)

    def _kept(self, x: Array) -> bool:
        """Return whether all bodies and clusters have their shapes at positions x (n_particles, 3)."""
        kinds = (kind for kind in self._bodies.kinds if kind.particles.shape[1] > 1)
        clusters = self._bodies.clusters.kinds
        return all(congruent(kind.sites, x[kind.particles], _EQUAL).all() for kind in kinds) and all(
            kind.missed(x[kind.particles]).max() <= _EQUAL for kind in clusters
        )

    @cached_property
    def _stars(self) -> Links:
        return self._links(star)

    @cached_property
    def _trees(self) -> Links:
        return self._links(shortest_trees)

    @cached_property
    def _braced(self) -> Links:
        return self._links(braced)

    def _links(self, chosen: Callable[[Array], Indices]) -> Links:
        n, pairs, lengths = self._bodies.n_particles, [np.zeros((0, 2), dtype=np.intp)], [np.zeros(0)]
        for kind in self._bodies.kinds:
            if kind.particles.shape[1] > 1:
                links = chosen(kind.sites)
                ends = kind.sites[np.arange(len(links))[:, None, None], links]
                apart = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)
                every = np.broadcast_to(links, (len(kind.particles), *links.shape[1:]))
                pairs.append(kind.particles[np.arange(len(every))[:, None, None], every].reshape(-1, 2))
                lengths.append(np.broadcast_to(apart, every.shape[:2]).ravel())
        for cluster in self._bodies.clusters.kinds:
            within = np.concatenate([cluster.pairs, cluster.implied])
            pairs.append(cluster.particles[:, within].reshape(-1, 2))
            of_kind = np.concatenate([cluster.lengths, cluster.implied_lengths])
            lengths.append(np.tile(of_kind, len(cluster.particles)))
        return Links(np.concatenate(pairs), np.concatenate(lengths), n)


def star(sites: Array) -> Indices:
    """Return pairs (1, k - 1, 2) of the particle nearest to the mean of the first body (n, k, 3) with all others."""
    number = np.arange(sites.shape[1])
    centre = int(np.argmin(np.linalg.norm(sites[0] - sites[0].mean(axis=0), axis=1)))
    return np.column_stack([np.full(len(number), centre), number])[None, number != centre]


def shortest_trees(sites: Array) -> Indices:
    """Return the pairs (n, k - 1, 2) of the minimum spanning trees of bodies (n, k, 3)."""
    n, k, _ = sites.shape
    particles, parents, _ = shortest_links(sites)[0].tree
    return np.asarray(np.column_stack([parents, particles]).reshape(n, k - 1, 2) % k)


def braced(sites: Array) -> Indices:
    """Return the pairs (n, m, 2) of trees of bodies (n, k, 3), and pairs of all particles with particle 0 or 4 others.

    Such pairs distinguish the images of long bodies, for which the pairs of a tree do not suffice.
    """
    number, trees = np.arange(sites.shape[1]), shortest_trees(sites)
    away, spanning = np.full(len(number), np.inf), [0]
    for _ in range(4):
        away = np.minimum(away, np.linalg.norm(sites[0] - sites[0, spanning[-1]], axis=1))
        spanning.append(int(np.argmax(away)))
    braces = np.concatenate([np.column_stack([np.full(len(number), k), number])[number != k] for k in spanning])
    return np.concatenate([trees, np.broadcast_to(braces, (len(trees), *braces.shape))], axis=1)


def image_gaps(X: Array, box: Array | None, within: float = np.inf) -> tuple[Array, Array]:
    """Return the gaps (n, k - 1) in the minimum spanning tree of each body (n, k, 3), and the shifts of its particles.

    With a box, distances are those to the nearest images; the shifts (n, k, 3) are numbers of box vectors. Gaps wider
    than `within` may be infinite.
    """
    links, shifts = shortest_links(X, box, within)
    gaps, (particles, _, of) = np.full(X.shape[0] * X.shape[1], np.inf), links.tree
    gaps[particles] = links.lengths[of]
    return gaps.reshape(X.shape[:2])[:, 1:], links.along_tree(shifts).reshape(X.shape)


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
