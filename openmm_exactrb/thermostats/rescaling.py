"""Stochastic velocity rescaling, which samples the canonical kinetic energy with little disturbance of the motion.

G. Bussi, D. Donadio and M. Parrinello (2007), doi:10.1063/1.2408420. All momenta are multiplied by one factor. The
factor is chosen so that the kinetic energy follows its exact distribution after the duration of the substep.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from openmm import unit

from openmm_exactrb.context import variables
from openmm_exactrb.mathematics.compensated import add
from openmm_exactrb.openmm_access.units import gas_constant_times, kelvin, plain
from openmm_exactrb.random.rng import Instant, Purpose
from openmm_exactrb.steps.environment import Environment
from openmm_exactrb.support.checks import positive, switch
from openmm_exactrb.support.types import Array
from openmm_exactrb.thermostats.thermostat import Exchange, Factors, Thermostat

_BACKWARD = "stepSize must be positive with a thermostat"

#: factor(part, kinetic, freedom, tau, at) -> the factor of momenta; part 0 is translation, or all, and 1 rotation.
Factor = Callable[[int, float, int, float, Instant], float]


@dataclass(frozen=True)
class StochasticRescaling(Thermostat):
    """Multiplication of all momenta by one number, such that the kinetic energy has its canonical distribution.

    Parameters
    ----------
    temperature : float or Quantity
        Temperature, in K if it has no unit.
    relaxationTime : float or Quantity
        Relaxation time of the kinetic energy, in ps if it has no unit.
    together : bool, optional
        Whether one number multiplies all momenta; otherwise, translation and rotation have one number each.
    """

    temperature: float
    relaxationTime: float
    together: bool = True

    numbers = (variables.HEAT,)
    heat: ClassVar[str | None] = variables.HEAT
    factors = Factors("rescaling", (("RESCALING", 1),))

    def __post_init__(self) -> None:
        time = plain(self.relaxationTime, unit.picosecond, "a relaxation time")
        object.__setattr__(self, "temperature", kelvin(self.temperature))
        object.__setattr__(self, "relaxationTime", positive(time, "a relaxation time", "ps"))
        switch(self.together, "together")

    def kernel_exchange(self, tau: float, freedom: tuple[int, int]) -> tuple[float, ...]:
        """Return kT, the relaxation time, the degrees of freedom, and whether one number multiplies all momenta."""
        if tau < 0.0:
            raise ValueError(_BACKWARD)
        return gas_constant_times(self.temperature), self.relaxationTime, *map(float, freedom), float(self.together)

    def bind(self, environment: Environment) -> Exchange:
        """Return the rescaling of momenta."""
        bodies, kT = environment.bodies, gas_constant_times(self.temperature)
        settings = kT, self.relaxationTime, environment.degrees_of_freedom, self.together
        return rescaling(bodies.mass, bodies.principal_moments, *settings)


def rescaling(
    mass: Array, moments: Array, kT: float, time: float, freedom: tuple[int, int], together: bool
) -> Exchange:
    """Return the exact flow of stochastic velocity rescaling; `time` is tau of Bussi et al., the relaxation time.

    The total energy minus the heat is the effective energy of Bussi et al., which is conserved to the same accuracy as
    the total energy of the splitting without a thermostat. Momenta that are all zero have no direction and stay zero.
    """

    def factor(part: int, kinetic: float, f: int, tau: float, at: Instant) -> float:
        if tau < 0.0:
            raise ValueError(_BACKWARD)
        if kinetic == 0.0 or f == 0 or tau == 0.0:
            return 1.0
        purpose = (Purpose.TRANSLATION, Purpose.ROTATION)[part]
        along, across = float(at.normals(purpose, (1, 1))[0, 0]), 2.0 * at.gamma(purpose, 0.5 * (f - 1))
        return scaling(kinetic, kT, tau / time, along, across)

    return multiplication(mass, moments, freedom, together, factor)


def multiplication(mass: Array, moments: Array, freedom: tuple[int, int], together: bool, factor: Factor) -> Exchange:
    """Return an exchange that multiplies all momenta by one factor, or translation and rotation by one factor each.

    Masses are (N,) and principal moments (3, K); a moment is zero along the axis of a linear body.
    """
    (of_P, of_m), rate_P, rate_m = freedom, reciprocal(mass), reciprocal(moments)

    def exchange(P: Array, m: Array, tau: float, at: Instant) -> tuple[Array, Array]:
        T_P, T_m = kinetic_energy(P, rate_P), kinetic_energy(m, rate_m)
        if together:
            a_P = a_m = factor(0, T_P + T_m, of_P + of_m, tau, at)
        else:
            a_P, a_m = factor(0, T_P, of_P, tau, at), factor(1, T_m, of_m, tau, at)
        return scaled(P, a_P), scaled(m, a_m)

    return exchange


def kinetic_energy(x: Array, rate: Array) -> float:
    """Return the kinetic energy of momenta (2, 3, N), with their reciprocal masses or moments as `rate`."""
    return 0.5 * float(np.sum(x[0] * x[0] * rate))


def scaling(kinetic: float, kT: float, elapsed: float, along: float, across: float) -> float:
    """Return the factor for momenta with a given kinetic energy, as in the appendix of Bussi et al. (2007).

    In units where kT is one, the momenta form a vector of length r, each component of which relaxes as in
    `openmm_exactrb.thermostats.langevin`. Initially, the first component, along the vector, is r and the others are
    zero. The factor is the final length of the vector divided by r, with the sign of the first component: G. Bussi and
    M. Parrinello (2008), doi:10.1016/j.cpc.2008.01.006. The time `elapsed` is in relaxation times, `along` is a
    standard normal variate, and `across` is the sum of the squares of further such variates, one for each other degree
    of freedom.
    """
    noise = -math.expm1(-elapsed) * kT / (2.0 * kinetic)
    first = math.exp(-0.5 * elapsed) + math.sqrt(noise) * along
    return math.copysign(math.sqrt(first * first + noise * across), first)


def reciprocal(x: Array) -> Array:
    """Return 1/x, and 0 where x is 0."""
    return np.divide(1.0, x, out=np.zeros(np.shape(x)), where=x > 0.0)


def scaled(x: Array, factor: float) -> Array:
    """Return double-doubles (2, ...) times a factor close to one."""
    return x if factor == 1.0 else add(x, (factor - 1.0) * x[0])
