"""How long a step a scheme bears."""

from __future__ import annotations

from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import DRIFT


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
    strengths = dict(scheme.gradients)
    for letter, part in scheme.word:
        tau = part * h
        if letter == DRIFT:
            qq, qp = qq + tau * pq, qp + tau * pp
        else:
            tau *= 1.0 - strengths.get(letter, 0.0) * tau * tau
            pq, pp = pq - tau * qq, pp - tau * qp
    return qq + pp
