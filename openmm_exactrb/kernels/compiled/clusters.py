"""The free flow of clusters with distance constraints, and the projection of their momenta, compiled.

The formulas are those of `openmm_exactrb.kernels.plain.clusters`.

Clusters of one kind are advanced in blocks; see `cluster_rows`. State arrays x and p are double-doubles (2, 3, M), or
plain numbers (1, 3, M); atom a of cluster i is column first + a count + i.
"""

import math
from collections import namedtuple

import numpy as np

from openmm_exactrb.kernels.build import compiled, inlined, inner, inner_reordered
from openmm_exactrb.kernels.compiled.cluster_rows import (
    add_compensated,
    add_products,
    add_scaled,
    differences,
    dots,
    factorise,
    gather,
    multiples,
    of_each_component,
    on_atoms,
    over_components,
    scatter,
    solve,
    vectors,
)
from openmm_exactrb.kernels.plain.clusters import HALVINGS, ORDERS, SETTLED
from openmm_exactrb.kernels.records import Graph

#: Clusters per block.
LANES = 32


#: The rows of a block. Rows of constraints contain the series r and multipliers; the terms F, q and g, their sums push
#: and shift, and the bound of a term; and the numbers defect and b. Rows of atoms contain the velocities v, a response
#: a, the projection of the momentum, inverse masses and ones. A is the Cholesky factor.
Work = namedtuple("Work", "r multipliers F q g push shift bound defect b v a projection A inverse ones")


@inlined
def _workspace(graph, L, orders):
    n, m = len(graph.inverse), len(graph.pairs)
    r, multipliers = np.empty((orders + 2, m, 3 * L)), np.empty((orders, m, 3 * L))
    rows, numbers, of_atoms = (m, 3 * L), (m, L), (n, 3 * L)
    F, q, g = np.empty(rows), np.empty(rows), np.empty(rows)
    push, shift, bound = np.empty(rows), np.empty(rows), np.empty(rows)
    defect, b = np.empty(numbers), np.empty(numbers)
    v, a, projection = np.empty(of_atoms), np.empty(of_atoms), np.empty(of_atoms)
    A = np.empty((len(graph.weights), L))
    inverse = graph.inverse.copy()  # a copy has the same type as `ones`, so that functions are compiled once
    return Work(r, multipliers, F, q, g, push, shift, bound, defect, b, v, a, projection, A, inverse, np.ones(n))


@inlined
def _project(X, P, graph, work):
    """Write r_0, the factor of A, the errors of the lengths, the projection and the projected velocities."""
    vectors(X, graph.pairs, graph.lengths, work.r[0], work.defect)
    factorise(work.r[0], graph, work.A)
    work.v[:] = 0.0
    add_scaled(P[0], 1.0, work.inverse, work.v)
    differences(work.v, graph.pairs, -1.0, work.g)
    dots(work.r[0], work.g, work.b)
    solve(work.A, graph.rows, graph.columns, work.b)
    multiples(work.b, work.r[0], work.F)
    on_atoms(work.F, graph.pairs, work.ones, work.projection)
    add_scaled(work.projection, 1.0, work.inverse, work.v)


@inner_reordered
def _next_order(k, graph, work):
    """Write the order k of the multipliers and of the forces F_c, and the order k + 2 of r."""
    r, multipliers = work.r.reshape(len(work.r), -1), work.multipliers.reshape(len(work.multipliers), -1)
    F, q, g = work.F.reshape(-1), work.q.reshape(-1), work.g.reshape(-1)
    r0, middle, new, order = r[0], r[k // 2 + 1], r[k + 2], float((k + 1) * (k + 2))
    for i in range(len(q)):
        F[i] = 0.0
        q[i] = 0.5 * middle[i] * middle[i] if k % 2 == 0 else 0.0
    for j in range(1, (k + 3) // 2):
        add_products(r[j], r[k + 2 - j], q)
    for j in range(k):
        add_products(multipliers[j], r[k - j], F)
    on_atoms(work.F, graph.pairs, work.inverse, work.a)
    differences(work.a, graph.pairs, 1.0, work.g)
    for i in range(len(q)):
        q[i] = -order * q[i] - r0[i] * g[i]
    over_components(work.q, work.b)
    solve(work.A, graph.rows, graph.columns, work.b)
    of_each_component(work.b, work.multipliers[k])
    add_products(multipliers[k], r0, F)
    on_atoms(work.F, graph.pairs, work.inverse, work.a)
    differences(work.a, graph.pairs, 1.0, work.g)
    for i in range(len(new)):
        new[i] = g[i] / order


@inner_reordered
def _add_terms(F, of_push, of_shift, push, shift):
    """Add the terms of an order to the series of impulses and of shifts."""
    F, push, shift = F.reshape(-1), push.reshape(-1), shift.reshape(-1)
    for i in range(len(F)):
        push[i] += of_push * F[i]
        shift[i] += of_shift * F[i]


@inner_reordered
def _still_large(r, k, bound):
    """Return whether any component of the term of order k exceeds its bound; nan does not exceed it."""
    r, bound, count = r.reshape(-1), bound.reshape(-1), 0
    for i in range(len(bound)):
        if k * abs(r[i]) > bound[i]:
            count += 1
    return count > 0


@inner
def _bounds(r, bound):
    """Write the bound for components of a term: SETTLED times the largest component of the cluster's first term."""
    m, L = len(r), r.shape[1] // 3
    for l in range(L):
        largest = 0.0
        for c in range(m):
            largest = max(largest, abs(r[c, l]), abs(r[c, L + l]), abs(r[c, 2 * L + l]))
        for c in range(m):
            for e in range(3):
                bound[c, e * L + l] = SETTLED * largest


@inner_reordered
def _keep_the_energy(v, change, inverse):
    """Correct a change of momenta so that rounding does not change the kinetic energy; v is overwritten."""
    n, width = v.shape
    L, mass = width // 3, 0.0
    centre, gained, energy = np.zeros(width), np.zeros(width), np.zeros(width)
    for k in range(n):
        mass += 1.0 / inverse[k]
    for k in range(n):
        part = 1.0 / (inverse[k] * mass)
        for i in range(width):
            centre[i] += part * v[k, i]
    for k in range(n):
        m = 1.0 / inverse[k]
        for i in range(width):
            before = v[k, i] - centre[i]
            after = before + inverse[k] * change[k, i]
            gained[i] += change[k, i] * (before + after)
            energy[i] += m * after * after
            v[k, i] = after
    for l in range(L):
        twice = energy[l] + energy[L + l] + energy[2 * L + l]
        too_much = 0.5 * (gained[l] + gained[L + l] + gained[2 * L + l]) / twice if twice > 0.0 else 0.0
        centre[l] = centre[L + l] = centre[2 * L + l] = too_much
    for k in range(n):
        m = 1.0 / inverse[k]
        for i in range(width):
            change[k, i] -= centre[i] * m * v[k, i]


@inlined
def _step(X, P, t, graph, work):
    """Advance a projected block by t if all series converge, and return whether they do."""
    solve(work.A, graph.rows, graph.columns, work.defect)
    multiples(work.defect, work.r[0], work.shift)
    work.push[:] = 0.0
    differences(work.v, graph.pairs, t, work.r[1])
    _bounds(work.r[1], work.bound)
    small, by_time = 0, 1.0 / t if t != 0.0 else 0.0
    for k in range(ORDERS):
        _next_order(k, graph, work)
        _add_terms(work.F, by_time / (k + 1), 1.0 / ((k + 1) * (k + 2)), work.push, work.shift)
        small = 0 if _still_large(work.r[k + 2], k + 2, work.bound) else small + 1
        if small == 2:
            break
    if small < 2:
        return False
    on_atoms(work.shift, graph.pairs, work.inverse, work.a)
    add_scaled(work.v, t, work.ones, work.a)
    add_compensated(X, work.a)
    on_atoms(work.push, graph.pairs, work.ones, work.a)
    _keep_the_energy(work.v, work.a, work.inverse)
    add_scaled(work.projection, 1.0, work.ones, work.a)
    add_compensated(P, work.a)
    return True


@inner
def _give_up(X, P, work):
    """Set the positions and momenta of clusters whose series have not converged to nan."""
    r, bound = work.r, work.bound
    L = bound.shape[1] // 3
    for c in range(len(bound)):
        for i in range(3 * L):
            if (ORDERS + 1) * max(abs(r[ORDERS + 1, c, i]), abs(r[ORDERS, c, i])) > bound[c, i]:
                for e in range(3):
                    X[:, :, e * L + i % L] = math.nan
                    P[:, :, e * L + i % L] = math.nan


@compiled("f3 f3 f i i i", Graph, "F3 F3")
def advance(x, p, t, moves, first, count, graph, x1, p1):
    """Write the positions and momenta of the clusters of a kind after the time t.

    A cluster's results are nan if one of its numbers is not finite, its positions are singular, or it moves too fast.

    The kind has `count` clusters from column `first` on. Unless the kind `moves`, the momenta are only projected, so
    that r_c.r_c' = 0. The results x1 and p1 may overwrite x and p.
    """
    L = min(count, LANES)
    X, P = np.empty((len(x), len(graph.inverse), 3 * L)), np.empty((len(x), len(graph.inverse), 3 * L))
    work = _workspace(graph, L, ORDERS if moves else 0)
    for start in range(0, count, L):
        gather(x, first, count, start, X)
        gather(p, first, count, start, P)
        part, remaining = 1.0, 1.0
        while remaining > 0.0:
            _project(X, P, graph, work)
            if not moves:
                add_compensated(P, work.projection)
                remaining = 0.0
            elif _step(X, P, part * t, graph, work):
                remaining -= part
            elif part > 0.5**HALVINGS:
                part *= 0.5
            else:
                _give_up(X, P, work)
                remaining = 0.0
        scatter(X, first, count, start, x1)
        scatter(P, first, count, start, p1)
