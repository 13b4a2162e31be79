"""Symmetric splitting schemes for H = T + V: tables of their free coefficients, and one catalogue.

A step of size h alternates drifts, the flow of T over a_i h, with kicks, the flow of V over b_i h. A table holds the
free coefficients only: each scheme is a palindrome, and sum(a) = sum(b) = 1 gives the rest.

Where V is epsilon times smaller than T, and the flow of T is exact, the error of a step is a sum of epsilon h^s1,
epsilon² h^s2, ... Schemes for this case push s1 far up: (s1, s2, ...) are their generalised orders.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Literal

import numpy as np

Flow = Literal["drift", "kick", "gradient"]
Sequel = tuple[tuple[Flow, float], ...]


@dataclass(frozen=True)
class Scheme:
    """A symmetric splitting scheme.

    Attributes
    ----------
    name : str
    order : int
        Order in the step size.
    stages : int
        Force evaluations a step, once the outer stages of neighbouring steps are one.
    kind : {"general", "nystroem"}
        A Nyström scheme needs a kinetic energy that is quadratic in the momenta.
    first : {"drift", "kick"}
        What a step starts and ends with.
    a, b : tuple of float
        All coefficients of the drifts and of the kicks, in the order of their use.
    reference : str
    generalised : tuple of int
        Generalised orders, where the scheme is made for a small V; else empty.
    c : tuple of float
        Coefficients of force-gradient kicks that go with the kicks: the flow of f . M^-1 f over c_i h³, where f is the
        force of V and M the mass. Empty where there are none.
    processor : tuple
        Flows, with their coefficients, that prepare the state before the first step; their inverse follows the last.
        Only then is the state that of the problem, and its energy of the accuracy promised.
    """

    name: str
    order: int
    stages: int
    kind: Literal["general", "nystroem"]
    first: Flow
    a: tuple[float, ...]
    b: tuple[float, ...]
    reference: str
    generalised: tuple[int, ...] = ()
    c: tuple[float, ...] = ()
    processor: Sequel = ()

    @property
    def sequence(self) -> Sequel:
        """The flows of one step with their coefficients, in the order of their use."""
        if self.first == "kick":
            return _alternating("kick", self.b, "drift", self.a)
        if not self.c:
            return _alternating("drift", self.a, "kick", self.b)
        sequel: list[tuple[Flow, float]] = [("drift", self.a[0])]
        for a, b, c in zip(self.a[1:], self.b, self.c, strict=True):
            sequel += [("kick", b), ("gradient", c), ("drift", a)]
        return tuple(sequel)

    @property
    def postprocessor(self) -> Sequel:
        """The inverse of the processor, for after the last step."""
        return tuple((flow, -coefficient) for flow, coefficient in reversed(self.processor))

    @property
    def processing(self) -> int:
        """Force evaluations that the processor and its inverse cost, once a run or an output."""
        return 2 * sum(flow == "kick" for flow, _ in self.processor)

    @property
    def symmetric(self) -> bool:
        """Whether a step back is the inverse of a step; a processor is symmetric to first order in V only."""
        return not self.processor

    @property
    def composes_verlet(self) -> bool:
        """Whether a step is a row of Verlet steps, kick first: it keeps its order with drifts of order 2."""
        halves = [0.0, *self.a, 0.0]
        return self.first == "kick" and all(
            abs(b - 0.5 * (i + j)) < 1e-14 for b, i, j in zip(self.b, halves[:-1], halves[1:], strict=True)
        )


def _alternating(first: Flow, outer: Sequence[float], second: Flow, inner: Sequence[float]) -> Sequel:
    """Return first, second, first, ... with their coefficients."""
    sequel: list[tuple[Flow, float]] = [(first, outer[0])]
    for i, o in zip(inner, outer[1:], strict=True):
        sequel += [(second, i), (first, o)]
    return tuple(sequel)


def symmetric(
    name: str,
    *,
    order: int,
    stages: int,
    first: Flow,
    a: Sequence[float] = (),
    b: Sequence[float] = (),
    kind: Literal["general", "nystroem"] = "general",
    reference: str = "",
    generalised: tuple[int, ...] = (),
) -> Scheme:
    """Build a scheme from its free coefficients.

    Parameters
    ----------
    name, order, stages, kind, first, reference, generalised
        As in `Scheme`.
    a, b : sequence of float
        The coefficients of drifts and kicks before the one that sum(a) = 1 or sum(b) = 1 decides.

    Raises
    ------
    ValueError
        If a table has not as many coefficients as the stages leave free, or holds a number that is not finite.
    """
    lengths = {first: stages + 1, "kick" if first == "drift" else "drift": stages}
    return Scheme(
        name,
        order,
        stages,
        kind,
        first,
        _palindrome(name, "a", a, lengths["drift"]),
        _palindrome(name, "b", b, lengths["kick"]),
        reference,
        generalised,
    )


def _palindrome(name: str, table: str, free: Sequence[float], length: int) -> tuple[float, ...]:
    """Close a table of free coefficients to a palindrome of the given length whose sum is one."""
    needed = (length - 1) // 2
    if len(free) != needed:
        raise ValueError(f"scheme {name}: {length} coefficients {table} leave {needed} free, {len(free)} are given")
    if not all(math.isfinite(c) for c in free):
        raise ValueError(f"scheme {name}: a coefficient {table} is not finite")
    if length % 2:
        return (*free, math.fsum([1.0, *(-2.0 * c for c in free)]), *reversed(free))
    half = (*free, math.fsum([0.5, *(-c for c in free)]))
    return (*half, *reversed(half))


def composition(name: str, *, order: int, steps: Sequence[float], stages: int, reference: str) -> Scheme:
    """Build the composition of Verlet steps, kick first, from the sizes of the first half of its steps."""
    sizes = _palindrome(name, "steps", steps, stages)
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

    Raises
    ------
    ValueError
        If n < 1.
    """
    if n < 1:
        raise ValueError(f"SABA_n needs n of 1 or more, not {n}")
    nodes, weights = np.polynomial.legendre.leggauss(n)
    drifts = np.diff(nodes, prepend=-1.0) / 2.0
    return symmetric(
        f"SABA_{n}",
        order=2,
        stages=n,
        first="drift",
        a=drifts[: n // 2].tolist(),
        b=(weights[: (n - 1) // 2] / 2.0).tolist(),
        reference=_LASKAR,
        generalised=(2 * n, 2),
    )


def sbab(n: int) -> Scheme:
    """Return SBAB_n, of the generalised orders (2n, 2): kicks at the n + 1 nodes of Lobatto, drifts between them.

    Raises
    ------
    ValueError
        If n < 1.
    """
    if n < 1:
        raise ValueError(f"SBAB_n needs n of 1 or more, not {n}")
    last = np.polynomial.legendre.Legendre.basis(n)
    nodes = np.concatenate([[-1.0], np.sort(last.deriv().roots().real), [1.0]])
    weights = 2.0 / (n * (n + 1) * last(nodes) ** 2)
    return symmetric(
        f"SBAB_{n}",
        order=2,
        stages=n,
        first="kick",
        a=(np.diff(nodes)[: (n - 1) // 2] / 2.0).tolist(),
        b=(weights[: n // 2] / 2.0).tolist(),
        reference=_LASKAR,
        generalised=(2 * n, 2),
    )


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
    turns = [
        (sign * i * alpha, sign * 0.5 * b[i - 1])
        for sign, order in ((1, -1), (-1, 1))
        for i in range(1, terms + 1)[::order]
    ]
    flows: list[tuple[Flow, float]] = []
    for a, kick in turns:
        flows += [("drift", a), ("kick", kick), ("drift", -2.0 * a), ("kick", -kick), ("drift", a)]
    return replace(
        kernel,
        name=name,
        order=min(generalised),
        generalised=generalised,
        processor=_merged(flows),
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


def _merged(flows: Iterable[tuple[Flow, float]]) -> Sequel:
    """Make one flow of neighbours of the same kind."""
    merged: list[tuple[Flow, float]] = []
    for flow, coefficient in flows:
        if merged and merged[-1][0] == flow:
            coefficient += merged.pop()[1]
        merged.append((flow, coefficient))
    return tuple(merged)


_VERLET = "L. Verlet, Phys. Rev. 159, 98 (1967), doi:10.1103/PhysRev.159.98"
_MCLACHLAN = "R. I. McLachlan, SIAM J. Sci. Comput. 16, 151 (1995), doi:10.1137/0916010"
_HMC = "S. Blanes, F. Casas and J. M. Sanz-Serna, SIAM J. Sci. Comput. 36, A1556 (2014), doi:10.1137/130932740"
# S4_6 with the fourth order given up for a small error at finite steps: its five free coefficients minimise the swing
# of the total energy of rigid TIP3P water at 2 fs a force evaluation; they were checked on other starts.
# Found by random searches and Nelder-Mead on the energy error of droplets of 64 TIP3P molecules, over starts that were
# used for nothing else.
_TUNED = "openmm-exactrb, tuned on rigid water at {} fs a force evaluation"
_OMELYAN = (
    "I. P. Omelyan, I. M. Mryglod and R. Folk, Comput. Phys. Commun. 146, 188 (2002), doi:10.1016/S0010-4655(02)00451-4"
)
_BLANES_MOAN = "S. Blanes and P. C. Moan, J. Comput. Appl. Math. 142, 313 (2002), doi:10.1016/S0377-0427(01)00492-7"

_LASKAR = "J. Laskar and P. Robutel, Celest. Mech. Dyn. Astron. 80, 39 (2001), doi:10.1023/A:1012098603882"
_YOSHIDA = "H. Yoshida, Phys. Lett. A 150, 262 (1990), doi:10.1016/0375-9601(90)90092-3"
_KAHAN_LI = "W. Kahan and R.-C. Li, Math. Comput. 66, 1089 (1997), doi:10.1090/S0025-5718-97-00873-9"
_PLANETS = "S. Blanes et al., Appl. Numer. Math. 68, 58 (2013), doi:10.1016/j.apnum.2013.01.003"
_V2_DRIFT = symmetric("V2_drift", order=2, stages=1, first="drift", reference=_VERLET)

_SCHEMES = (
    symmetric("V2", order=2, stages=1, first="kick", reference=_VERLET),
    _V2_DRIFT,
    symmetric("S2_2", order=2, stages=2, first="kick", b=(0.1931833275037836,), reference=_MCLACHLAN),
    symmetric("S2_3", order=2, stages=3, first="kick", a=(0.29619504261126,), b=(0.11888010966548,), reference=_HMC),
    symmetric(
        "S2_4",
        order=2,
        stages=4,
        first="kick",
        a=(0.1916678,),
        b=(0.071353913450279725904, 0.268548791161230105820),
        reference=_HMC,
    ),
    symmetric("W2_4", order=2, stages=4, first="drift", a=(0.08284, 0.27988), b=(0.21647,), reference=_TUNED.format(4)),
    symmetric(
        "W2_6",
        order=2,
        stages=6,
        first="drift",
        a=(0.08414, 0.3430, -0.0449),
        b=(0.2099, -0.1282),
        reference=_TUNED.format(2),
    ),
    symmetric(
        "W4_5",
        order=4,
        stages=5,
        kind="nystroem",
        first="kick",
        a=(0.254, -0.0365),
        b=(0.08477656200969587785212352836804759, 0.65654407453874424357010313964426243),
        reference=_TUNED.format(1),
    ),
    symmetric(
        "PEFRL",
        order=4,
        stages=4,
        first="drift",
        a=(0.1786178958448091, -0.06626458266981849),
        b=(0.5 + 0.2123418310626054,),
        reference=_OMELYAN,
    ),
    symmetric(
        "S4_6",
        order=4,
        stages=6,
        first="drift",
        a=(0.07920369643119565, 0.353172906049774, -0.04206508035771952),
        b=(0.209515106613362, -0.143851773179818),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "S6_10",
        order=6,
        stages=10,
        first="drift",
        a=(0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780),
        b=(0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "SRKN4_6b",
        order=4,
        stages=6,
        kind="nystroem",
        first="kick",
        a=(0.245298957184271, 0.604872665711080),
        b=(0.0829844064174052, 0.396309801498368, -0.0390563049223486),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "SRKN6_11b",
        order=6,
        stages=11,
        kind="nystroem",
        first="kick",
        a=(0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928),
        b=(0.0414649985182624, 0.198128671918067, -0.0400061921041533, 0.0752539843015807, -0.0115113874206879),
        reference=_BLANES_MOAN,
    ),
    symmetric(
        "SRKN6_14a",
        order=6,
        stages=14,
        kind="nystroem",
        first="drift",
        a=(
            0.0378593198406116,
            0.102635633102435,
            -0.0258678882665587,
            0.314241403071447,
            -0.130144459517415,
            0.106417700369543,
            -0.00879424312851058,
        ),
        b=(
            0.09171915262446165,
            0.183983170005006,
            -0.05653436583288827,
            0.004914688774712854,
            0.143761127168358,
            0.328567693746804,
        ),
        reference=_BLANES_MOAN,
    ),
    composition("Y4_3", order=4, stages=3, steps=(1.0 / (2.0 - 2.0 ** (1.0 / 3.0)),), reference=_YOSHIDA),
    composition(
        "Y6_7",
        order=6,
        stages=7,
        steps=(0.78451361047755726382, 0.23557321335935813368, -1.17767998417887100695),
        reference=_YOSHIDA,
    ),
    composition(
        "KL8_17",
        order=8,
        stages=17,
        steps=(
            0.13020248308889008087881763,
            0.56116298177510838456196441,
            -0.38947496264484728640807860,
            0.15884190655515560089621075,
            -0.39590389413323757733623154,
            0.18453964097831570709183254,
            0.25837438768632204729397911,
            0.29501172360931029887096624,
        ),
        reference=_KAHAN_LI,
    ),
    *(saba(n) for n in (2, 3, 4)),
    *(sbab(n) for n in (2, 3, 4)),
    symmetric(
        "ABA_8_4",
        order=4,
        stages=5,
        first="drift",
        a=(0.07534696026989288842, 0.51791685468825678230),
        b=(0.19022593937367661925, 0.84652407044352625706),
        reference=_PLANETS,
        generalised=(8, 4),
    ),
    symmetric(
        "ABA_8_6_4",
        order=4,
        stages=7,
        first="drift",
        a=(
            0.0711334264982231177779387300061549964174,
            0.241153427956640098736487795326289649618,
            0.521411761772814789212136078067994229991,
        ),
        b=(
            0.183083687472197221961703757166430291072,
            0.310782859898574869507522291054262796375,
            -0.0265646185119588006972121379164987592663,
        ),
        reference=_PLANETS,
        generalised=(8, 6, 4),
    ),
    symmetric(
        "ABA_10_6_4",
        order=4,
        stages=8,
        first="drift",
        a=(
            0.03809449742241219545697532230863756534060,
            0.1452987161169137492940200726606637497442,
            0.2076276957255412507162056113249882065158,
            0.4359097036515261592231548624010651844006,
        ),
        b=(
            0.09585888083707521061077150377145884776921,
            0.2044461531429987806805077839164344779763,
            0.2170703479789911017143385924306336714532,
        ),
        reference=_PLANETS,
        generalised=(10, 6, 4),
    ),
    corrected(_V2_DRIFT, 8, "V2_C17", (18, 2)),
)

# The kick of h V - (h³/24) f . M^-1 f leaves no other error of the order h².
_GRADIENT = (corrected(replace(_V2_DRIFT, c=(-1.0 / 24.0,)), 8, "V2_gradient_C17", (18, 4)),)

#: Schemes with force-gradient kicks by name, for problems that supply them (M. Takahashi and M. Imada, J. Phys. Soc.
#: Jpn. 53, 3765 (1984), doi:10.1143/JPSJ.53.3765).
FORCE_GRADIENT: Mapping[str, Scheme] = MappingProxyType({scheme.name: scheme for scheme in _GRADIENT})

#: All schemes that need forces only, by name; `scheme` knows SABA_n and SBAB_n for every n up to 99 beside them.
CATALOGUE: Mapping[str, Scheme] = MappingProxyType({scheme.name: scheme for scheme in _SCHEMES})


def scheme(name: str | Scheme) -> Scheme:
    """Look a scheme up, one with force-gradient kicks too; a `Scheme` is passed through.

    Raises
    ------
    ValueError
        If the catalogue has none of this name.
    """
    if isinstance(name, Scheme):
        return name
    generated = re.fullmatch(r"S(ABA|BAB)_([1-9]\d?)", name)
    if generated and name not in CATALOGUE:
        return (saba if generated[1] == "ABA" else sbab)(int(generated[2]))
    known = {**CATALOGUE, **FORCE_GRADIENT}
    if name not in known:
        raise ValueError(f"unknown scheme {name!r}: choose one of {', '.join(known)}")
    return known[name]


def stability_limit(scheme: Scheme, resolution: float = 1e-4) -> float:
    """Return the step, in units of 1/omega, up to which a harmonic oscillator stays bounded.

    Parameters
    ----------
    scheme : Scheme
    resolution : float, optional
        Steps are tried at multiples of this.

    Returns
    -------
    float
        The last step before the trace of the matrix of a step leaves [-2, 2]. A touch of the bounds by less than 1e-6,
        where two stable intervals meet, is passed over.
    """
    h = resolution
    while abs(_trace(scheme, h)) <= 2.0 + 1e-6:
        h += resolution
    return h - resolution


def _trace(scheme: Scheme, h: float) -> float:
    """Return the trace of the matrix of one step of q'' = -q."""
    (qq, qp), (pq, pp) = (1.0, 0.0), (0.0, 1.0)
    for flow, coefficient in scheme.sequence:
        tau = coefficient * h
        if flow == "drift":
            qq, qp = qq + tau * pq, qp + tau * pp
        else:
            tau *= 1.0 if flow == "kick" else 2.0 * h * h
            pq, pp = pq - tau * qq, pp - tau * qp
    return qq + pp
