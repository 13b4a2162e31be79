"""Graphs of distance constraints as the kernels take them, and the sparse Cholesky factor of their matrix in numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Graph(NamedTuple):
    """A kind of clusters of n atoms with m constraints, and the e nonzero entries of the Cholesky factor of A.

    Attributes
    ----------
    inverse : (n,) array
        Inverse masses of the atoms.
    pairs, lengths : (m, 2) and (m,) arrays
        The two atoms of each constraint, and their distance.
    weights, columns : (e,) arrays
        B_cd and column of each entry, row by row, the diagonal last.
    rows : (m + 1,) array
        First entry of each row.
    starts : (e + 1,) array
        First of the products that are subtracted from each entry.
    left, right : arrays
        The two entries of each product.
    """

    inverse: Array
    pairs: Indices
    lengths: Array
    weights: Array
    rows: Indices
    columns: Indices
    starts: Indices
    left: Indices
    right: Indices


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
