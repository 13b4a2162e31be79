"""Graphs of distance constraints as the kernels take them, and the sparse Cholesky factor of their matrix in numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Graph(NamedTuple):
    """A kind of clusters of n atoms with m constraints, and the e nonzero entries of the Cholesky factor of A."""

    inverse: Array  #: inverse masses of the atoms (n,)
    pairs: Indices  #: the two atoms of each constraint (m, 2)
    lengths: Array  #: of the constraints (m,)
    weights: Array  #: B_cd of each entry (e,), row by row, the diagonal last
    rows: Indices  #: first entry of each row (m + 1,)
    columns: Indices  #: column of each entry (e,)
    starts: Indices  #: first of the products that are subtracted from each entry (e + 1,)
    left: Indices  #: first entry of each product
    right: Indices  #: second entry of each product


def factor(graph: Graph, r: Array) -> list[Array]:
    """Return the Cholesky factor of A, entry by entry (N,), with its diagonal inverted."""
    A: list[Array] = []
    for c in range(len(graph.pairs)):
        for e in range(graph.rows[c], graph.rows[c + 1]):
            d = graph.columns[e]
            entry = graph.weights[e] * np.einsum("in,in->n", r[:, c], r[:, d])
            for k in range(graph.starts[e], graph.starts[e + 1]):
                entry = entry - A[graph.left[k]] * A[graph.right[k]]
            A.append(1.0 / np.sqrt(entry) if d == c else entry * A[graph.rows[d + 1] - 1])
    return A
