"""Stochastic velocity rescaling: the kinetic energy finds its canonical distribution, the motion is hardly disturbed.

G. Bussi, D. Donadio and M. Parrinello (2007), doi:10.1063/1.2408420. All momenta are multiplied by one number, drawn
from the exact law of the kinetic energy a time tau later.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.checks import not_negative, positive, whole
from openmm_exactrb.compensated import add
from openmm_exactrb.motion.draws import Draws, Instant, Purpose

Array = NDArray[np.float64]

#: rescale(P, m, tau, at) -> (P, m, heat): momenta as those of `openmm_exactrb.motion.bath`, and the energy gained.
Rescaling = Callable[[Array, Array, float, Instant], tuple[Array, Array, float]]

_DECISIONS = {
    Purpose.TRANSLATION: Purpose.TRANSLATION_DECISIONS,
    Purpose.ROTATION: Purpose.ROTATION_DECISIONS,
}
# One attempt at a gamma variate succeeds in 95 of 100 cases at least; so many are looked at together.
_ATTEMPTS = 8


def rescaling(
    mass: Array,
    moments: Array,
    kT: float,
    time: float,
    freedom: tuple[int, int],
    draws: Draws,
    together: bool = True,
) -> Rescaling:
    """Prepare the exact flow of stochastic velocity rescaling.

    The total energy less the sum of all heat is the paper's effective energy: it is as constant as the total energy of
    the splitting without a bath.

    Parameters
    ----------
    mass : (N,) array
    moments : (3, K) array
        Principal moments: zero along the axis of a linear body.
    kT : float
        Boltzmann's constant times temperature, in the unit of energy.
    time : float
        Relaxation time of the kinetic energy, the paper's tau.
    freedom : (int, int)
        Translational and rotational degrees of freedom. Where the total momentum is kept at zero they are three fewer.
    draws : Draws
    together : bool, optional
        Whether one number multiplies all momenta; if not, translation and rotation get one each.

    Returns
    -------
    rescale : callable
        rescale(P, m, tau, at) -> (P, m, heat). Momenta that are all zero have no direction and stay. It raises
        ValueError if tau is negative.

    Raises
    ------
    ValueError
        If kT is negative, time not positive, or a number of degrees of freedom negative.
    """
    kT, time = not_negative(kT, "kT"), positive(time, "the relaxation time")
    of_P, of_m = (whole(f, "a number of degrees of freedom", 0) for f in freedom)
    rate_P, rate_m = _reciprocal(mass), _reciprocal(moments)

    def factor(kinetic: float, f: int, tau: float, at: Instant, part: Purpose) -> float:
        if tau < 0.0:
            raise ValueError("a bath has no way back in time: use a positive step")
        if kinetic == 0.0 or f == 0 or tau == 0.0:
            return 1.0
        along, across = _gaussian_and_squares(f - 1, draws, at, part)
        return scaling(kinetic, kT, tau / time, along, across)

    def rescale(P: Array, m: Array, tau: float, at: Instant) -> tuple[Array, Array, float]:
        T_P, T_m = kinetic_energy(P, rate_P), kinetic_energy(m, rate_m)
        if together:
            a_P = a_m = factor(T_P + T_m, of_P + of_m, tau, at, Purpose.TRANSLATION)
        else:
            a_P = factor(T_P, of_P, tau, at, Purpose.TRANSLATION)
            a_m = factor(T_m, of_m, tau, at, Purpose.ROTATION)
        heat = (a_P - 1.0) * (a_P + 1.0) * T_P + (a_m - 1.0) * (a_m + 1.0) * T_m
        return _scaled(P, a_P), _scaled(m, a_m), heat

    return rescale


def kinetic_energy(x: Array, rate: Array) -> float:
    """Return x . x rate / 2 of momenta (2, 3, N) and reciprocal masses or moments."""
    return 0.5 * float(np.sum(x[0] * x[0] * rate))


def scaling(kinetic: float, kT: float, elapsed: float, along: float, across: float) -> float:
    """Return the number that multiplies the momenta: the paper's appendix.

    In units where kT is one the momenta are a vector of length r, whose every component relaxes as
    `openmm_exactrb.motion.bath` has it. The component along the vector is r before, the others are zero: the number is
    the vector's length afterwards, over r. Its sign is that of the first component: G. Bussi and M. Parrinello (2008),
    doi:10.1016/j.cpc.2008.01.006.

    Parameters
    ----------
    kinetic : float
        Kinetic energy before, above zero.
    kT : float
    elapsed : float
        Time over relaxation time of the kinetic energy.
    along : float
        A standard normal.
    across : float
        Sum of the squares of as many normals as there are other degrees of freedom.
    """
    noise = -math.expm1(-elapsed) * kT / (2.0 * kinetic)
    first = math.exp(-0.5 * elapsed) + math.sqrt(noise) * along
    return math.copysign(math.sqrt(first * first + noise * across), first)


def _gaussian_and_squares(n: int, draws: Draws, at: Instant, part: Purpose) -> tuple[float, float]:
    """Return a standard normal, and the sum of the squares of n others."""
    along, odd = (float(x) for x in draws.normals(at, part, (2, 1))[:, 0])
    square = odd * odd if n % 2 else 0.0
    return along, square + (2.0 * gamma_variate(n // 2, draws, at, part) if n > 1 else 0.0)


def gamma_variate(shape: float, draws: Draws, at: Instant, part: Purpose) -> float:
    """Return a gamma variate of a shape of at least one.

    By the method of G. Marsaglia and W. W. Tsang (2000), doi:10.1145/358407.358414, where the number of the attempt
    is a part of the address of its random numbers.
    """
    d = shape - 1.0 / 3.0
    attempts = _ATTEMPTS
    while True:
        x = draws.normals(at, part, (3, attempts))[2]
        u = draws.uniforms(at, _DECISIONS[part], (1, attempts))[0]
        v = (1.0 + x / math.sqrt(9.0 * d)) ** 3
        # A logarithm that is one bit off changes nothing: it only decides.
        with np.errstate(invalid="ignore", divide="ignore"):  # v <= 0 is refused
            taken = (v > 0.0) & (np.log(u) < 0.5 * x * x + d * (1.0 - v + np.log(v)))
        if taken.any():
            return d * float(v[np.argmax(taken)])
        attempts *= 2


def _reciprocal(x: Array) -> Array:
    """Return 1/x, and 0 where x is 0."""
    return np.divide(1.0, x, out=np.zeros(np.shape(x)), where=x > 0.0)


def _scaled(x: Array, factor: float) -> Array:
    """Return a sum (2, ...) times a number next to one."""
    return x if factor == 1.0 else add(x, (factor - 1.0) * x[0])
