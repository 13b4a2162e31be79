"""What a scheme makes of a harmonic oscillator: how long a step it bears, and which energy it keeps."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.sequence import Sequence
from openmm_exactrb.substeps import Matrix
from openmm_exactrb.support import checks

# Between two steps, and the number of them whose traces are computed as one array.
_RESOLUTION, _AT_ONCE = 1e-4, 10_000


def stability_limit(scheme: Scheme) -> float:
    """Return the step, in units of 1/omega, up to which a harmonic oscillator stays bounded.

    It is the last multiple of 1e-4 before the trace of the matrix of a step leaves [-2, 2]. A touch of the bounds by
    less than 1e-6, where two stable intervals meet, is passed over.

    Raises
    ------
    ValueError
        If the drifts or the kicks of a step do not last for the step.
    """
    if not all(math.isclose(math.fsum(parts), 1.0, rel_tol=1e-6) for parts in (scheme.a, scheme.b)):
        raise ValueError(
            f"scheme {scheme.name} does not advance an oscillator by the step: the fractions of its drifts, and of "
            "its kicks, must add up to 1"
        )
    number = 0
    while True:
        h = _RESOLUTION * np.arange(number + 1, number + _AT_ONCE)
        (qq, _), (_, pp) = oscillated(scheme.sequence, h)
        beyond = np.abs(qq + pp) > 2.0 + 1e-6
        if beyond.any():
            return float(h[np.argmax(beyond)]) - _RESOLUTION
        number += _AT_ONCE - 1


class Shadow(NamedTuple):
    """The energy kinetic p²/2 + potential q²/2 that a symmetric scheme keeps at the ends of steps of p²/2 + q²/2.

    Both numbers are 1 for the exact flow.
    """

    kinetic: float
    potential: float


def shadow(scheme: Scheme, step: float) -> Shadow:
    """Return what the energy that a scheme keeps exactly makes of its states, at the ends of steps.

    A step turns the plane of q and p along ellipses. So a state of temperature T' has <p²> = kT'/kinetic and
    <q²> = kT'/potential: in a liquid, where fast and slow modes exchange this energy, those with a larger `kinetic`
    look colder. Of a symmetric scheme they are 1 + 2 b step² and 1 + 2 a step² up to step², where b and a belong to the
    commutators of two kinetic and one potential energy, and of one and two. A thermostat within the step is left out.

    Parameters
    ----------
    scheme : Scheme
    step : float
        In units of 1/omega, above zero; it is taken to turn the oscillator once at most.

    Raises
    ------
    ValueError
        If the step is not a positive number, or steps of this size are unstable.
    """
    step = checks.positive(step, "step")
    (qq, qp), (pq, pp) = oscillated(scheme.sequence, step)
    # 1 - ((qq + pp)/2)², the squared sine of the angle, without its cancellation: the determinant is 1.
    square = -qp * pq - (0.5 * (qq - pp)) ** 2
    if not square > 0.0:
        raise ValueError(f"{scheme.name} is not stable at a step of {step:g}/omega: use a smaller one")
    sine = math.copysign(math.sqrt(square), qp)
    width = sine * (math.atan2(sine, 0.5 * (qq + pp)) % (2.0 * math.pi)) / step
    return Shadow(-width / pq, width / qp)


def oscillated(sequence: Sequence, h: Any) -> Matrix:
    """Return the matrix of a sequence for q'' = -q: ((dq/dq, dq/dp), (dp/dq, dp/dp)).

    Step sizes h, a number or an array, are in units of 1/omega; entries have their shape.
    """
    zero = 0.0 * h
    (qq, qp), (pq, pp) = (1.0 + zero, zero), (zero, 1.0 + zero)
    for substep, part in sequence:
        (aa, ab), (ba, bb) = substep.oscillator(part * h)
        qq, qp, pq, pp = aa * qq + ab * pq, aa * qp + ab * pp, ba * qq + bb * pq, ba * qp + bb * pp
    return (qq, qp), (pq, pp)
