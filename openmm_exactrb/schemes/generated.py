"""Schemes that a rule makes: compositions of Verlet steps, quadrature between drifts, and symplectic correctors.

Where V is epsilon times smaller than T, and the flow of T is exact, the error of a step is a sum of epsilon h^s1,
epsilon² h^s2, ... Schemes for this case push s1 far up: (s1, s2, ...) are their generalised orders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.schemes.scheme import Outer, Scheme, palindrome, symmetric
from openmm_exactrb.schemes.sequence import merged
from openmm_exactrb.substeps import DRIFT, KICK, Substep

Array = NDArray[np.float64]

_LASKAR = "J. Laskar and P. Robutel, Celest. Mech. Dyn. Astron. 80, 39 (2001), doi:10.1023/A:1012098603882"


def composition(name: str, *, order: int, steps: Sequence[float], stages: int, reference: str) -> Scheme:
    """Build the composition of Verlet steps, kick first, from the sizes of the first half of its steps."""
    sizes = palindrome(name, "steps", steps, stages)
    halves = [0.0, *sizes]
    kicks = [0.5 * (i + j) for i, j in zip(halves, sizes, strict=False)]
    return symmetric(
        name,
        order=order,
        stages=stages,
        first="kick",
        a=sizes[: (stages - 1) // 2],
        b=kicks[: stages // 2],
        reference=reference,
    )


def saba(n: int) -> Scheme:
    """Return SABA_n, of the generalised orders (2n, 2): drifts between the n nodes of Gauss and Legendre, kicks there.

    ValueError if n < 1.
    """
    _check_none(n, "SABA_n")
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return _quadrature("SABA", n, "drift", np.diff(nodes, prepend=-1.0)[: n // 2], weights[: (n - 1) // 2])


def sbab(n: int) -> Scheme:
    """Return SBAB_n, of the generalised orders (2n, 2): kicks at the n + 1 nodes of Lobatto, drifts between them.

    ValueError if n < 1.
    """
    _check_none(n, "SBAB_n")
    last = np.polynomial.legendre.Legendre.basis(n)
    nodes = np.concatenate([[-1.0], np.sort(last.deriv().roots().real), [1.0]])
    weights = 2.0 / (n * (n + 1) * last(nodes) ** 2)
    return _quadrature("SBAB", n, "kick", np.diff(nodes)[: (n - 1) // 2], weights[: n // 2])


def _check_none(n: int, name: str) -> None:
    if n < 1:
        raise ValueError(f"{name} needs n of 1 or more, not {n}")


def _quadrature(name: str, n: int, first: Outer, drifts: Array, kicks: Array) -> Scheme:
    """Return the scheme of the free coefficients of a rule of quadrature on [-1, 1]."""
    a, b = (drifts / 2.0).tolist(), (kicks / 2.0).tolist()
    return symmetric(f"{name}_{n}", order=2, stages=n, first=first, a=a, b=b, reference=_LASKAR, generalised=(2 * n, 2))


def corrected(kernel: Scheme, terms: int, name: str, generalised: tuple[int, ...]) -> Scheme:
    """Return a scheme of Verlet steps, drift first, between Wisdom's symplectic corrector and its inverse.

    To first order in V, such a step with drifts has the Hamiltonian T + f(x) V, where x is h times the Poisson
    bracket with T and f = (x/2)/sinh(x/2). The change of coordinates by x g(x) = f(x) - 1 removes the error; it is
    approximated by drifts and kicks, the i-th of which contribute 2 b_i sinh(i alpha x), so that g is met up to the
    power 2 `terms` - 1 of x. J. Wisdom, M. Holman and J. Touma, Fields Inst. Commun. 10, 217 (1996); Wisdom, Astron.
    J. 131, 2294 (2006), doi:10.1086/500829.
    """
    # Sizes i alpha of the drifts as Wisdom chose them, alpha² = 7/40.
    square = Fraction(7, 40)
    # (x/2)/sinh(x/2) = sum_j s_j x^2j, by division of the series.
    inverse = [Fraction(1, 4**j * math.factorial(2 * j + 1)) for j in range(terms + 1)]
    s = [Fraction(1)]
    for j in range(1, terms + 1):
        s.append(-sum((s[j - k] * inverse[k] for k in range(1, j + 1)), Fraction(0)))
    # 2 sum_i b_i (i alpha)^(2j-1) / (2j-1)! = s_j for j = 1 ... terms, in beta_i = i alpha b_i.
    rows = [[Fraction(i) ** (2 * (j - 1)) for i in range(1, terms + 1)] for j in range(1, terms + 1)]
    right = [s[j] * math.factorial(2 * j - 1) / (2 * square ** (j - 1)) for j in range(1, terms + 1)]
    alpha = math.sqrt(square)
    b = [float(beta / i) / alpha for i, beta in enumerate(_solved(rows, right), 1)]
    processor: list[tuple[Substep, float]] = []
    for sign, order in ((1, -1), (-1, 1)):
        for i in range(1, terms + 1)[::order]:
            a, kick = sign * i * alpha, sign * 0.5 * b[i - 1]
            processor += [(DRIFT, a), (KICK, kick), (DRIFT, -2.0 * a), (KICK, -kick), (DRIFT, a)]
    return replace(
        kernel,
        name=name,
        order=min(generalised),
        generalised=generalised,
        processor=merged(processor),
        reference="J. Wisdom, M. Holman and J. Touma (1996); J. Wisdom (2006), doi:10.1086/500829",
    )


def _solved(rows: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """Solve a linear system exactly, by elimination; no pivot is zero where all leading minors are positive."""
    rows = [[*row, r] for row, r in zip(rows, right, strict=True)]
    for k, pivot in enumerate(rows):
        pivot[:] = [entry / pivot[k] for entry in pivot]
        for row in rows:
            if row is not pivot:
                row[:] = [entry - row[k] * p for entry, p in zip(row, pivot, strict=True)]
    return [row[-1] for row in rows]
