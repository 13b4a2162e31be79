"""Free motion under distance constraints to 30 digits, with mpmath.

Another formulation than the code under test: the power series of the places of the atoms themselves, with Lagrange's
multipliers from the second derivative of the constraints, G M^-1 G^T lambda = -r'.r' order by order, where the matrix
is a power series of its own and is solved densely. Short steps, so that nothing has to be known about convergence.
"""

from __future__ import annotations

import mpmath as mp

DIGITS = 30
ORDER = 36


def flow(masses, pairs, x, v, t, steps=None, digits=DIGITS):
    """Return places and velocities, lists of n rows of 3 mpf, after the time t."""
    with mp.workdps(digits + 8):
        x, v = ([[mp.mpf(c) for c in row] for row in a] for a in (x, v))
        if steps is None:
            steps = 1 + int(mp.ceil(12 * abs(t) * _fastest(pairs, x, v)))
        for _ in range(steps):
            x, v = _step([mp.mpf(m) for m in masses], pairs, x, v, mp.mpf(t) / steps)
        return x, v


def put_on(masses, pairs, lengths, x, v, digits=DIGITS):
    """Return places and velocities moved onto the constraints, in mpf, along the constraints in the mass metric."""
    with mp.workdps(digits + 8):
        x, v = ([[mp.mpf(c) for c in row] for row in a] for a in (x, v))
        for _ in range(9):
            r = [_minus(x[i], x[j]) for i, j in pairs]
            A = _matrix(masses, pairs, r)
            miss = [(mp.mpf(d) ** 2 - mp.fdot(a, a)) / 2 for d, a in zip(lengths, r, strict=True)]
            _push(x, masses, pairs, r, mp.lu_solve(A, mp.matrix(miss)))
        r = [_minus(x[i], x[j]) for i, j in pairs]
        slip = [-mp.fdot(a, _minus(v[i], v[j])) for a, (i, j) in zip(r, pairs, strict=True)]
        _push(v, masses, pairs, r, mp.lu_solve(_matrix(masses, pairs, r), mp.matrix(slip)))
        return x, v


def energy(masses, v):
    return mp.fsum(mp.mpf(m) * mp.fdot(row, row) for m, row in zip(masses, v, strict=True)) / 2


def _step(masses, pairs, x, v, t):
    """Advance by one power series: coefficients of x (n, 3), one list a component."""
    n, m = len(masses), len(pairs)
    X = [[[c, w] for c, w in zip(row, rate, strict=True)] for row, rate in zip(x, v, strict=True)]
    B = [[_coupling(masses, a, b) for b in pairs] for a in pairs]
    R = [[[] for _ in range(3)] for _ in pairs]
    A, multipliers = [], []
    for k in range(ORDER):
        for c, (i, j) in enumerate(pairs):
            for e in range(3):
                R[c][e] = [a - b for a, b in zip(X[i][e], X[j][e], strict=True)]
        A.append(
            {
                (c, d): B[c][d] * mp.fsum(_product(R[c][e], R[d][e], k) for e in range(3))
                for c in range(m)
                for d in range(m)
                if B[c][d]
            }
        )
        if k == 0:
            inverse = mp.inverse(mp.matrix([[A[0].get((c, d), mp.mpf(0)) for d in range(m)] for c in range(m)]))
        rates = [[[(k1 + 1) * a for k1, a in enumerate(R[c][e][1:])] for e in range(3)] for c in range(m)]
        right = [-mp.fsum(_product(rates[c][e], rates[c][e], k) for e in range(3)) for c in range(m)]
        for j in range(1, k + 1):
            for (c, d), value in A[j].items():
                right[c] -= value * multipliers[k - j][d]
        multipliers.append(list(inverse * mp.matrix(right)))
        force = [[mp.mpf(0)] * 3 for _ in range(n)]
        for c, (i, j) in enumerate(pairs):
            for e in range(3):
                pull = mp.fsum(multipliers[l][c] * R[c][e][k - l] for l in range(k + 1))
                force[i][e] += pull
                force[j][e] -= pull
        for a in range(n):
            for e in range(3):
                X[a][e].append(force[a][e] / masses[a] / ((k + 1) * (k + 2)))
    assert max(abs(a[-1] * t ** (ORDER + 1)) for row in X for a in row) < mp.mpf(10) ** -DIGITS, "the step is too long"
    powers = [t**k for k in range(ORDER + 2)]
    rates = [k * power for k, power in enumerate([mp.mpf(0), *powers[:-1]])]
    return [[mp.fdot(a, powers) for a in row] for row in X], [[mp.fdot(a, rates) for a in row] for row in X]


def _product(a, b, k):
    return mp.fdot(a[: k + 1], reversed(b[: k + 1]))


def _fastest(pairs, x, v):
    return max(mp.norm(_minus(v[i], v[j])) / mp.norm(_minus(x[i], x[j])) for i, j in pairs)


def _minus(a, b):
    return [p - q for p, q in zip(a, b, strict=True)]


def _coupling(masses, a, b):
    return mp.fsum(
        (1 if s == 0 else -1) * (1 if u == 0 else -1) / mp.mpf(masses[p])
        for s, p in enumerate(a)
        for u, q in enumerate(b)
        if p == q
    )


def _matrix(masses, pairs, r):
    each = list(zip(pairs, r, strict=True))
    return mp.matrix([[_coupling(masses, a, b) * mp.fdot(p, q) for b, q in each] for a, p in each])


def _push(a, masses, pairs, r, multipliers):
    for (i, j), row, y in zip(pairs, r, multipliers, strict=True):
        for e in range(3):
            a[i][e] += y * row[e] / mp.mpf(masses[i])
            a[j][e] -= y * row[e] / mp.mpf(masses[j])
