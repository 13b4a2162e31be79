"""Pairs of linked particles, and the trees that they form."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.support.types import Array, Indices


class Links:
    """Pairs (m, 2) of particles that a constraint, a bond or a known shape holds at a certain distance.

    If a pair occurs more than once, its first occurrence is used. Lengths (m,) are in nm, or nan if unknown. The tree
    consists of the shortest possible links. Links of the mask `last` (m,) are used only where no other links exist.
    """

    def __init__(self, pairs: Indices, lengths: Array, n_particles: int, last: NDArray[np.bool_] | None = None) -> None:
        self._keys, once = np.unique(_keys(pairs[:, 0], pairs[:, 1], n_particles), return_index=True)
        self.pairs, self.lengths, self.n_particles = pairs[once], lengths[once], n_particles
        #: The indices of these links among the given ones.
        self.chosen = once
        order = np.lexsort((once, self.lengths, np.zeros(len(once)) if last is None else last[once]))
        self._rank = np.empty(len(once))
        self._rank[order] = np.arange(1.0, len(once) + 1.0)

    @cached_property
    def component(self) -> Indices:
        """The index of the linked group to which each particle belongs (n_particles,)."""
        return connected(self.pairs, self.n_particles)

    @cached_property
    def tree(self) -> tuple[Indices, Indices, Indices]:
        """All particles except the first of each group, with their predecessors in the tree and the links to these."""
        from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

        n = self.n_particles
        first = np.unique(self.component, return_index=True)[1]
        branches = minimum_spanning_tree(self._graph(self.pairs, self._rank)).tocoo()
        ends = np.concatenate([np.column_stack(branches.coords), np.column_stack([np.full(len(first), n), first])])
        _, before = breadth_first_order(self._graph(ends, np.ones(len(ends))), n, directed=False)
        particles = np.flatnonzero(before[:n] != n)
        parents = before[particles].astype(np.intp)
        return particles, parents, np.searchsorted(self._keys, _keys(particles, parents, n))

    def _graph(self, pairs: Indices, weights: Array) -> Any:  # with an additional node, linked to all groups
        from scipy.sparse import coo_array

        return coo_array((weights, tuple(pairs.T)), shape=(self.n_particles + 1, self.n_particles + 1)).tocsr()

    def along_tree(self, shifts: Array) -> Array:
        """Return the sums (n_particles, 3) of vectors of links (m, 3) along the tree from the first of each group."""
        n, (particles, parents, of) = self.n_particles, self.tree
        total, before = np.zeros((n + 1, 3)), np.full(n + 1, n)
        total[particles] = np.where(self.pairs[of, 1] == particles, 1.0, -1.0)[:, None] * shifts[of]
        before[particles] = parents
        while (before < n).any():
            total, before = total + total[before], before[before]
        return total[:n]

    def among(self, particles: Indices) -> Links:
        """Return the links among given particles, which are renumbered by their indices in this array."""
        number = np.full(self.n_particles, -1)
        number[particles] = np.arange(len(particles))
        own = (number[self.pairs] >= 0).all(axis=1)
        return Links(number[self.pairs[own]], self.lengths[own], len(particles))


def connected(pairs: Indices, n: int) -> Indices:
    """Return the index (n,) of the group of particles, connected by pairs (m, 2), to which each particle belongs."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # imported here, because it is slow to import

    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def _keys(one: Indices, other: Indices, n: int) -> Indices:
    """Return a number for each pair, which does not depend on the order of its particles."""
    return np.minimum(one, other) * n + np.maximum(one, other)
