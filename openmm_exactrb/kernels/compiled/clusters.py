"""The free flow of clusters with distance constraints, compiled: the twin of `kernels.plain.clusters`.

Clusters of one kind are advanced in blocks of L. A block keeps a vector of each atom, or of each constraint, as a row
of 3 L numbers, component by component, and a number of each constraint as a row of L. Innermost loops run along such
rows or along many of them at once, so that the compiler advances as many clusters as a vector register holds.

Formulas, names and arguments are explained in the twin.
"""

from __future__ import annotations

import math

import numpy as np

from openmm_exactrb.kernels.build import compiled, inner, reordered
from openmm_exactrb.kernels.plain.clusters import HALVINGS, ORDERS, SETTLED, TO_GRID

# Clusters in a block.
LANES = 32


@inner
def _gather(x, first, count, start, block):
    """Copy clusters `start` and on into a block (sums, n, 3 L); the last one fills lanes to spare."""
    sums, atoms, width = block.shape
    L = width // 3
    used = min(L, count - start)
    for s in range(sums):
        for a in range(atoms):
            for e in range(3):
                row, lanes = x[s, e, first + a * count + start :], block[s, a, e * L :]
                for l in range(used):
                    lanes[l] = row[l]
                for l in range(used, L):
                    lanes[l] = row[used - 1]


@inner
def _scatter(block, first, count, start, x):
    sums, atoms, width = block.shape
    L = width // 3
    for s in range(sums):
        for a in range(atoms):
            for e in range(3):
                row, lanes = x[s, e, first + a * count + start :], block[s, a, e * L :]
                for l in range(min(L, count - start)):
                    row[l] = lanes[l]


@inner
def _add(x, step):
    """Add a step (n, 3 L) to sums (2, n, 3 L) in place, or to plain numbers (1, n, 3 L)."""
    high, change, low = x[0].reshape(-1), step.reshape(-1), x[-1].reshape(-1)
    if len(x) == 1:
        for i in range(len(high)):
            high[i] += change[i]
    else:
        for i in range(len(high)):
            part = change[i] + low[i]
            total = high[i] + part
            shadow = total - high[i]
            low[i] = (high[i] - (total - shadow)) + (part - shadow)
            high[i] = total


@inner
def _defects(x, pairs, lengths, r, defect):
    """Write the vectors r_c (m, 3 L), and (d_c² - r_c.r_c)/2 (m, L) with an error of 1e-8 of a rounding of d_c²."""
    L, weight = defect.shape[1], float(len(x) - 1)
    for c in range(len(pairs)):
        i, j, d = pairs[c, 0], pairs[c, 1], lengths[c]
        to_grid = math.ldexp(TO_GRID, math.frexp(d)[1])
        coarse_d = (d + to_grid) - to_grid
        for l in range(L):
            defect[c, l] = coarse_d * coarse_d
        for e in range(3):  # first what is exact
            a, b, out = x[0, i, e * L :], x[0, j, e * L :], r[c, e * L :]
            a_low, b_low = x[-1, i, e * L :], x[-1, j, e * L :]
            for l in range(L):
                high = a[l] - b[l]
                shadow = high - a[l]
                out[l] = high + (((a[l] - (high - shadow)) - (b[l] + shadow)) + weight * (a_low[l] - b_low[l]))
            for l in range(L):
                near = (out[l] + to_grid) - to_grid
                defect[c, l] -= near * near
        for e in range(3):
            a, b, out = x[0, i, e * L :], x[0, j, e * L :], r[c, e * L :]
            a_low, b_low = x[-1, i, e * L :], x[-1, j, e * L :]
            for l in range(L):
                high = a[l] - b[l]
                shadow = high - a[l]
                low = ((a[l] - (high - shadow)) - (b[l] + shadow)) + weight * (a_low[l] - b_low[l])
                near = (out[l] + to_grid) - to_grid
                low -= out[l] - high
                defect[c, l] -= (out[l] - near) * (out[l] + near) + 2.0 * out[l] * low
        for l in range(L):
            defect[c, l] = 0.5 * (defect[c, l] + (d - coarse_d) * (d + coarse_d))


@reordered
def _times(p, factor, v):
    """Write the rows of atoms times their factors."""
    for a in range(len(factor)):
        for i in range(v.shape[1]):
            v[a, i] = p[a, i] * factor[a]


@reordered
def _differences(a, pairs, u):
    """Write a_i - a_j of every pair of atoms."""
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        for l in range(u.shape[1]):
            u[c, l] = a[i, l] - a[j, l]


@reordered
def _on_atoms(F, pairs, factor, a):
    """Write the sums of F_c over the pairs of an atom, with their signs, times its factor."""
    a[:] = 0.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        for l in range(F.shape[1]):
            a[i, l] += factor[i] * F[c, l]
        for l in range(F.shape[1]):
            a[j, l] -= factor[j] * F[c, l]


@reordered
def _factorise(r, weights, rows, columns, starts, left, right, A):
    """Write the Cholesky factor of B_cd r_c.r_d, with the inverse of its diagonal in the place of it."""
    L = A.shape[1]
    for c in range(len(rows) - 1):
        for e in range(rows[c], rows[c + 1]):
            d = columns[e]
            for l in range(L):
                A[e, l] = weights[e] * (
                    r[c, l] * r[d, l] + r[c, L + l] * r[d, L + l] + r[c, 2 * L + l] * r[d, 2 * L + l]
                )
            for k in range(starts[e], starts[e + 1]):
                i, j = left[k], right[k]
                for l in range(L):
                    A[e, l] -= A[i, l] * A[j, l]
            if d == c:
                for l in range(L):
                    A[e, l] = 1.0 / math.sqrt(A[e, l])
            else:
                i = rows[d + 1] - 1
                for l in range(L):
                    A[e, l] *= A[i, l]


@reordered
def _solve(A, rows, columns, b):
    """Solve for b (m, L) in place."""
    L = A.shape[1]
    for c in range(len(rows) - 1):
        last = rows[c + 1] - 1
        for e in range(rows[c], last):
            d = columns[e]
            for l in range(L):
                b[c, l] -= A[e, l] * b[d, l]
        for l in range(L):
            b[c, l] *= A[last, l]
    for c in range(len(rows) - 2, -1, -1):
        last = rows[c + 1] - 1
        for l in range(L):
            b[c, l] *= A[last, l]
        for e in range(rows[c], last):
            d = columns[e]
            for l in range(L):
                b[d, l] -= A[e, l] * b[c, l]


@reordered
def _add_products(a, b, out):
    """Add a b of rows of equal length."""
    for i in range(len(out)):
        out[i] += a[i] * b[i]


@reordered
def _over_components(a, b):
    """Write the sums over the components of a (m, 3 L)."""
    L = b.shape[1]
    for c in range(len(b)):
        for l in range(L):
            b[c, l] = a[c, l] + a[c, L + l] + a[c, 2 * L + l]


@reordered
def _of_each_component(b, a):
    """Write numbers (m, L) to each of the components (m, 3 L)."""
    L = b.shape[1]
    for c in range(len(b)):
        for l in range(L):
            a[c, l] = b[c, l]
            a[c, L + l] = b[c, l]
            a[c, 2 * L + l] = b[c, l]


@reordered
def _add_terms(F, of_push, of_shift, push, shift):
    """Add the terms of an order to the series of impulses and of shifts."""
    for i in range(len(F)):
        push[i] += of_push * F[i]
        shift[i] += of_shift * F[i]


@reordered
def _next_order(r, multipliers, k, A, graph, a, g, q, F, b):
    """Write the order k of the multipliers and of the forces F_c, and the order k + 2 of r."""
    inverse, pairs, _, _, rows, columns, _, _, _ = graph
    (in_rows, factors), (g, g_flat), (q, q_flat), (F, F_flat) = multipliers, g, q, F
    r0, new, order = r[0], r[k + 2], float((k + 1) * (k + 2))
    q_flat[:], F_flat[:] = 0.0, 0.0
    for j in range(1, (k + 3) // 2):
        _add_products(r[j], r[k + 2 - j], q_flat)
    if k % 2 == 0:
        middle = r[k // 2 + 1]
        for i in range(len(q_flat)):
            q_flat[i] += 0.5 * middle[i] * middle[i]
    for j in range(k):
        _add_products(factors[j], r[k - j], F_flat)
    _on_atoms(F, pairs, inverse, a)
    _differences(a, pairs, g)
    for i in range(len(q_flat)):
        q_flat[i] = -order * q_flat[i] - r0[i] * g_flat[i]
    _over_components(q, b)
    _solve(A, rows, columns, b)
    _of_each_component(b, in_rows[k])
    _add_products(factors[k], r0, F_flat)
    _on_atoms(F, pairs, inverse, a)
    _differences(a, pairs, g)
    for i in range(len(new)):
        new[i] = g_flat[i] / order


@reordered
def _still_large(r, k, bound):
    """Tell whether a term of order k is above its bound; nan is not."""
    count = 0
    for i in range(len(bound)):
        if k * abs(r[i]) > bound[i]:
            count += 1
    return count > 0


@inner
def _bounds(r, bound):
    """Write how small a component of a term has to be: SETTLED times the largest first one of the cluster."""
    m, L = len(r), r.shape[1] // 3
    for l in range(L):
        largest = 0.0
        for c in range(m):
            largest = max(largest, abs(r[c, l]), abs(r[c, L + l]), abs(r[c, 2 * L + l]))
        for c in range(m):
            for e in range(3):
                bound[c, e * L + l] = SETTLED * largest


@inner
def _start(X, P, graph, work):
    """Write r_0, the factor of A, velocities, and the multipliers that put place and momentum right."""
    inverse, pairs, lengths, weights, rows, columns, starts, left, right = graph
    (r, _), _, (v, _, _), (u, _), (q, _), _, _, _, _, defect, slip, A = work
    _defects(X, pairs, lengths, r[0], defect)
    _factorise(r[0], weights, rows, columns, starts, left, right, A)
    _times(P[0], inverse, v)
    _differences(v, pairs, u)
    q[:] = r[0] * u
    _over_components(q, slip)
    _solve(A, rows, columns, slip)
    _solve(A, rows, columns, defect)


@reordered
def _keep_the_energy(p, change, inverse):
    """Take the little from a change of momenta by which rounding has it change the energy; p is overwritten."""
    L, mass = p.shape[1] // 3, (1.0 / inverse).sum()
    total, gained, energy = np.zeros(3 * L), np.zeros(3 * L), np.zeros(3 * L)
    for k in range(len(inverse)):
        for i in range(3 * L):
            total[i] += p[k, i]
    for k in range(len(inverse)):
        part = 1.0 / (inverse[k] * mass)
        for i in range(3 * L):
            about_centre = p[k, i] - part * total[i]
            after = about_centre + change[k, i]
            gained[i] += inverse[k] * change[k, i] * (about_centre + after)
            energy[i] += inverse[k] * after * after
            p[k, i] = after
    for l in range(L):
        twice = energy[l] + energy[L + l] + energy[2 * L + l]
        too_much = 0.5 * (gained[l] + gained[L + l] + gained[2 * L + l]) / twice if twice > 0.0 else 0.0
        total[l] = total[L + l] = total[2 * L + l] = too_much
    for k in range(len(inverse)):
        for i in range(3 * L):
            change[k, i] -= total[i] * p[k, i]


@inner
def _step(X, P, t, graph, work):
    """Advance a block by t; or change nothing and tell that the series does not settle."""
    inverse, pairs, ones = graph[0], graph[1], np.ones(len(graph[0]))
    (r, flat_r), multipliers, (v, a, projection), u, q, F, shift, push, bound, defect, slip, A = work
    _start(X, P, graph, work)
    _of_each_component(slip, push[0])
    _of_each_component(defect, shift[0])
    push[0][:] = -push[0] * r[0]
    shift[0][:] = shift[0] * r[0] + t * push[0]
    _on_atoms(push[0], pairs, ones, projection)
    _times(projection, inverse, a)
    _differences(a, pairs, r[1])
    push[0][:] = 0.0
    r[1] += u[0]
    r[1] *= t
    _bounds(r[1], bound[0])
    small, k, by_time = 0, 0, 1.0 / t if t != 0.0 else 0.0
    while small < 2:
        if k == ORDERS:
            return False
        _next_order(flat_r, multipliers, k, A, graph, a, u, q, F, slip)
        k += 1
        _add_terms(F[1], by_time / k, 1.0 / (k * (k + 1)), push[1], shift[1])
        small = 0 if _still_large(flat_r[k + 1], k + 1, bound[1]) else small + 1
    _on_atoms(shift[0], pairs, inverse, a)
    v *= t
    v += a
    _add(X, v)
    _on_atoms(push[0], pairs, ones, a)
    v[:] = P[0] + projection
    _keep_the_energy(v, a, inverse)
    a += projection
    _add(P, a)
    return True


@inner
def _give_up(X, P, work):
    """Make those clusters nan whose series has not settled."""
    (r, _), bound = work[0], work[8][0]
    L = bound.shape[1] // 3
    for c in range(len(bound)):
        for i in range(3 * L):
            if (ORDERS + 1) * max(abs(r[ORDERS + 1, c, i]), abs(r[ORDERS, c, i])) > bound[c, i]:
                for e in range(3):
                    X[:, :, e * L + i % L] = math.nan
                    P[:, :, e * L + i % L] = math.nan


@inner
def _rows(n, L):
    """Return rows of n vectors, and the same numbers in one row."""
    rows = np.empty((n, 3 * L))
    return rows, rows.reshape(-1)


@inner
def _workspace(graph, L, orders):
    n, m, entries = len(graph[0]), len(graph[1]), len(graph[3])
    r, multipliers = np.empty((orders + 2, m, 3 * L)), np.empty((orders, m, 3 * L))
    return (
        (r, r.reshape(orders + 2, -1)),
        (multipliers, multipliers.reshape(orders, -1)),
        (np.empty((n, 3 * L)), np.empty((n, 3 * L)), np.empty((n, 3 * L))),
        _rows(m, L),
        _rows(m, L),
        _rows(m, L),
        _rows(m, L),
        _rows(m, L),
        _rows(m, L),
        np.empty((m, L)),
        np.empty((m, L)),
        np.empty((entries, L)),
    )


@compiled("f3 f3 f i i f1 i2 f1 f1 i1 i1 i1 i1 i1 F3 F3")
def drift(x, p, t, first, count, inverse, pairs, lengths, weights, rows, columns, starts, left, right, x1, p1):
    """Write where the clusters of a kind are after the time t, and their momenta."""
    graph = (inverse, pairs, lengths, weights, rows, columns, starts, left, right)
    L = min(count, LANES)
    X, P = np.empty((len(x), len(inverse), 3 * L)), np.empty((len(x), len(inverse), 3 * L))
    work = _workspace(graph, L, ORDERS)
    for start in range(0, count, L):
        _gather(x, first, count, start, X)
        _gather(p, first, count, start, P)
        part, remaining = 1.0, 1.0
        while remaining > 0.0:
            if _step(X, P, part * t, graph, work):
                remaining -= part
            elif part > 0.5**HALVINGS:
                part *= 0.5
            else:
                _give_up(X, P, work)
                remaining = 0.0
        _scatter(X, first, count, start, x1)
        _scatter(P, first, count, start, p1)


@compiled("f3 f3 i i f1 i2 f1 f1 i1 i1 i1 i1 i1 F3")
def project(x, p, first, count, inverse, pairs, lengths, weights, rows, columns, starts, left, right, p1):
    """Write the momenta without their parts along the constraints."""
    graph = (inverse, pairs, lengths, weights, rows, columns, starts, left, right)
    L = min(count, LANES)
    X, P = np.empty((len(x), len(inverse), 3 * L)), np.empty((len(x), len(inverse), 3 * L))
    work = _workspace(graph, L, 0)
    (r, _), _, (_, a, _), _, _, F, _, _, _, _, slip, _ = work
    for start in range(0, count, L):
        _gather(x, first, count, start, X)
        _gather(p, first, count, start, P)
        _start(X, P, graph, work)
        _of_each_component(slip, F[0])
        F[0][:] = -F[0] * r[0]
        _on_atoms(F[0], pairs, np.ones(len(inverse)), a)
        _add(P, a)
        _scatter(P, first, count, start, p1)
