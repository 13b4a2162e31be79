"""Schemes with force-gradient kicks, which use forces at displaced positions instead of a Hessian.

Up to higher orders, a kick over b h by the forces at positions displaced by e h² F/M is the kick of V - (e/2) h² f .
M^-1 f, where f is the force. With such kicks, schemes of order 4 need no negative coefficients.

The terms of higher order are not the gradient of a potential and cause a drift of the energy. Positions are therefore
displaced by only e h² F/M / k, where k is `MAGNIFICATION`, and the change of the forces is multiplied by k. The
force-gradient term and the cost do not change, and the error is k times smaller. Rounding errors of the forces are also
multiplied by k, so that k must not be large.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from openmm_exactrb.schemes.scheme import Scheme, palindrome
from openmm_exactrb.steps.sequence import merged
from openmm_exactrb.steps.substeps import DRIFT, KICK, GradientKick, Substep

#: The factor k of the change of forces. With single-precision forces, 8 increases the energy error, and 4 does not.
MAGNIFICATION = 4.0

_TAKAHASHI_IMADA = "M. Takahashi and M. Imada, J. Phys. Soc. Jpn. 53, 3765 (1984), doi:10.1143/JPSJ.53.3765"
_CHIN = "S. A. Chin, Phys. Lett. A 226, 344 (1997), doi:10.1016/S0375-9601(97)00003-0"
_SCHAEFERS = (
    "K. Schäfers, J. Finkenrath, M. Günther and F. Knechtli, Comput. Phys. Commun. 309, 109478 (2025), "
    "doi:10.1016/j.cpc.2024.109478"
)


def force_gradient(
    name: str,
    pattern: str,
    *,
    order: int,
    a: Sequence[float] = (),
    b: Sequence[float] = (),
    e: Sequence[float] = (),
    magnification: float = MAGNIFICATION,
    reference: str = "",
) -> Scheme:
    """Return the scheme with a given pattern of substeps and given free coefficients.

    Parameters
    ----------
    name, order, reference
        As in `Scheme`.
    pattern : str
        Pattern of a step: a palindrome, such as "BACAB", of alternating drifts "A" and kicks "B" or "C". A kick "C" has
        a force-gradient term.
    a, b : sequence of float
        The coefficients of drifts, and of kicks of both kinds, that precede the coefficient determined by sum(a) = 1 or
        sum(b) = 1.
    e : sequence of float
        Coefficient of each "C" in the first half: the kick uses forces at R + e h² F/M to first order in e.
    magnification : float
        Forces are evaluated at R + e h² F/M / magnification, and their difference from the forces at R is multiplied by
        the magnification. With 1, the kick uses the forces at the displaced positions alone.

    Raises
    ------
    ValueError
        If the pattern is not such a palindrome, if the number of coefficients is wrong, or if a number is not
        finite or the magnification is zero.
    """
    drifts, kicks = pattern[::2], pattern[1::2]
    if drifts[:1] != "A":
        drifts, kicks = kicks, drifts
    if pattern != pattern[::-1] or {*drifts} != {"A"} or not {*kicks} <= {"B", "C"} or not kicks:
        raise ValueError(
            f"scheme {name}: {pattern!r} is not a palindrome of alternating drifts A and kicks "
            "B or C, such as 'ABACABA'"
        )
    half = (len(kicks) + 1) // 2
    if kicks[:half].count("C") != len(e):
        raise ValueError(
            f"scheme {name}: the length of e must be {kicks[:half].count('C')}, not {len(e)}: pass one number for "
            f"each C in the first half of {pattern!r}, including a C in the middle"
        )
    if not all(map(math.isfinite, e)):
        raise ValueError(f"scheme {name}: coefficients e must be finite")
    if not (math.isfinite(magnification) and magnification):
        raise ValueError(f"scheme {name}: magnification must be a finite number other than 0, not {magnification}")
    parts, displacements = palindrome(name, "b", b, len(kicks)), iter(e)
    rows = [_kicks(kick, part, displacements, magnification) for kick, part in zip(kicks, parts[:half], strict=False)]
    places = iter([*rows, *rows[: len(kicks) - half][::-1]])
    times = iter(palindrome(name, "a", a, len(drifts)))
    steps = ([(DRIFT, next(times))] if substep == "A" else next(places) for substep in pattern)
    return Scheme(name, order, tuple(itertools.chain(*steps)), reference=reference)


def _kicks(kind: str, part: float, displacements: Iterator[float], k: float) -> list[tuple[Substep, float]]:
    """Return the kicks at one position: b f(R + d) becomes b (1 - k) f(R) + b k f(R + d/k)."""
    if kind == "B":
        return [(KICK, part)]
    strength = next(displacements) / part**2 / k**3
    plain: list[tuple[Substep, float]] = [(KICK, (1.0 - k) * part)] if k != 1.0 else []
    return [*plain, (GradientKick(strength), k * part)]


def _takahashi_imada(magnification: float) -> Scheme:
    return force_gradient(
        "TI2", "ACA", order=2, e=(1.0 / 12.0,), magnification=magnification, reference=_TAKAHASHI_IMADA
    )


#: A force-gradient kick between half drifts, of order 2, or of order 4 after a change of coordinates.
TAKAHASHI_IMADA = _takahashi_imada(MAGNIFICATION)
_MIRRORED = _takahashi_imada(-MAGNIFICATION)
#: Two steps of `TAKAHASHI_IMADA` of half the size, with displacements of opposite sign, in which terms beyond first
#: order cancel. The sequence is not a palindrome, but time-reversible up to the remaining terms.
TAKAHASHI_IMADA_PAIR = replace(
    TAKAHASHI_IMADA,
    name="TI2 in pairs",
    sequence=merged((substep, 0.5 * part) for substep, part in (*TAKAHASHI_IMADA.sequence, *_MIRRORED.sequence)),
)

#: Schemes, sorted by the number of force evaluations per step, including those at displaced positions. The tables of
#: Schäfers et al. are for kicks by forces at displaced positions: e = 2 c/b in their notation.
FORCE_GRADIENT = (
    TAKAHASHI_IMADA,
    force_gradient("Chin4A", "BACAB", order=4, b=(1.0 / 6.0,), e=(1.0 / 24.0,), reference=_CHIN),
    force_gradient("Chin4B", "ACACA", order=4, a=(0.5 - 12.0**-0.5,), e=((2.0 - 3.0**0.5) / 12.0,), reference=_CHIN),
    force_gradient("Chin4C", "ABACABA", order=4, a=(1.0 / 6.0,), b=(3.0 / 8.0,), e=(1.0 / 24.0,), reference=_CHIN),
    force_gradient(
        "G4_4",
        "ABACABA",
        order=4,
        a=(0.089775972994422,),
        b=(0.247597680043986,),
        e=(2.0 * 0.006911440413815 / 0.504804639912028,),
        reference=_SCHAEFERS,
    ),
    force_gradient(
        "G4_5",
        "BABACABAB",
        order=4,
        a=(0.200395293638238,),
        b=(0.073943321445602, 0.258244950046509),
        e=(2.0 * 0.003147048491590 / 0.335623457015778,),
        reference=_SCHAEFERS,
    ),
    force_gradient(
        "G4_7",
        "BACABABACAB",
        order=4,
        a=(0.201110227930330, 0.200577842713366),
        b=(0.065692416344302, 0.264163604920340),
        e=(2.0 * 0.001036943019757 / 0.264163604920340,),
        reference=_SCHAEFERS,
    ),
)
