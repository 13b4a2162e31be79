"""Friction and noise: the exact Ornstein-Uhlenbeck flow of momenta, the letter O of Langevin splittings.

Momenta are P (2, 3, N) in space and m (2, 3, K) in the body frame, sums high + low of `openmm_exactrb.compensated`, or
(1, 3, N) and (1, 3, K) without the low part. The first K of N bodies turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.checks import not_negative
from openmm_exactrb.motion.draws import Instant, Purpose

Array = NDArray[np.float64]

#: bath(P, m, tau, at) -> (P, m): new arrays, or the same ones where nothing happens.
Bath = Callable[[Array, Array, float, Instant], tuple[Array, Array]]


class Relax(Protocol):
    """The kernel of this flow, in numpy or compiled: `kernels.plain.bath.relax` and its twin."""

    def __call__(
        self,
        x: Array,
        width: Array,
        fade: float,
        spread: float,
        seed: int,
        step: int,
        stream: int,
        first: int,
        last: int,
        total: Array,
        /,
    ) -> None:
        """Write x + fade x + spread width xi into the columns [first, last) of `total`."""


def langevin(mass: Array, moments: Array, kT: float, friction: float, rotational_friction: float, relax: Relax) -> Bath:
    """Prepare the exact flow of dP = -g P dt + sqrt(2 g M kT) dW, and the same of m with I and a friction of its own.

    It is P <- a P + sqrt((1 - a²) kT M) xi with a = exp(-g tau). Two flows one after the other are one of both times,
    and the Maxwell-Boltzmann distribution stays what it is. For splittings with it see B. Leimkuhler and C. Matthews
    (2013), doi:10.1063/1.4802990.

    Parameters
    ----------
    mass : (N,) array
        Bodies without mass get no noise.
    moments : (3, K) array
        Principal moments: zero along the axis of a linear body, which gets no noise there.
    kT : float
        Boltzmann's constant times temperature, in the unit of energy.
    friction, rotational_friction : float
        In the unit of 1/time. Where it is 0 the momenta are handed back as they came.
    relax : callable

    Returns
    -------
    bath : callable
        bath(P, m, tau, at) -> (P, m). It raises ValueError if tau is negative and there is friction.

    Raises
    ------
    ValueError
        If kT or a friction is negative or not finite.
    """
    kT = not_negative(kT, "kT")
    g_P, g_m = not_negative(friction, "friction"), not_negative(rotational_friction, "rotational friction")
    width_P, width_m = np.sqrt(kT * np.tile(mass, (3, 1))), np.sqrt(kT * np.ascontiguousarray(moments))

    def relaxed(x: Array, width: Array, elapsed: float, at: Instant, part: Purpose) -> Array:
        """Return momenta after a time in units of 1/friction."""
        if elapsed == 0.0:
            return x
        if elapsed < 0.0:
            raise ValueError("friction has no way back in time: use a positive step, or friction 0")
        # As a change of x, for then rounding fades together with the friction.
        fade, spread = math.expm1(-elapsed), math.sqrt(-math.expm1(-2.0 * elapsed))
        total = np.empty(x.shape)
        relax(
            np.ascontiguousarray(x), width, fade, spread, at.seed, at.step, at.stream(part), 0, x.shape[2], total
        )  # fmt: skip
        return total

    def bath(P: Array, m: Array, tau: float, at: Instant) -> tuple[Array, Array]:
        return (
            relaxed(P, width_P, g_P * tau, at, Purpose.TRANSLATION),
            relaxed(m, width_m, g_m * tau, at, Purpose.ROTATION),
        )

    return bath
