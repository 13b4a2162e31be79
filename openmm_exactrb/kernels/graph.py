"""Graphs of distance constraints for the kernels, and the sparse Cholesky factor of their matrix in numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from openmm_exactrb.kernels.records import F1, I1, I2
from openmm_exactrb.support.types import Array


class Graph(NamedTuple):
    """The graph of clusters of n atoms with m constraints, and the e nonzero entries of the Cholesky factor of A."""

    inverse: F1  #: inverse masses of the atoms (n,)
    pairs: I2  #: the two atoms of each constraint (m, 2)
    lengths: F1  #: of the constraints (m,)
    weights: F1  #: B_cd of each entry (e,), row by row, the diagonal last
    rows: I1  #: first entry of each row (m + 1,)
    columns: I1  #: column of each entry (e,)
    starts: I1  #: first of the products that are subtracted from each entry (e + 1,)
    left: I1  #: first entry of each product
    right: I1  #: second entry of each product


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
