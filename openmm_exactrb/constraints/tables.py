"""Tables of clusters for the kernels."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.constraints.constants import GRAPH_ORDERS
from openmm_exactrb.constraints.elimination import Graph
from openmm_exactrb.support.types import Indices

#: The largest number of outer atoms of a star.
RAYS = 4


class Group(NamedTuple):
    """The particles (N, n) of clusters with the same constraint graph, or None for single atoms."""

    particles: Indices
    graph: Graph | None = None

    @property
    def star(self) -> bool:
        """Whether the constraints connect the first member to all others."""
        pairs = np.zeros((0, 2)) if self.graph is None else self.graph.pairs
        return len(pairs) == self.particles.shape[1] - 1 and not pairs[:, 0].any()


def arrays(
    starts: Indices, sizes: Indices, groups: Iterable[tuple[Group, Indices]], shared: bool = False
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the kernel's arrays of clusters by name, and the constants with which the kernel is compiled.

    `starts` and `sizes` (c,) are the first atom and the number of atoms of each cluster. `groups` contains the clusters
    with each graph, and their indices among all clusters.

    "clusters" contains a row for each cluster: its first atom, its number of atoms, the start of the table of its graph
    in "graphs", or -1 for a star, and the start of its workspace in "room". "lengths" contains the length of the
    constraint of each atom of a star, and then the lengths and weights of each graph. "room" is empty if the clusters
    of a thread have a `shared` workspace, as on processors.
    """
    n, room, kinds = int(sizes.sum()), 0, 0
    table = np.stack([starts, sizes, *np.full((2, len(starts)), -1)], axis=1)
    graphs, numbers = [np.zeros(0, int)], [np.zeros(n)]
    for group, clusters in groups:
        graph, count = group.graph, len(clusters)
        if graph is None:
            continue
        if is_star(group):
            numbers[0][starts[clusters][:, None] + graph.pairs[:, 1]] = graph.lengths
            continue
        table[clusters, 2], table[clusters, 3] = sum(map(len, graphs)), room + np.arange(count)
        graphs.append(_table(graph, 1 if shared else count, sum(map(len, numbers))))
        numbers += [graph.lengths, graph.weights]
        room, kinds = room + count * _room(graph), kinds + 1
    made: dict[str, NDArray[Any]] = {
        "clusters": table.astype(np.int32),
        "lengths": np.concatenate(numbers),
        "graphs": np.concatenate(graphs).astype(np.int32),
        "room": np.zeros(0 if shared else room),
    }
    return made, {"GRAPHS": kinds, "ALL_ATOMS": n, "RAYS": RAYS}


def _table(graph: Graph, stride: int, first_length: int) -> Indices:
    """Return the table of a graph, as in graph.cl; successive numbers of a workspace are `stride` apart."""
    head = np.array([len(graph.pairs), len(graph.columns), len(graph.left), stride, first_length])
    return np.concatenate([head, graph.pairs.ravel(), graph.rows, graph.columns, graph.starts, graph.left, graph.right])


def _room(graph: Graph) -> int:
    """Return the number of elements in the workspace of a cluster, as in graph.cl."""
    return (4 * GRAPH_ORDERS + 16) * len(graph.pairs) + len(graph.columns) + 3 * len(graph.inverse)


def is_star(group: Group) -> bool:
    """Return whether clusters are stars of at most `RAYS` + 1 atoms, each moved by a team of threads."""
    return group.star and group.particles.shape[1] <= RAYS + 1
