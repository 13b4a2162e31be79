"""Tables of the clusters of flexible molecules for the kernel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.engines.native.flexible.blocks import Blocks, Group
from openmm_exactrb.kernels.records import Graph
from openmm_exactrb.support.types import Indices

#: The largest number of outer atoms of a star.
RAYS = 4
#: The largest numbers of orders of the multipliers of stars, whose series are in registers, and of other graphs.
ORDERS, GRAPH_ORDERS = 12, 30
#: The relative size of terms at which a series ends, and the smallest part of a drift, which is not halved further; see
#: `openmm_exactrb.kernels.plain.clusters`.
SETTLED, SHORTEST = 1e-16, 0.5**12


def arrays(blocks: Blocks, shared: bool = False) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the kernel's arrays of clusters by name, and the constants with which the kernel is compiled.

    "clusters" contains a row for each cluster: its first atom, its number of atoms, the start of the table of its graph
    in "graphs", or -1 for a star, and the start of its workspace in "room". "lengths" contains the length of the
    constraint of each atom of a star, and then the lengths and weights of each graph. "room" is empty if the clusters
    of a thread have a `shared` workspace, as on processors.
    """
    n, room, kinds = len(blocks.particles), 0, 0
    table = np.stack([blocks.starts, blocks.sizes, *np.full((2, len(blocks.starts)), -1)], axis=1)
    graphs, numbers = [np.zeros(0, int)], [np.zeros(n)]
    for group, clusters in blocks.groups:
        graph, count = group.graph, len(clusters)
        if graph is None:
            continue
        if is_star(group):
            numbers[0][blocks.starts[clusters][:, None] + graph.pairs[:, 1]] = graph.lengths
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
    constants = {"GRAPHS": kinds, "ALL_ATOMS": n, "RAYS": RAYS, "ORDERS": ORDERS, "GRAPH_ORDERS": GRAPH_ORDERS}
    return made, constants | {"SETTLED": SETTLED, "SHORTEST": SHORTEST}


def _table(graph: Graph, stride: int, first_length: int) -> Indices:
    """Return the table of a graph, as in kernels/graph.cl; successive numbers of a workspace are `stride` apart."""
    head = np.array([len(graph.pairs), len(graph.columns), len(graph.left), stride, first_length])
    return np.concatenate([head, graph.pairs.ravel(), graph.rows, graph.columns, graph.starts, graph.left, graph.right])


def _room(graph: Graph) -> int:
    """Return the number of elements in the workspace of a cluster, as in kernels/graph.cl."""
    return (4 * GRAPH_ORDERS + 16) * len(graph.pairs) + len(graph.columns) + 3 * len(graph.inverse)


def is_star(group: Group) -> bool:
    """Return whether clusters are stars of at most `RAYS` + 1 atoms, each moved by a team of threads."""
    return group.star and group.particles.shape[1] <= RAYS + 1
