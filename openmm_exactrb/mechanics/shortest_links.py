"""The shortest links that connect the particles of bodies, by Borůvka's method.

Groups of connected particles, at first single particles, are repeatedly linked to the nearest particle of another group
of the same body. Trees of neighbours find these particles, so that the time is nearly proportional to their number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.links import Links, connected
from openmm_exactrb.support.types import Array, Indices

# Number of neighbours of a particle among which particles of other groups are sought first, and the factor by which
# this number grows for particles whose neighbours all belong to their own group.
_NEIGHBOURS, _MORE = 8, 4
# In a box, neighbours are sought up to a distance, which is at first this multiple of the usual distance of nearest
# neighbours, and grows by the second number until bodies are connected.
_FIRST, _GROWTH = 3.0, 4.0
# One in so many particles of a group is compared with other groups first. The distances of these exclude many others.
_SPARSE = 64
# Smallest distance (nm) up to which neighbours are sought, if particles coincide.
_LEAST = 1e-9
# Number of particles from which the usual distance is determined.
_SAMPLE = 1000
# Largest number of cells along an edge in which particles are sorted.
_CELLS = 2**14


class ShortestLinks(NamedTuple):
    """Links (m, 2) between particles, their lengths (m,), and the shifts (m, 3) of their second ends by box vectors."""

    pairs: Indices
    lengths: Array
    shifts: Array


def shortest_links(X: Array, box: Array | None = None, within: float = np.inf) -> tuple[Links, Array]:
    """Return links that contain a minimum spanning tree of each body (n, k, 3), and the shifts of their second ends.

    Particles are numbered body by body. With a box (3, 3), lengths are those to the nearest images, and the shifts are
    numbers of box vectors. Links longer than `within` may be missing.
    """
    n, k, _ = X.shape
    found, label = [ShortestLinks(np.zeros((0, 2), dtype=np.intp), np.zeros(0), np.zeros((0, 3)))], np.arange(n * k)
    for reach in _reaches(X, box, within):
        neighbours = _Neighbours(X, box, reach)
        while len((some := neighbours.of_other_groups(label)).pairs):
            found.append(some)
            label = connected(np.concatenate([links.pairs for links in found]), n * k)
        if label.max() < n:
            break
    pairs, lengths, shifts = map(np.concatenate, zip(*found, strict=True))
    links = Links(pairs, lengths, n * k)
    return links, shifts[links.chosen]


def connected_within(X: Array, within: Array) -> NDArray[np.bool_]:
    """Return a mask of bodies (n, k, 3) that links of at most given lengths (n,) certainly connect.

    Particles in the same cell or in adjacent cells have such links. The time is proportional to the number of
    particles. Bodies whose gaps are hardly shorter than these lengths may be missed.
    """
    edges, extents = within / math.sqrt(12.0), np.ptp(X, axis=1)
    found = np.asarray(edges * _CELLS > extents.max(axis=1))
    if not found.any():
        return found
    X, edges, extents = X[found], edges[found], extents[found]
    cells = (np.floor((X - X.min(axis=1, keepdims=True)) / edges[:, None, None]) + 1.0).astype(np.int64)
    counts = cells.max(axis=(0, 1)) + 2  # with empty cells around all others
    strides = np.array([counts[1] * counts[2], counts[2], 1])
    body = counts.prod() * np.arange(len(X))
    occupied = np.unique(body[:, None] + cells @ strides)
    pairs = []
    for step in (np.array(list(np.ndindex(3, 3, 3))) - 1)[14:] @ strides:  # half of the adjacent cells
        place = np.minimum(np.searchsorted(occupied, occupied + step), len(occupied) - 1)
        adjacent = np.flatnonzero(occupied[place] == occupied + step)
        pairs.append(np.column_stack([adjacent, place[adjacent]]))
    label = connected(np.concatenate(pairs), len(occupied))
    first = np.searchsorted(occupied, body)
    of = np.searchsorted(body, occupied, side="right") - 1
    found[found] = np.bincount(of, label != label[first][of]) == 0
    return found


def _reaches(X: Array, box: Array | None, within: float) -> Iterator[float]:
    """Yield the distances up to which links are sought, the last of which is `within` or includes all images."""
    if X.shape[0] and X.shape[1] > 1:
        if box is not None:
            within = min(within, float(np.linalg.norm(box, axis=1).sum()))
            reach = _FIRST * _spacing(X) + _LEAST
            while reach < within:
                yield reach
                reach *= _GROWTH
        yield within


def _spacing(X: Array) -> float:
    """Return the usual distance of nearest neighbours within bodies (n, k, 3)."""
    distances, _ = _Neighbours(X, None, np.inf).nearest(np.arange(0, X.size // 3, 1 + X.size // (3 * _SAMPLE)), 2)
    return float(np.median(distances[:, 1]))


class _Neighbours:
    """The neighbours of particles in the same body (n, k, 3) within a distance, including images in a box."""

    def __init__(self, X: Array, box: Array | None, reach: float) -> None:
        x, self._size = X.reshape(-1, 3), X.shape[1]
        self._source, self._wraps, shifts = np.arange(len(x)), np.zeros(x.shape), np.zeros(x.shape)
        places = x
        if box is not None:
            inverse = np.linalg.inv(box)
            self._wraps = -np.floor(x @ inverse)
            x = x + self._wraps @ box
            self._source, shifts = _images(x @ inverse, reach * np.linalg.norm(inverse, axis=0))
            places = x[self._source] + shifts @ box
        self._shifts = shifts + self._wraps[self._source]
        self._reach = min(reach, 1.01 * float(np.linalg.norm(np.ptp(places, axis=0))) + _LEAST)
        apart = 2.0 * self._reach * (np.arange(len(x)) // self._size)  # a fourth coordinate keeps bodies apart
        self._x, self._places = np.column_stack([x, apart]), np.column_stack([places, apart[self._source]])
        self._rows = np.arange(len(x))  # particles with neighbours that may belong to other groups
        self._deep = np.arange(0)  # particles whose neighbours all belong to their own group
        self._lists = self.nearest(self._rows, _NEIGHBOURS)
        self._known = self._lists[0][:, -1]  # distance up to which all neighbours are known

    def nearest(self, particles: Indices, count: int) -> tuple[Array, Indices]:
        """Return distances (m, count) and places of the neighbours of m particles, inf where there are fewer."""
        return self._sought(self._tree, particles, count, self._reach)

    def _sought(self, tree: Any, particles: Indices, count: int, bound: float) -> tuple[Array, Indices]:
        distances, near = tree.query(self._x[particles], np.arange(1, count + 1), distance_upper_bound=bound)
        return distances, np.minimum(near, tree.n - 1)

    @cached_property
    def _tree(self) -> Any:
        return _tree(self._places)

    def of_other_groups(self, label: Indices) -> ShortestLinks:
        """Return, for each group of particles with equal labels, a shortest link to a particle of another group."""
        length, place = np.full(len(label), np.inf), np.zeros(len(label), dtype=np.intp)
        inside = ~self._take(label, self._rows, *self._lists, length, place)
        self._deep = np.concatenate([self._deep, self._rows[inside]])
        self._rows, self._lists = self._rows[~inside], (self._lists[0][~inside], self._lists[1][~inside])
        shortest = np.full(label.max() + 1, np.inf)
        np.minimum.at(shortest, label[self._rows], length[self._rows])
        unfinished = np.bincount(label) < self._size
        self._deep = self._deep[np.isfinite(self._known[self._deep]) & unfinished[label[self._deep]]]
        hidden = self._deep[self._known[self._deep] < shortest[label[self._deep]]]
        self._look_farther(label, hidden, length, place)
        np.minimum.at(shortest, label[hidden], length[hidden])
        ends = np.flatnonzero(np.isfinite(length) & (length == shortest[label]))
        ends = ends[np.unique(label[ends], return_index=True)[1]]
        others = place[ends]
        pairs = np.column_stack([ends, self._source[others]])
        return ShortestLinks(pairs, length[ends], self._shifts[others] - self._wraps[ends])

    def _take(
        self, label: Indices, particles: Indices, distances: Array, near: Indices, length: Array, place: Indices
    ) -> NDArray[np.bool_]:
        """Enter the nearest of given neighbours in other groups; return a mask of particles that have one."""
        other = (label[self._source[near]] != label[particles, None]) & np.isfinite(distances)
        first, found = other.argmax(axis=1), other.any(axis=1)
        closer = found & (distances[np.arange(len(first)), first] < length[particles])
        rows, first = particles[closer], first[closer]
        length[rows], place[rows] = distances[closer, first], near[closer, first]
        return np.asarray(found)

    def _look_farther(self, label: Indices, hidden: Indices, length: Array, place: Indices) -> None:
        """Enter the nearest particles of other groups for particles that have none among their first neighbours."""
        count = _NEIGHBOURS * _MORE
        while 0 < len(hidden) * count <= len(self._x) * _NEIGHBOURS:
            distances, near = self.nearest(hidden, count)
            found = self._take(label, hidden, distances, near, length, place)
            hidden, count = hidden[~found & np.isfinite(distances[:, -1])], count * _MORE
        for bit in range(int(label.max()).bit_length() if len(hidden) else 0):  # other groups differ in at least one
            side = label >> bit & 1
            for one in (0, 1):
                asking, among = hidden[side[hidden] == one], np.flatnonzero(side[self._source] != one)
                if len(asking) and len(among):
                    self._search(label, asking, among, length, place)

    def _search(self, label: Indices, asking: Indices, among: Indices, length: Array, place: Indices) -> None:
        """Enter the nearest of the positions `among` for those particles of each group that can be nearest to them."""
        tree, asking = _tree(self._places[among]), asking[np.argsort(label[asking], kind="stable")]

        def enter(particles: Indices) -> Array:
            """Return the distances of the nearest places, or the shortest known distance of the group if it is less."""
            bound = min(self._reach, length[group].min())
            distances, near = self._sought(tree, particles, 1, np.nextafter(bound, np.inf))
            self._take(label, particles, distances, among[near], length, place)
            return np.asarray(np.minimum(distances[:, 0], bound))

        for group in np.split(asking, np.flatnonzero(np.diff(label[asking])) + 1):
            some = group[::_SPARSE]
            least = enter(some)
            apart, close = _tree(self._x[some]).query(self._x[group])
            enter(group[least[close] - apart <= length[group].min()])  # others are farther by the triangle inequality


def _tree(places: Array) -> Any:
    from scipy.spatial import cKDTree  # imported here, because it is slow to import

    return cKDTree(places)


def _images(fractions: Array, margins: Array) -> tuple[Indices, Array]:
    """Return particles and shifts (m, 3) of all images within margins (3,) of the cell, in fractions of its sides."""
    source, shifts = np.arange(len(fractions)), np.zeros(fractions.shape)
    for axis, margin in enumerate(margins):
        sources, moved = [], []
        for layer in range(-math.ceil(margin), math.ceil(margin) + 1):
            place = fractions[source, axis] + layer
            inside = (place >= -margin) & (place <= 1.0 + margin)
            sources.append(source[inside])
            moved.append(shifts[inside] + layer * np.eye(3)[axis])
        source, shifts = np.concatenate(sources), np.concatenate(moved)
    return source, shifts
