"""The pattern of a sparse Cholesky factor, found once for a kind of matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


def eliminated(coupled: NDArray[np.bool_]) -> tuple[Indices, Indices, Indices, Indices, Indices, Indices]:
    """Find an order of elimination with little fill, and all products that the factorisation takes.

    Next is always one of those that are coupled to the fewest others; a chain of constraints, or any tree, then has no
    fill at all. D. J. Rose, in Graph Theory and Computing (1972), 183.

    Parameters
    ----------
    coupled : (m, m) array of bool
        Where a symmetric matrix is not zero.

    Returns
    -------
    order : (m,) array
        Which row of the matrix is which row of the factor.
    rows : (m + 1,) array
        Where the entries of each row of the factor begin; its diagonal is the last one.
    columns : (e,) array
        Columns of the entries.
    starts : (e + 1,) array
        Where the products of each entry begin.
    left, right : arrays
        The entries of each product: entry e is A_e - sum left right, then divided by the diagonal of its column.
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


def _minimum_degree(coupled: NDArray[np.bool_]) -> tuple[list[int], list[set[int]]]:
    """Return the order, and the columns left of the diagonal of each row of the factor."""
    neighbours = {c: set(np.flatnonzero(row).tolist()) - {c} for c, row in enumerate(coupled)}
    left_of: dict[int, set[int]] = {c: set() for c in neighbours}
    order: list[int] = []
    while neighbours:
        chosen = min(neighbours, key=lambda c: (len(neighbours[c]), c))
        clique = neighbours.pop(chosen)
        for c in clique:
            neighbours[c] |= clique - {c}
            neighbours[c].discard(chosen)
            left_of[c].add(len(order))
        order.append(chosen)
    return order, [left_of[c] for c in order]
