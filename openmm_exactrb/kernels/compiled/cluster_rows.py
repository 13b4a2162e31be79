"""Operations of `clusters` on blocks of L clusters.

A block stores a vector per atom or constraint as a row of 3 L numbers, component by component, and a number per
constraint as a row of L numbers. Innermost loops along such rows are vectorised.
"""

import math

from openmm_exactrb.kernels.build import inner, inner_reordered
from openmm_exactrb.kernels.compiled.formulas import two_difference, two_sum
from openmm_exactrb.mathematics.quaternions import TO_GRID


@inner
def gather(x, first, count, start, block):
    """Copy clusters from `start` on into a block (., n, 3 L), padded with copies of the last cluster."""
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
def scatter(block, first, count, start, x):
    """Copy a block (., n, 3 L) back to the clusters from `start` on."""
    sums, atoms, width = block.shape
    L = width // 3
    for s in range(sums):
        for a in range(atoms):
            for e in range(3):
                row, lanes = x[s, e, first + a * count + start :], block[s, a, e * L :]
                for l in range(min(L, count - start)):
                    row[l] = lanes[l]


@inner
def add_compensated(x, step):
    """Add a step (n, 3 L) to double-doubles (2, n, 3 L) in place, or to plain numbers (1, n, 3 L)."""
    for a in range(len(step)):
        high, low, change = x[0, a], x[-1, a], step[a]
        if len(x) == 1:
            for i in range(len(high)):
                high[i] += change[i]
        else:
            for i in range(len(high)):
                high[i], low[i] = two_sum(high[i], change[i] + low[i])


@inner
def vectors(x, pairs, lengths, r, defect):
    """Write r_c (m, 3 L), and (d_c² - r_c.r_c)/2 (m, L) with an error of 1e-8 times the rounding error of d_c²."""
    L, weight = defect.shape[1], float(len(x) - 1)
    for c in range(len(pairs)):
        i, j, d = pairs[c, 0], pairs[c, 1], lengths[c]
        to_grid = math.ldexp(TO_GRID, math.frexp(d)[1])
        coarse_d = (d + to_grid) - to_grid
        for l in range(L):
            defect[c, l] = coarse_d * coarse_d
        for e in range(3):  # the exact part
            a, b, out = x[0, i, e * L :], x[0, j, e * L :], r[c, e * L :]
            a_low, b_low = x[-1, i, e * L :], x[-1, j, e * L :]
            for l in range(L):
                high, error = two_difference(a[l], b[l])
                out[l] = high + (error + weight * (a_low[l] - b_low[l]))
            for l in range(L):
                near = (out[l] + to_grid) - to_grid
                defect[c, l] -= near * near
        for e in range(3):
            a, b, out = x[0, i, e * L :], x[0, j, e * L :], r[c, e * L :]
            a_low, b_low = x[-1, i, e * L :], x[-1, j, e * L :]
            for l in range(L):
                high, error = two_difference(a[l], b[l])
                low = error + weight * (a_low[l] - b_low[l]) - (out[l] - high)
                near = (out[l] + to_grid) - to_grid
                defect[c, l] -= (out[l] - near) * (out[l] + near) + 2.0 * out[l] * low
        for l in range(L):
            defect[c, l] = 0.5 * (defect[c, l] + (d - coarse_d) * (d + coarse_d))


@inner_reordered
def factorise(r, graph, A):
    """Write the Cholesky factor of the matrix B_cd r_c.r_d to A, with the diagonal entries inverted."""
    L, rows, columns = A.shape[1], graph.rows, graph.columns
    for c in range(len(rows) - 1):
        for e in range(rows[c], rows[c + 1]):
            d, weight = columns[e], graph.weights[e]
            for l in range(L):
                x, y, z = r[c, l] * r[d, l], r[c, L + l] * r[d, L + l], r[c, 2 * L + l] * r[d, 2 * L + l]
                A[e, l] = weight * (x + y + z)
            for k in range(graph.starts[e], graph.starts[e + 1]):
                i, j = graph.left[k], graph.right[k]
                for l in range(L):
                    A[e, l] -= A[i, l] * A[j, l]
            if d == c:
                for l in range(L):
                    A[e, l] = 1.0 / math.sqrt(A[e, l])
            else:
                i = rows[d + 1] - 1
                for l in range(L):
                    A[e, l] *= A[i, l]


@inner_reordered
def solve(A, rows, columns, b):
    """Solve the linear systems with the Cholesky factor A for the right-hand sides b (m, L), in place."""
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


@inner_reordered
def differences(a, pairs, scale, u):
    """Write scale (a_i - a_j) for every pair of atoms to u."""
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        for l in range(u.shape[1]):
            u[c, l] = scale * (a[i, l] - a[j, l])


@inner_reordered
def on_atoms(F, pairs, factor, a):
    """Write the signed sum of F_c over the constraints of each atom, times the factor of the atom, to a."""
    a[:] = 0.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        for l in range(F.shape[1]):
            a[i, l] += factor[i] * F[c, l]
        for l in range(F.shape[1]):
            a[j, l] -= factor[j] * F[c, l]


@inner_reordered
def add_scaled(x, scale, factor, y):
    """Add scale times each row of x, times the factor of the row, to y."""
    for k in range(len(y)):
        for i in range(y.shape[1]):
            y[k, i] += scale * factor[k] * x[k, i]


@inner_reordered
def add_products(a, b, out):
    """Add the elementwise products a b of rows of equal length to `out`."""
    for i in range(len(out)):
        out[i] += a[i] * b[i]


@inner_reordered
def dots(a, b, out):
    """Write the dot products a.b of vectors (m, 3 L) to `out` (m, L)."""
    L = out.shape[1]
    for c in range(len(out)):
        for l in range(L):
            out[c, l] = a[c, l] * b[c, l] + a[c, L + l] * b[c, L + l] + a[c, 2 * L + l] * b[c, 2 * L + l]


@inner_reordered
def over_components(a, b):
    """Write the sums over the three components of a (m, 3 L) to b (m, L)."""
    L = b.shape[1]
    for c in range(len(b)):
        for l in range(L):
            b[c, l] = a[c, l] + a[c, L + l] + a[c, 2 * L + l]


@inner_reordered
def of_each_component(b, a):
    """Write the numbers b (m, L) to each of the three components of a (m, 3 L)."""
    L = b.shape[1]
    for c in range(len(b)):
        for e in range(3):
            for l in range(L):
                a[c, e * L + l] = b[c, l]


@inner_reordered
def multiples(b, r, out):
    """Write the products b r of numbers b (m, L) and vectors r (m, 3 L) to `out`."""
    L = b.shape[1]
    for c in range(len(b)):
        for e in range(3):
            for l in range(L):
                out[c, e * L + l] = b[c, l] * r[c, e * L + l]
