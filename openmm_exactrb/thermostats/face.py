"""The common base classes of the integrators with a thermostat."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypedDict

from openmm import unit

from openmm_exactrb.context import variables
from openmm_exactrb.context.body_access import freedom_of, temperatures_of, thermal_energies
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.free_motion import Constrain
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.support.descriptions import changed


class Options(TypedDict, total=False):
    """Keyword arguments of all integrators; see `ExactRigidBodyIntegrator`."""

    bodies: Sequence[Sequence[int]] | None
    fast: str | Sequence[int] | None
    inner: str | Scheme | None
    innerSteps: int | None
    engine: str
    forceInterval: float | unit.Quantity | None
    checkDivergence: bool
    constraints: Sequence[Constrain]


class ThermostattedIntegrator(ExactRigidBodyIntegrator):
    """An `ExactRigidBodyIntegrator` with a thermostat of this package.

    Checkpoints, and States with ``integratorParameters=True``, contain the seed and sums over steps, such as the heat.
    Temperature and friction are settings that must be set again in a new process.
    """

    _thermostat: Any

    def getTemperature(self) -> unit.Quantity:
        """Return the temperature of the thermostat."""
        return self._thermostat.temperature * unit.kelvin

    def setTemperature(self, temperature: float | unit.Quantity) -> None:
        """Set the temperature of the thermostat, in K if it has no unit.

        Set the temperature of a barostat separately.

        Raises
        ------
        ValueError
            If the temperature is negative, not finite or has an incompatible unit.
        """
        self._change(temperature=temperature)

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

    def _energyAtExchange(self) -> unit.Quantity:
        """Return the total energy at the last heat exchange, where its errors are of the order of the scheme."""
        return self._up_to_date().energy_at_exchange(self._version, self._settings) * unit.kilojoule_per_mole

    def _change(self, **settings: Any) -> None:
        """Change settings of the thermostat."""
        self._thermostat = changed(self._thermostat, **settings)
        self._changed()

    def _arguments(self) -> dict[str, Any]:
        arguments = super()._arguments()
        del arguments["thermostat"]
        return {**arguments, **self._thermostat.settings()}


class HeatedIntegrator(ThermostattedIntegrator):
    """An integrator that sums the heat that its thermostat exchanges with the bodies."""

    def heat(self) -> unit.Quantity:
        """Return the energy that the thermostat has added to the bodies since the start of the run.

        The kinetic energy that a ``CMMotionRemover`` has removed is subtracted. Loading a checkpoint, or a State with
        ``integratorParameters=True``, restores the energy of the earlier part of the run.
        """
        return variables.get(self, self._thermostat.heat) * unit.kilojoule_per_mole

    def effectiveEnergy(self) -> unit.Quantity:
        """Return the total energy at the last heat exchange minus the heat, a conserved quantity.

        The drift and the noise of this quantity are integration errors, of the order of the scheme. In contrast,
        `totalEnergy` is the energy at the end of the step. With a scheme that ends with a drift after the heat
        exchange, such as the default, momenta then lag behind positions, and `totalEnergy` fluctuates by an amount
        proportional to the step size. A barostat, and setting positions or velocities, also change the effective
        energy. With such a scheme, setting the step size changes it too.

        Raises
        ------
        ValueError
            If the native engine lets OpenMM evaluate fast forces in a drift after the last heat exchange.
        """
        return self._energyAtExchange() - self.heat()
