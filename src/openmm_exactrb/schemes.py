"""Symmetric splitting schemes for H = T + V: tables of their free coefficients, and one catalogue.

A step of size h alternates drifts, the flow of T over a_i h, with kicks, the flow of V over b_i h. A table holds the
free coefficients only: each scheme is a palindrome, and sum(a) = sum(b) = 1 gives the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Flow = Literal["drift", "kick"]


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
    """

    name: str
    order: int
    stages: int
    kind: Literal["general", "nystroem"]
    first: Flow
    a: tuple[float, ...]
    b: tuple[float, ...]
    reference: str

    @property
    def sequence(self) -> tuple[tuple[Flow, float], ...]:
        """The flows of one step with their coefficients, in the order of their use."""
        second: Flow = "kick" if self.first == "drift" else "drift"
        outer, inner = (self.a, self.b) if self.first == "drift" else (self.b, self.a)
        alternating: list[tuple[Flow, float]] = [(self.first, outer[0])]
        for i, o in zip(inner, outer[1:], strict=True):
            alternating += [(second, i), (self.first, o)]
        return tuple(alternating)


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
) -> Scheme:
    """Build a scheme from its free coefficients.

    Parameters
    ----------
    name, order, stages, kind, first, reference
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


_VERLET = "L. Verlet, Phys. Rev. 159, 98 (1967), doi:10.1103/PhysRev.159.98"
_MCLACHLAN = "R. I. McLachlan, SIAM J. Sci. Comput. 16, 151 (1995), doi:10.1137/0916010"
_HMC = "S. Blanes, F. Casas and J. M. Sanz-Serna, SIAM J. Sci. Comput. 36, A1556 (2014), doi:10.1137/130932740"
# S4_6 with the fourth order given up for a small error at finite steps: its five free coefficients minimise the swing
# of the total energy of rigid TIP3P water at 2 fs a force evaluation; they were checked on other starts.
_TUNED = "openmm-exactrb, tuned on rigid water at 2 fs a force evaluation"
_OMELYAN = (
    "I. P. Omelyan, I. M. Mryglod and R. Folk, Comput. Phys. Commun. 146, 188 (2002), doi:10.1016/S0010-4655(02)00451-4"
)
_BLANES_MOAN = "S. Blanes and P. C. Moan, J. Comput. Appl. Math. 142, 313 (2002), doi:10.1016/S0377-0427(01)00492-7"

_SCHEMES = (
    symmetric("V2", order=2, stages=1, first="kick", reference=_VERLET),
    symmetric("V2_drift", order=2, stages=1, first="drift", reference=_VERLET),
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
    symmetric(
        "W2_6",
        order=2,
        stages=6,
        first="drift",
        a=(0.08414, 0.3430, -0.0449),
        b=(0.2099, -0.1282),
        reference=_TUNED,
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
)

#: All schemes by name.
CATALOGUE: Mapping[str, Scheme] = MappingProxyType({scheme.name: scheme for scheme in _SCHEMES})


def scheme(name: str | Scheme) -> Scheme:
    """Look a scheme up; a `Scheme` is passed through.

    Raises
    ------
    ValueError
        If the catalogue has none of this name.
    """
    if isinstance(name, Scheme):
        return name
    if name not in CATALOGUE:
        raise ValueError(f"unknown scheme {name!r}: choose one of {', '.join(CATALOGUE)}")
    return CATALOGUE[name]


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
            pq, pp = pq - tau * qq, pp - tau * qp
    return qq + pp
