"""Nosé-Hoover chains for rigid bodies: deterministic, time-reversible, with a conserved quantity.

Translation and rotation have one chain each, or share one: G. J. Martyna, M. L. Klein and M. Tuckerman, J. Chem. Phys.
97, 2635 (1992), doi:10.1063/1.463940. The flow of the chain and of the kinetic energy that it scales is computed by the
time-reversible splitting of G. J. Martyna, M. E. Tuckerman, D. J. Tobias and M. L. Klein, Mol. Phys. 87, 1117 (1996),
doi:10.1080/00268979600100761. The splitting needs only the kinetic energies of the bodies, so that angular momenta are
scaled in the same way as linear momenta.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from openmm_exactrb.errors import IntegrationError
from openmm_exactrb.openmm_access.units import RATE, gas_constant_times, kelvin, plain
from openmm_exactrb.random.rng import Instant
from openmm_exactrb.steps.environment import Environment
from openmm_exactrb.support.checks import switch, whole
from openmm_exactrb.support.types import Array
from openmm_exactrb.thermostats.rescaling import multiplication
from openmm_exactrb.thermostats.thermostat import Exchange, Factors, Thermostat

_YOSHIDA = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
_SUZUKI = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
_SIXTH = (0.78451361047755726382, 0.23557321335935813368, -1.17767998417887100695)
#: Weights of the substeps of the chain by the number of substeps, of order 2, 4, 4 and 6: H. Yoshida (1990),
#: doi:10.1016/0375-9601(90)90092-3, and M. Suzuki (1990), doi:10.1016/0375-9601(90)90962-N. The cubes of the weights of
#: order 4 add up to zero. OpenMM and GROMACS, for example, use 2^(-1/3) and 4^(-1/3) instead of 2^(1/3) and 4^(1/3) for
#: 3 and 5 substeps. The cubes of their weights, 0.829 and 0.297, add up to 0.85 and 0.098, and the order is 2.
WEIGHTS: Mapping[int, tuple[float, ...]] = {
    1: (1.0,),
    3: (_YOSHIDA, 1.0 - 2.0 * _YOSHIDA, _YOSHIDA),
    5: (_SUZUKI, _SUZUKI, 1.0 - 4.0 * _SUZUKI, _SUZUKI, _SUZUKI),
    7: (*_SIXTH, 1.0 - 2.0 * math.fsum(_SIXTH), *_SIXTH[::-1]),
}


@dataclass(frozen=True)
class NoseHooverChain(Thermostat):
    """Nosé-Hoover chains, whose links have a coordinate and a velocity each; the first link scales momenta.

    Parameters
    ----------
    temperature : float or Quantity
        Temperature, in K if it has no unit; it must be above zero.
    collisionFrequency : float or Quantity
        Collision frequency of the chain, in 1/ps if it has no unit; it must be above zero.
    chainLength : int, optional
        Number of links in a chain.
    numMTS : int, optional
        Number of repetitions of the substeps of the chain.
    numYoshidaSuzuki : {1, 3, 5, 7}, optional
        Number of substeps in the splitting of the flow of the chain.
    together : bool, optional
        Whether translation and rotation share one chain; otherwise, each has its own.
    """

    temperature: float
    collisionFrequency: float
    chainLength: int = 3
    numMTS: int = 3
    numYoshidaSuzuki: int = 7
    together: bool = False

    flows: ClassVar[tuple[str, ...]] = (*Thermostat.flows, "moved")
    scheme: ClassVar[str] = "BAOAB"  # symmetric in time, as the chains are

    def __post_init__(self) -> None:
        frequency = plain(self.collisionFrequency, RATE, "a collision frequency")
        object.__setattr__(self, "temperature", kelvin(self.temperature))
        object.__setattr__(self, "collisionFrequency", frequency)
        if not (self.temperature > 0.0 and frequency > 0.0 and frequency**2 > 0.0):
            raise ValueError(
                "a Nosé-Hoover chain needs a temperature and a collision frequency above zero, not "
                f"{self.temperature:g} K and {frequency:g}/ps"
            )
        for name in ("chainLength", "numMTS", "numYoshidaSuzuki"):
            object.__setattr__(self, name, whole(getattr(self, name), name))
        if self.numYoshidaSuzuki not in WEIGHTS:
            raise ValueError(f"numYoshidaSuzuki must be one of 1, 3, 5 and 7, not {self.numYoshidaSuzuki!r}")
        switch(self.together, "together")

    @property
    def own_numbers(self) -> tuple[str, ...]:
        """The names of the coordinates and velocities of the chains."""
        return tuple(name for chain in range(1 if self.together else 2) for name in self._names(chain))

    @cached_property
    def _kT(self) -> float:
        return gas_constant_times(self.temperature)

    def _names(self, chain: int) -> list[str]:
        links = range(self.chainLength)
        return [f"chain{chain}_{what}{link}" for what in ("coordinate", "velocity") for link in links]

    @property
    def factors(self) -> Factors:  # type: ignore[override]
        """The kernel of the chains, with their length and their substeps as macros."""
        weights = WEIGHTS[self.numYoshidaSuzuki]
        sizes = ("CHAIN", self.chainLength), ("REPETITIONS", self.numMTS), ("N_WEIGHTS", len(weights))
        return Factors("nose_hoover", (*sizes, ("WEIGHTS", ", ".join(map(repr, weights)))))

    @property
    def diverged(self) -> str:  # type: ignore[override]
        """The message about a chain that diverged, with the remedies."""
        return (
            "a Nosé-Hoover chain diverged within a step: use a smaller step size, a lower collisionFrequency than "
            f"{self.collisionFrequency:g}/ps, or a larger numMTS"
        )

    def kernel_exchange(self, tau: float, freedom: tuple[int, int]) -> tuple[float, ...]:
        """Return kT, the frequency, the degrees of freedom, and whether all momenta share one chain."""
        return self._kT, self.collisionFrequency, *map(float, freedom), float(self.together)

    def bind(self, environment: Environment) -> Exchange:
        """Return the flow of the chains and of the momenta that they scale."""
        bodies, numbers = environment.bodies, environment.numbers
        names = [self._names(chain) for chain in range(1 if self.together else 2)]

        def factor(chain: int, kinetic: float, freedom: int, tau: float, at: Instant) -> float:
            values = np.array([numbers.present[name] for name in names[chain]]).reshape(2, -1)
            scale, moved = self.moved(values, kinetic, freedom, tau)
            numbers.present.update(zip(names[chain], moved.ravel().tolist(), strict=True))
            return scale

        freedom = environment.degrees_of_freedom
        return multiplication(bodies.mass, bodies.principal_moments, freedom, self.together, factor)

    def moved(self, chain: Array, kinetic: float, freedom: int, tau: float) -> tuple[float, Array]:
        """Return the factor by which momenta are multiplied over a time tau (ps), and the chain after this time.

        The order of the substeps is palindromic, so that the flow over -tau is the inverse flow. As in the equations of
        motion, the displacement of the coordinates determines the change of volume, so that the measure of the extended
        phase space is preserved exactly. A chain is an array (2, chainLength) of coordinates and of velocities in 1/ps.
        Without degrees of freedom nothing changes.
        """
        if not freedom:
            return 1.0, chain
        try:
            scale, moved = self._pushed(chain.tolist(), kinetic, freedom, tau)
        except OverflowError:
            scale, moved = math.inf, chain
        if not (math.isfinite(scale) and np.isfinite(moved).all()):
            raise IntegrationError(f"{self.diverged}. The Context keeps the state before this step")
        return scale, moved

    def _pushed(self, chain: list[list[float]], kinetic: float, freedom: int, tau: float) -> tuple[float, Array]:
        # Python floats are faster here than short arrays. The acceleration of a link is frequency² times (r - 1). Here
        # r is the kinetic energy of the previous link over kT/2 or, for the first link, the kinetic energy of momenta
        # with f degrees of freedom over f kT/2.
        x, v = chain
        links, scale = range(len(v)), 1.0
        square, ratio = self.collisionFrequency**2, 2.0 * kinetic / (freedom * self._kT)
        below = [float(freedom), *[1.0] * len(v)]  # masses in units of that of the last link
        v.append(0.0)  # the velocity of a nonexistent further link, which exerts no drag

        def push(link: int, h: float) -> None:
            speed = v[link - 1]
            pull = below[link - 1] * speed * speed - square if link else square * (ratio * scale * scale - 1.0)
            drag = math.exp(-0.5 * h * v[link + 1])
            v[link] = (v[link] * drag + h * pull) * drag

        for weight in WEIGHTS[self.numYoshidaSuzuki] * self.numMTS:
            h = weight * tau / self.numMTS
            for link in reversed(links):
                push(link, 0.5 * h)
            scale *= math.exp(-h * v[0])
            for link in links:
                x[link] += h * v[link]
            for link in links:
                push(link, 0.5 * h)
        return scale, np.array([x, v[:-1]])

    def masses(self, freedom: int) -> Array:
        """Return the masses of the links of a chain (chainLength,) in kJ/mol ps²."""
        link = self._kT / self.collisionFrequency**2
        return np.array([freedom * link, *[link] * (self.chainLength - 1)])

    def energy(self, values: Mapping[str, float], freedoms: tuple[int, int]) -> float:
        """Return the energy (kJ/mol) of the chains; the sum of this energy and that of the bodies is conserved.

        The energy is computed from the values of `own_numbers`, for given translational and rotational degrees of
        freedom.
        """
        kT, total = self._kT, 0.0
        for chain, freedom in enumerate([sum(freedoms)] if self.together else freedoms):
            x, v = np.array([values[name] for name in self._names(chain)]).reshape(2, -1)
            if freedom:
                total += 0.5 * float(self.masses(freedom) @ (v * v)) + kT * float(freedom * x[0] + x[1:].sum())
        return total
