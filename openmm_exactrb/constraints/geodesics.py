"""The free flow of clusters with distance constraints, and the projection of their momenta, in numpy.

With r_c = x_i - x_j for each constraint c = (i, j), and s_ca = 1 for a = i, -1 for a = j and 0 otherwise,

    x_a'' = sum_c s_ca F_c / m_a,  F_c = lambda_c r_c,  r_c'' = sum_d B_cd F_d,  B_cd = sum_a s_ca s_da / m_a.

These equations are closed in the r_c. With the time of the drift as the unit of time, and w = (k + 1)(k + 2), their
power series is:

    r_c,k+2 = sum_d B_cd F_d,k / w,   F_c,k = lambda_c,k r_c,0 + sum_(j < k) lambda_c,j r_c,k-j.

The multipliers follow from r_c.r_c = d_c², order by order, with the same matrix A_cd = B_cd r_c,0.r_d,0 for all orders:

    sum_d A_cd lambda_d,k = -w q_c - r_c,0 . sum_d B_cd sum_(j < k) lambda_d,j r_d,k-j,
    q_c = sum_(0 < j < k + 2) r_c,j . r_c,k+2-j / 2.

A is factorised once per drift. The same factor serves to correct the rounding errors (d_c² - r_c.r_c)/2 of the initial
positions and r_c.r_c' of the initial momenta. A drift therefore starts with the projection of the momenta, and kicks
need not project them.

Arrays of clusters are component-first, (3, atoms or constraints, clusters).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.constraints.constants import GRAPH_ORDERS, HALVINGS, SETTLED
from openmm_exactrb.constraints.elimination import Graph
from openmm_exactrb.mathematics.compensated import add, two_difference
from openmm_exactrb.mathematics.constants import TO_GRID
from openmm_exactrb.support.types import Array


def advance(
    x: Array, p: Array, t: float, moves: int, first: int, count: int, graph: Graph, x1: Array, p1: Array
) -> None:
    """Write the positions and momenta of the clusters of a kind after the time t.

    A cluster's results are nan if one of its numbers is not finite, its positions are singular, or it moves too fast.

    The kind has `count` clusters from column `first` on; atom a of cluster i is column first + a count + i. Unless the
    kind `moves`, the momenta are only projected, so that r_c.r_c' = 0. States are double-doubles (2, 3, M), or plain
    numbers (1, 3, M). The results x1 and p1 may overwrite x and p.
    """
    X, P = _of_kind(x, first, count, graph), _of_kind(p, first, count, graph)
    with np.errstate(all="ignore"):  # what is not finite stays in its own cluster
        X, P = _moved(graph, X, P, t, HALVINGS) if moves else (X, _projected(graph, X, P))
    _of_kind(x1, first, count, graph)[:], _of_kind(p1, first, count, graph)[:] = X, P


def factor(graph: Graph, r: Array) -> list[Array]:
    """Return the entries (N,) of the Cholesky factors of A for vectors r (3, m, N), with inverted diagonal entries."""
    A: list[Array] = []
    for c in range(len(graph.pairs)):
        for e in range(graph.rows[c], graph.rows[c + 1]):
            d = graph.columns[e]
            entry = graph.weights[e] * np.einsum("in,in->n", r[:, c], r[:, d])
            for k in range(graph.starts[e], graph.starts[e + 1]):
                entry = entry - A[graph.left[k]] * A[graph.right[k]]
            A.append(1.0 / np.sqrt(entry) if d == c else entry * A[graph.rows[d + 1] - 1])
    return A


def _projected(graph: Graph, x: Array, p: Array) -> Array:
    """Return momenta (., 3, n, N) without their parts along the constraints."""
    r, _ = _vectors(graph, x)
    return add(p, _on_atoms(graph, -_slip(graph, factor(graph, r), r, p) * r))


def _of_kind(x: Array, first: int, count: int, graph: Graph) -> Array:
    """Return the view (., 3, n, count) of the clusters of a kind."""
    n = len(graph.inverse)
    columns = x[:, :, first : first + n * count]
    sums, components, atoms = columns.strides
    return np.lib.stride_tricks.as_strided(columns, (len(x), 3, n, count), (sums, components, count * atoms, atoms))


def _moved(graph: Graph, x: Array, p: Array, t: float, halvings: int) -> tuple[Array, Array]:
    """Return places and momenta (., 3, n, N) after the time t, in as many parts as each cluster needs."""
    shift, push, settled = _change(graph, x, p, t)
    x1, p1 = add(x, shift), add(p, push)
    late = ~settled
    if late.any() and halvings:
        half = _moved(graph, x[..., late], p[..., late], 0.5 * t, halvings - 1)
        x1[..., late], p1[..., late] = _moved(graph, *half, 0.5 * t, halvings - 1)
    elif late.any():
        x1[..., late] = p1[..., late] = np.nan
    return x1, p1


def _change(graph: Graph, x: Array, p: Array, t: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the changes of places and momenta (3, n, N) in the time t, and for which clusters they hold."""
    inverse = graph.inverse[:, None]
    r0, defect = _vectors(graph, x)
    A = factor(graph, r0)
    projection = _on_atoms(graph, -_slip(graph, A, r0, p) * r0)
    v = inverse * (p[0] + projection)
    shift, push = _solve(graph, A, defect) * r0, np.zeros(r0.shape)
    by_time = 1.0 / t if t else 0.0
    r = [r0, t * _differences(graph, v)]
    bound = SETTLED * np.abs(r[1]).max(axis=(0, 1))
    multipliers: list[Array] = []
    small = np.zeros((GRAPH_ORDERS + 1, x.shape[-1]), dtype=bool)
    settled = small[0]
    for k in range(GRAPH_ORDERS):
        w = (k + 1) * (k + 2)
        F = sum((a * b for a, b in zip(multipliers, reversed(r[1 : k + 1]), strict=True)), np.zeros(r0.shape))
        q = 0.5 * sum((a * b for a, b in zip(r[1:], reversed(r[1:]), strict=True)), np.zeros(r0.shape)).sum(axis=0)
        multipliers.append(_solve(graph, A, -w * q - _dot(r0, _response(graph, F))))
        F += multipliers[k] * r0
        r.append(_response(graph, F) / w)
        push += np.where(settled, 0.0, by_time / (k + 1) * F)  # a series that has settled does not depend on others
        shift += np.where(settled, 0.0, F / w)
        small[k + 1] = ~((k + 2) * np.abs(r[k + 2]).max(axis=(0, 1)) > bound)  # so that nan is settled
        settled = settled | (small[k] & small[k + 1])
        if settled.all():
            break
    change = _keeping_the_energy(graph, v, _on_atoms(graph, push))
    return t * v + inverse * _on_atoms(graph, shift), projection + change, settled


def _keeping_the_energy(graph: Graph, v: Array, change: Array) -> Array:
    """Return a change of momenta without the little by which rounding has it change the energy; v are the velocities.

    The rounding of A is nearly the same in every step, since r_c.r_c is, and without this the energy drifts. Momenta
    about the centre of mass are scaled, so that their sum stays.
    """
    inverse, mass = graph.inverse[:, None], 1.0 / graph.inverse[:, None]
    before = v - (mass * v).sum(axis=1, keepdims=True) / mass.sum()
    after = before + inverse * change
    gained, energy = (change * (before + after)).sum(axis=(0, 1)), (mass * after * after).sum(axis=(0, 1))
    kept: Array = change - np.where(energy > 0.0, 0.5 * gained / energy, 0.0) * mass * after
    return kept


def _vectors(graph: Graph, x: Array) -> tuple[Array, Array]:
    """Return r_c (3, m, N) and (d_c² - r_c.r_c)/2 (m, N), whose error is 1e-8 of a rounding of d_c².

    Squares of numbers on a grid of 26 bits are exact, and so is their sum.
    """
    i, j = graph.pairs.T
    high, low = two_difference(x[0][:, i], x[0][:, j])
    if len(x) == 2:
        low += x[1][:, i] - x[1][:, j]
    r = high + low
    low -= r - high
    d = graph.lengths[:, None]
    to_grid = np.ldexp(TO_GRID, np.frexp(d)[1])
    coarse_d, coarse = (d + to_grid) - to_grid, (r + to_grid) - to_grid
    exact = coarse_d * coarse_d - _dot(coarse, coarse)
    return r, 0.5 * (exact + ((d - coarse_d) * (d + coarse_d) - _dot(r - coarse, r + coarse) - 2.0 * _dot(r, low)))


def _slip(graph: Graph, A: list[Array], r: Array, p: Array) -> Array:
    """Return the multipliers (m, N) of the part of a momentum along the constraints."""
    return _solve(graph, A, _dot(r, _differences(graph, graph.inverse[:, None] * p[0])))


def _solve(graph: Graph, A: list[Array], b: Array) -> Array:
    """Return the solution (m, N) of A y = b."""
    y = b.copy()
    for c in range(len(y)):
        last = graph.rows[c + 1] - 1
        for e in range(graph.rows[c], last):
            y[c] -= A[e] * y[graph.columns[e]]
        y[c] *= A[last]
    for c in reversed(range(len(y))):
        last = graph.rows[c + 1] - 1
        y[c] *= A[last]
        for e in range(graph.rows[c], last):
            y[graph.columns[e]] -= A[e] * y[c]
    return y


def _response(graph: Graph, F: Array) -> Array:
    """Return sum_d B_cd F_d (3, m, N)."""
    return _differences(graph, graph.inverse[:, None] * _on_atoms(graph, F))


def _differences(graph: Graph, a: Array) -> Array:
    """Return a_i - a_j (3, m, N) of every pair."""
    i, j = graph.pairs.T
    difference: Array = a[:, i] - a[:, j]
    return difference


def _on_atoms(graph: Graph, F: Array) -> Array:
    """Return the sums of s_ca F_c on the atoms (3, n, N)."""
    total = np.zeros((3, len(graph.inverse), F.shape[2]))
    for c, (i, j) in enumerate(graph.pairs):
        total[:, i] += F[:, c]
        total[:, j] -= F[:, c]
    return total


def _dot(a: Array, b: Array) -> Array:
    """Return the scalar products of vectors, component-first."""
    product: Array = np.einsum("i...,i...->...", a, b)
    return product
