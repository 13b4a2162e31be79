"""Tables of the clusters of flexible molecules for the kernel, and the kernel's source text for their graphs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.engines.device.flexible.blocks import Blocks, Group

#: The largest number of outer atoms of a star, and the largest number of atoms of a cluster with another graph.
RAYS, LARGEST = 4, 32
#: The largest number of orders of the multipliers, the relative size of terms at which a series ends, and the smallest
#: part of a drift, which is not halved further; see `openmm_exactrb.kernels.compiled.clusters`.
ORDERS, SETTLED, SHORTEST = 12, 1e-16, 0.5**12
# Numbers in the workspace per constraint of a cluster with any graph; see graph.cl.
_VECTORS = 4 * ORDERS + 6 + 10


def arrays(blocks: Blocks) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the kernel's arrays of clusters by name, and the constants with which the kernel is compiled."""
    n, graphs, constraints = len(blocks.particles), 0, 0
    table = np.stack([blocks.starts, blocks.sizes, *np.full((3, len(blocks.starts)), -1)], axis=1)
    of_stars, ends = np.zeros(n), [np.zeros((0, 2), int)]
    lengths: list[NDArray[Any]] = []
    most = 0
    for group, clusters in blocks.groups:
        m, count = len(group.pairs), len(clusters)
        if is_star(group):
            of_stars[blocks.starts[clusters][:, None] + np.arange(1, m + 1)] = group.lengths
            continue
        number = np.arange(count)
        table[clusters, 2:] = np.stack([graphs + number, constraints + m * number, np.full(count, m)], axis=1)
        lengths.append(np.tile(group.lengths, count))
        ends.append(np.tile(group.pairs, (count, 1)))
        graphs, constraints, most = graphs + count, constraints + m * count, max(most, m)
    constants: dict[str, Any] = {"GRAPHS": graphs, "MOST_CONSTRAINTS": most, "ALL_ATOMS": n, "RAYS": RAYS}
    room = graphs * (most * (_VECTORS + most) + 3 * LARGEST)
    made = {
        "clusters": table.astype(np.int32),
        "lengths": np.concatenate([of_stars, *lengths]),
        "ends": np.concatenate(ends).astype(np.int32),
        "room": np.zeros(room),
    }
    constants |= {"ORDERS": ORDERS, "SETTLED": SETTLED, "SHORTEST": SHORTEST}
    return made, constants


def is_star(group: Group) -> bool:
    """Return whether clusters are stars of at most `RAYS` + 1 atoms, each moved by a team of threads."""
    return group.star and group.particles.shape[1] <= RAYS + 1


def files(blocks: Blocks) -> tuple[str, ...]:
    """Return the names of the kernel files that contain the functions for moving these clusters."""
    return ("star.cl",) + ("graph.cl",) * (not all(is_star(group) for group, _ in blocks.groups))
