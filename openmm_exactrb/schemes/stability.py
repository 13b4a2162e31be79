"""The behaviour of a scheme for a harmonic oscillator: its stability limit and its conserved energy."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.sequence import Sequence
from openmm_exactrb.steps.substeps import Matrix
from openmm_exactrb.support import checks
from openmm_exactrb.support.descriptions import mismatch

# The spacing of the tested steps, and the number of steps that are tested together.
_RESOLUTION, _AT_ONCE = 1e-4, 10_000


def stability_limit(scheme: Scheme) -> float:
    """Return the largest step, in units of 1/omega, at which an oscillator of angular frequency omega is stable.

    The result is the last multiple of 1e-4 before the trace of the matrix of a step leaves [-2, 2]. Points where two
    stable intervals meet are ignored if the trace exceeds [-2, 2] by less than 1e-6.

    Raises
    ------
    ValueError
        If the fractions of the drifts or of the kicks do not add up to 1.
    """
    if not all(math.isclose(math.fsum(parts), 1.0, rel_tol=1e-6) for parts in (scheme.a, scheme.b)):
        raise ValueError(
            f"scheme {scheme.name} does not advance an oscillator by the step: make the fractions of its drifts, and "
            "those of its kicks, add up to 1"
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
    """The energy kinetic p²/2 + potential q²/2 that a symmetric scheme conserves for the Hamiltonian p²/2 + q²/2.

    Both coefficients are 1 for the exact flow.
    """

    kinetic: float
    potential: float


def shadow(scheme: Scheme, step: float) -> Shadow:
    """Return the coefficients of the energy that a scheme conserves exactly at the ends of its steps.

    Steps move points of the (q, p) plane along ellipses. A mode at temperature T' therefore has <p²> = kT'/kinetic and
    <q²> = kT'/potential. In a liquid, where fast and slow modes exchange the conserved energy, modes with a larger
    `kinetic` appear colder. Up to second order, the coefficients of a symmetric scheme are 1 + 2 b step² and 1 + 2 a
    step², where b is the coefficient of the commutator of two kinetic energies and one potential energy, and a is the
    coefficient of the commutator of one kinetic energy and two potential energies. A thermostat within the step is
    ignored.

    Parameters
    ----------
    scheme : Scheme
    step : float
        Step size in units of 1/omega, above zero and at most one period.

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
        raise ValueError(f"scheme {scheme.name} is not stable at a step of {step:g}/omega: use a smaller step")
    sine = math.copysign(math.sqrt(square), qp)
    width = sine * (math.atan2(sine, 0.5 * (qq + pp)) % (2.0 * math.pi)) / step
    return Shadow(-width / pq, width / qp)


def oscillated(sequence: Sequence, h: Any) -> Matrix:
    """Return the matrix of a sequence for q'' = -q: ((dq/dq, dq/dp), (dp/dq, dp/dp)).

    The step size h, a number or an array, is in units of 1/omega; the entries have the shape of h. A ValueError is
    raised for a substep whose matrix is unknown.
    """
    zero = 0.0 * h
    (qq, qp), (pq, pp) = (1.0 + zero, zero), (zero, 1.0 + zero)
    for substep, part in sequence:
        (aa, ab), (ba, bb) = substep.oscillator(part * h)
        if why := mismatch(substep, "oscillator", "bind"):
            raise ValueError(why)
        qq, qp, pq, pp = aa * qq + ab * pq, aa * qp + ab * pp, ba * qq + bb * pq, ba * qp + bb * pp
    return (qq, qp), (pq, pp)
