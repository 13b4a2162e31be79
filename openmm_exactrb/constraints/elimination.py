"""The graph of constraints, and the pattern of the sparse Cholesky factor of their matrix, found once for each kind."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from openmm_exactrb.support.types import Array, Indices


class Graph(NamedTuple):
    """The graph of clusters of n atoms with m constraints.

    The Cholesky factor of the matrix A of `openmm_exactrb.constraints.geodesics` has e nonzero entries.
    """

    inverse: Array  #: inverse masses of the atoms (n,)
    pairs: Indices  #: the two atoms of each constraint (m, 2)
    lengths: Array  #: lengths of the constraints (m,)
    weights: Array  #: B_cd of each entry (e,), row by row, the diagonal last
    rows: Indices  #: first entry of each row (m + 1,)
    columns: Indices  #: column of each entry (e,)
    starts: Indices  #: first of the products that are subtracted from each entry (e + 1,)
    left: Indices  #: first entry of each product
    right: Indices  #: second entry of each product


def eliminated(coupled: Sequence[set[int]]) -> tuple[Indices, Indices, Indices, Indices, Indices, Indices]:
    """Find an elimination order with little fill-in, and list all products of the factorisation.

    The next row is always one that is coupled to the fewest others, so that a chain of constraints, or any tree, has no
    fill-in: D. J. Rose, in Graph Theory and Computing (1972), 183. `coupled` contains the nonzero off-diagonal columns
    of each row of a symmetric matrix.

    Returns
    -------
    order : (m,) array
        The row of the matrix that corresponds to each row of the factor.
    rows, columns : (m + 1,) and (e,) arrays
        Start of the entries of each row of the factor, whose last entry is the diagonal one, and column of each entry.
    starts, left, right : (e + 1,) array, arrays
        Start of the products of each entry e, and the two entries of each product: entry e is (A_e - sum left right) /
        diagonal of the column.
    """
    order, below = _minimum_degree(coupled)
    rows, starts = [0], [0]
    columns: list[int] = []
    left: list[int] = []
    right: list[int] = []
    entry: dict[tuple[int, int], int] = {}
    for c in range(len(order)):
        for d in [*sorted(below[c]), c]:
            entry[c, d] = len(columns)
            columns.append(d)
            for q in sorted(below[c] & below[d]):
                left.append(entry[c, q])
                right.append(entry[d, q])
            starts.append(len(left))
        rows.append(len(columns))
    numbers = (np.array(a, dtype=np.int64) for a in (order, rows, columns, starts, left, right))
    return tuple(numbers)  # type: ignore[return-value]


def _minimum_degree(coupled: Sequence[set[int]]) -> tuple[list[int], list[set[int]]]:
    """Return the order, and the columns of the entries to the left of the diagonal in each row of the factor."""
    neighbours = {c: set(others) for c, others in enumerate(coupled)}
    waiting = [(len(others), c) for c, others in neighbours.items()]
    heapq.heapify(waiting)
    left_of: dict[int, set[int]] = {c: set() for c in neighbours}
    order: list[int] = []
    while waiting:
        degree, chosen = heapq.heappop(waiting)
        if degree != len(neighbours.get(chosen, ())) or chosen not in neighbours:
            continue  # outdated: the degree has changed
        clique = neighbours.pop(chosen)
        for c in clique:
            neighbours[c] |= clique - {c}
            neighbours[c].discard(chosen)
            left_of[c].add(len(order))
            heapq.heappush(waiting, (len(neighbours[c]), c))
        order.append(chosen)
    return order, [left_of[c] for c in order]
