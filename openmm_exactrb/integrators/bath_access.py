"""Methods of an integrator with a thermostat, which an integrator without one does not have."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from openmm import unit

from openmm_exactrb.context import variables
from openmm_exactrb.integrators.body_access import BodyAccess, freedom_of, temperatures_of, thermal_energies
from openmm_exactrb.support.descriptions import changed

_ENERGY = unit.kilojoule_per_mole


class Tally(NamedTuple):
    """The numbers of accepted proposals and of all proposals."""

    accepted: int = 0
    proposed: int = 0


class _OfThermostats:
    """A method of an integrator whose thermostat fulfils a condition; other integrators have no such attribute."""

    def __init__(self, method: Callable[..., Any], condition: Callable[[Any], Any]) -> None:
        self._method, self._condition = method, condition
        self.__doc__ = method.__doc__

    def __get__(self, integrator: Any, owner: type[Any] | None = None) -> Any:
        if integrator is None:
            return self._method
        name, thermostat = self._method.__name__, integrator.getThermostat()
        if thermostat is None:
            raise AttributeError(f"an integrator without a thermostat has no {name}(): pass thermostat=")
        if not self._condition(thermostat):
            raise AttributeError(f"an integrator with the thermostat {type(thermostat).__name__} has no {name}()")
        return self._method.__get__(integrator)


def _available(condition: Callable[[Any], Any] = lambda thermostat: True) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator of methods that are available for thermostats that fulfil a condition."""
    return lambda method: _OfThermostats(method, condition)


def _has_energy(thermostat: Any) -> bool:
    return thermostat.heat is not None or hasattr(thermostat, "energy")


def _has_proposals(thermostat: Any) -> bool:
    return variables.PROPOSED in thermostat.numbers


class BathAccess(BodyAccess):
    """The thermostat of an integrator: its settings, and what it has exchanged with the bodies."""

    _thermostat: Any
    _version: int

    @abstractmethod
    def _settings(self) -> Any:
        """Return the settings of the engine."""

    @abstractmethod
    def _changed(self) -> None:
        """Take over changed settings before the next step."""

    @_available()
    def getTemperature(self) -> unit.Quantity:
        """Return the temperature of the thermostat."""
        return self._thermostat.temperature * unit.kelvin

    @_available()
    def setTemperature(self, temperature: float | unit.Quantity) -> None:
        """Set the temperature of the thermostat, in K if it has no unit.

        Set the temperature of a barostat separately.

        Raises
        ------
        ValueError
            If the temperature is negative, not finite or has an incompatible unit.
        """
        self.changeThermostat(temperature=temperature)

    @_available()
    def changeThermostat(self, **settings: Any) -> None:
        """Change settings of the thermostat, which are named as in its class, such as ``friction`` of `Langevin`.

        Raises
        ------
        ValueError
            If a setting does not exist, or its value is invalid.
        """
        if unknown := settings.keys() - self._thermostat.settings().keys():
            known = ", ".join(self._thermostat.settings())
            raise ValueError(f"the thermostat has no setting {min(unknown)}: choose from {known}")
        self._thermostat = changed(self._thermostat, **settings)
        self._changed()

    @_available()
    def temperaturesAroundThermostat(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and rotational temperatures around the last heat exchange.

        Both are means of the values before and after the exchange. With "BAOAB" and "ABOBA" the exchange is in the
        middle of a step, where the distribution of momenta is closer to canonical than at the end, to which
        `temperatures` and the velocities of the Context refer.

        Raises
        ------
        ValueError
            If no step has been performed since the bodies were last changed.
        """
        propagator = self._up_to_date()
        if (exchange := propagator.last_exchange) is None:
            raise ValueError("no heat exchange has taken place since the bodies were last changed: call step() first")
        energies = [thermal_energies(propagator, state) for state in exchange]
        return temperatures_of([0.5 * sum(pair) for pair in zip(*energies, strict=True)], freedom_of(propagator))

    @_available(lambda thermostat: thermostat.heat)
    def heat(self) -> unit.Quantity:
        """Return the energy that the thermostat has added to the bodies since the start of the run.

        The kinetic energy that a ``CMMotionRemover`` has removed is subtracted. Loading a checkpoint, or a State with
        ``integratorParameters=True``, restores the energy of the earlier part of the run.
        """
        return variables.get(self, self._thermostat.heat) * _ENERGY

    @_available(_has_energy)
    def effectiveEnergy(self) -> unit.Quantity:
        """Return the conserved quantity: the total energy at the last heat exchange minus the heat.

        With Nosé-Hoover chains, it is this energy plus that of the chains. The drift and the noise of this quantity are
        integration errors, of the order of the scheme. In contrast, `totalEnergy` is the energy at the end of the step.
        With a scheme that ends with a drift after the heat exchange, such as the default, momenta then lag behind
        positions, and `totalEnergy` fluctuates by an amount proportional to the step size. A barostat, and setting
        positions or velocities, also change the effective energy. With such a scheme, setting the step size changes it
        too.

        Raises
        ------
        ValueError
            If the engine cannot compute this energy, as with fast forces of OpenMM in a drift after the exchange.
        """
        thermostat = self._thermostat
        energy = self._up_to_date().energy_at_exchange(self._version, self._settings) * _ENERGY
        if thermostat.heat is not None:
            return energy - self.heat()
        values = {name: variables.get(self, name) for name in thermostat.own_numbers}
        return energy + thermostat.energy(values, self.degreesOfFreedom()) * _ENERGY

    @_available(_has_proposals)
    def tally(self) -> Tally:
        """Return the numbers of accepted and of all proposals since the start or the last `resetTally`."""
        return Tally(*(int(variables.get(self, name)) for name in (variables.ACCEPTED, variables.PROPOSED)))

    @_available(_has_proposals)
    def acceptanceRate(self) -> float:
        """Return the fraction of accepted proposals, which is nan before the first proposal."""
        accepted, proposed = self.tally()
        return accepted / proposed if proposed else math.nan

    @_available(_has_proposals)
    def resetTally(self) -> None:
        """Reset the counts of `tally` to zero."""
        for name in (variables.ACCEPTED, variables.PROPOSED):
            variables.put(self, name, 0.0)
