"""Free motion under distance constraints to 30 digits, with mpmath, and clusters to try it on.

Another formulation than the code under test: the power series of the places of the atoms themselves, with Lagrange's
multipliers from the second derivative of the constraints, G M^-1 G^T lambda = -r'.r' order by order, where the matrix
is a power series of its own and is solved densely. Short steps, so that nothing has to be known about convergence.
"""

from __future__ import annotations

import mpmath as mp
import numpy as np

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


# -- clusters ---------------------------------------------------------------------------------------------------------

C, N, O, H = 12.011, 14.007, 15.999, 1.008
_TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5


def star(rays, mass=C, length=0.109):
    """Return masses, pairs and places of a star XHn."""
    return (
        [mass] + rays * [H],
        [(0, k + 1) for k in range(rays)],
        np.vstack([np.zeros(3), length * _TETRAHEDRON[:rays]]),
    )


def water():
    """A triangle with all of its distances: a rigid body."""
    half, d = np.radians(104.52) / 2, 0.09572
    x = d * np.array([[0, 0, 0], [np.sin(half), np.cos(half), 0], [-np.sin(half), np.cos(half), 0]])
    return [O, H, H], [(0, 1), (0, 2), (1, 2)], x


def chain():
    x = 0.153 * np.array([[0, 0, 0], [1, 0, 0], [1.3, 0.95, 0], [2.2, 1.1, 0.4]])
    return 4 * [C], [(0, 1), (1, 2), (2, 3)], x


def ring():
    """The chair of cyclohexane's carbons, with all of its bonds."""
    angle = np.arange(6) * np.pi / 3
    x = np.column_stack([0.145 * np.cos(angle), 0.145 * np.sin(angle), 0.025 * (-1.0) ** np.arange(6)])
    return 6 * [C], [(k, (k + 1) % 6) for k in range(6)], x


def peptide():
    """All bonds of alanine dipeptide, ACE-ALA-NME, at places with bonds of about the right lengths."""
    elements = "HCHHCONHCHCHHHCONHCHHH"
    bonds = [(1, 0), (1, 2), (1, 3), (1, 4), (4, 5), (4, 6), (6, 7), (6, 8), (8, 9), (8, 10), (10, 11), (10, 12)]
    bonds += [(10, 13), (8, 14), (14, 15), (14, 16), (16, 17), (16, 18), (18, 19), (18, 20), (18, 21)]
    rng = np.random.default_rng(8)
    x = np.zeros((22, 3))
    placed = [1]
    waiting = list(bonds)
    while waiting:  # each atom away from those that are there
        i, j = next(b for b in waiting if (b[0] in placed) != (b[1] in placed))
        waiting.remove((i, j))
        old, new = (i, j) if i in placed else (j, i)
        length = 0.109 if "H" in (elements[i], elements[j]) else 0.143
        directions = rng.standard_normal((400, 3))
        tried = x[old] + length * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        x[new] = tried[np.argmax(np.linalg.norm(tried[:, None] - x[placed], axis=2).min(axis=1))]
        placed.append(new)
    return [{"H": H, "C": C, "N": N, "O": O}[e] for e in elements], bonds, x


CLUSTERS = {
    "water": water(),
    "XH": star(1),
    "XH2": star(2, N, 0.101),
    "XH3": star(3),
    "XH4": star(4, N, 0.101),
    "chain": chain(),
    "ring": ring(),
    "peptide": peptide(),
}


def lengths_of(pairs, x):
    i, j = np.array(pairs).T
    return np.linalg.norm(x[i] - x[j], axis=1)


def velocities(masses, rng, kT=2.494):
    """Return velocities at 300 K in nm/ps, before projection."""
    return rng.standard_normal((len(masses), 3)) * np.sqrt(kT / np.array(masses))[:, None]
