"""Langevin dynamics: friction and noise by the exact Ornstein-Uhlenbeck flow of momenta.

Momenta are P (2, 3, N) in space and m (2, 3, K) in the body frame, as double-doubles of
`openmm_exactrb.mathematics.compensated`. Without low parts, their shapes are (1, 3, N) and (1, 3, K). The first K of
the N bodies rotate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from openmm_exactrb.context import variables
from openmm_exactrb.mathematics.compensated import add
from openmm_exactrb.openmm_access.units import RATE, gas_constant_times, kelvin
from openmm_exactrb.openmm_access.units import not_negative as not_negative_quantity
from openmm_exactrb.random.rng import Instant, Purpose
from openmm_exactrb.steps.environment import Environment
from openmm_exactrb.support.descriptions import mismatch
from openmm_exactrb.support.types import Array
from openmm_exactrb.thermostats.thermostat import Exchange, Thermostat

# Number of different durations of a heat exchange for which factors are cached.
_TIMES = 16
_BACKWARD = "stepSize must be positive when friction is non-zero"


@dataclass(frozen=True)
class Langevin(Thermostat):
    """Friction and noise on linear and angular momenta.

    Parameters
    ----------
    temperature : float or Quantity
        Temperature, in K if it has no unit.
    friction : float or Quantity
        Friction of translation, in 1/ps if it has no unit.
    rotationalFriction : float or Quantity, optional
        Friction of rotation, in 1/ps if it has no unit; by default the friction of translation.
    flexibleFriction : float or Quantity, optional
        Friction of translation and of rotation for all bodies in molecules of more than one body, such as a protein, in
        1/ps if it has no unit; by default the same frictions as for other bodies.
    """

    temperature: float
    friction: float
    rotationalFriction: float | None = None
    flexibleFriction: float | None = field(default=None, kw_only=True)

    numbers: ClassVar[tuple[str, ...]] = (variables.HEAT_OF_FRICTION,)
    heat: ClassVar[str | None] = variables.HEAT_OF_FRICTION

    def __post_init__(self) -> None:
        object.__setattr__(self, "temperature", kelvin(self.temperature))
        object.__setattr__(self, "friction", _rate(self.friction))
        for name in ("rotationalFriction", "flexibleFriction"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _rate(getattr(self, name)))

    @property
    def frictions(self) -> tuple[float, float]:
        """The frictions of translation and of rotation in 1/ps."""
        return self.friction, self.friction if self.rotationalFriction is None else self.rotationalFriction

    @property
    def flexible_frictions(self) -> tuple[float, float]:
        """The frictions of translation and of rotation, in 1/ps, of bodies in molecules of more than one body."""
        return self.frictions if self.flexibleFriction is None else (self.flexibleFriction, self.flexibleFriction)

    @property
    def relaxation(self) -> float | None:
        """The inverse (ps) of the smallest nonzero friction, or None without friction."""
        rates = [rate for rate in (*self.frictions, *self.flexible_frictions) if rate > 0.0]
        return 1.0 / min(rates) if rates else None

    @property
    def acts(self) -> bool:
        """Whether there is friction, or a subclass overrides the exchange."""
        return self.relaxation is not None or bool(mismatch(self, "frictions", *self.flows))

    def bind(self, environment: Environment) -> Exchange:
        """Return the Ornstein-Uhlenbeck flow."""
        bodies, kT = environment.bodies, gas_constant_times(self.temperature)
        frictions: tuple[float | Array, float | Array] = self.frictions
        if self.flexibleFriction is not None:
            flexible = environment.flexible()
            of_translation, of_rotation = (np.where(flexible, self.flexibleFriction, rate) for rate in self.frictions)
            frictions = of_translation, of_rotation[: bodies.n_turning]
        return ornstein_uhlenbeck(bodies.mass, bodies.principal_moments, kT, *frictions)

    def kernel_exchange(self, tau: float, freedom: tuple[int, int]) -> tuple[float, ...]:
        """Return exp(-g tau) - 1 and the width of the noise, for each of `frictions` and of `flexible_frictions`."""
        kT = gas_constant_times(self.temperature)
        rates = *self.frictions, *self.flexible_frictions
        if tau < 0.0 and any(rates):
            raise ValueError(_BACKWARD)
        pairs = ((math.expm1(-rate * tau), math.sqrt(kT) * _spread(rate, tau)) for rate in rates)
        return tuple(itertools.chain(*pairs))


def _rate(friction: Any) -> float:
    return not_negative_quantity(friction, RATE, "a friction")


def ornstein_uhlenbeck(
    mass: Array, moments: Array, kT: float, friction: float | Array, rotational_friction: float | Array
) -> Exchange:
    """Return the exact flow of dP = -g P dt + sqrt(2 g M kT) dW, and of the analogous equation for m and I.

    The flow is P <- a P + sqrt((1 - a²) kT M) xi with a = exp(-g tau). Two successive flows are equivalent to one flow
    over the sum of their times, and the Maxwell-Boltzmann distribution is invariant. For splittings with this flow, see
    B. Leimkuhler and C. Matthews (2013), doi:10.1063/1.4802990.

    Momenta whose masses (N,) or principal moments (3, K) are zero receive no noise. A friction is a number for all
    bodies, or an array with a number for each body. If all frictions are 0, the momenta are returned unchanged;
    otherwise times must not be negative.
    """
    width_P, width_m = np.sqrt(kT * np.tile(mass, (3, 1))), np.sqrt(kT * moments)
    fade_P, fade_m = _fading(friction, width_P), _fading(rotational_friction, width_m)

    def relaxed(x: Array, fading: _Fading, tau: float, at: Instant, part: Purpose) -> Array:
        """Return momenta after friction and noise over a time."""
        if (found := fading(tau)) is None:
            return x
        fade, spread = found
        change = fade * x[0] + spread * at.normals(part, spread.shape)
        return add(x, change)

    def exchange(P: Array, m: Array, tau: float, at: Instant) -> tuple[Array, Array]:
        return relaxed(P, fade_P, tau, at, Purpose.TRANSLATION), relaxed(m, fade_m, tau, at, Purpose.ROTATION)

    return exchange


def _spread(rate: float, tau: float) -> float:
    return math.sqrt(-math.expm1(-2.0 * rate * tau))


_Fading = Callable[[float], tuple[Array, Array] | None]


def _fading(friction: float | Array, width: Array) -> _Fading:
    """Return a function of tau that returns exp(-g tau) - 1 and the standard deviation of the noise, or None.

    None means that momenta do not change. Subtracting 1 makes the rounding errors of the change of momenta vanish
    together with the friction. A single friction and an array of frictions use the same function, so that their results
    are bit-identical.
    """
    rates, kinds = np.unique(friction, return_inverse=True)
    kinds = kinds.reshape(np.shape(friction))

    @lru_cache(maxsize=_TIMES)
    def fading(tau: float) -> tuple[Array, Array] | None:
        if tau == 0.0 or not rates.any():
            return None
        if tau < 0.0:
            raise ValueError(_BACKWARD)
        fade = np.array([math.expm1(-rate * tau) for rate in rates])
        spread = np.array([_spread(rate, tau) for rate in rates])
        return fade[kinds], spread[kinds] * width

    return fading
