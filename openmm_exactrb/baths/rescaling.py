"""Stochastic velocity rescaling of rigid bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from openmm import unit

from openmm_exactrb import kernels
from openmm_exactrb.baths.thermostatted import ThermostattedIntegrator
from openmm_exactrb.checks import positive
from openmm_exactrb.context import account
from openmm_exactrb.context.letters import Parts
from openmm_exactrb.context.units import gas_constant_times, plain
from openmm_exactrb.device.choice import Engine
from openmm_exactrb.motion.bath import Array, Bath
from openmm_exactrb.motion.draws import Draws, Instant
from openmm_exactrb.motion.rescaling import rescaling
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme


class ExactRigidBodyRescalingIntegrator(ThermostattedIntegrator):
    """Rigid-body dynamics at constant temperature that is hardly disturbed: stochastic velocity rescaling.

    All momenta are multiplied by one number now and then, so that the kinetic energy has its canonical distribution
    (doi:10.1063/1.2408420). Diffusion and correlations stay those of the free system where friction would change them.

    Parameters
    ----------
    temperature : float or Quantity
        In K if it has no unit.
    relaxationTime : float or Quantity
        Of the kinetic energy, in ps if it has no unit.
    stepSize : float or Quantity
        Size of a whole step of the scheme, in ps if it has no unit.
    scheme, rotor, bodies, fast, inner, innerSteps
        As in `ExactRigidBodyLangevinIntegrator`.
    together : bool, optional
        Whether one number multiplies all momenta; if not, translation and rotation get one each.

    Raises
    ------
    ValueError
        If the temperature is negative, the relaxation time not positive, one of them not finite, ``together`` no truth
        value, or scheme, rotor or step size do not fit.

    Notes
    -----
    Momenta that are all zero have no direction and stay: draw some with `setVelocitiesToTemperature` first. The degrees
    of freedom are those of `degreesOfFreedom`. As this bath keeps a total momentum of zero at zero, add a
    ``CMMotionRemover`` to a System whose forces do so too: it lets the three missing ones be counted as missing.
    """

    _bath_in_steps: ClassVar[str | None] = "velocity rescaling"
    tallies: ClassVar[tuple[str, ...]] = (account.HEAT,)

    def __init__(
        self,
        temperature: float | unit.Quantity,
        relaxationTime: float | unit.Quantity,
        stepSize: float | unit.Quantity,
        scheme: str | Scheme = "S2_2",
        rotor: str | Rotor = "exact",
        together: bool = True,
        bodies: Sequence[Sequence[int]] | None = None,
        fast: str | Sequence[int] | None = "auto",
        inner: str | Scheme | None = None,
        innerSteps: int | None = None,
        engine: Engine = "auto",
    ) -> None:
        super().__init__(temperature, stepSize, scheme, rotor, bodies, fast, inner, innerSteps, engine)
        self.setRelaxationTime(relaxationTime)
        if not isinstance(together, bool):
            raise ValueError(f"together must be True or False, not {together!r}")
        self._together = together

    def getRelaxationTime(self) -> unit.Quantity:
        """Return the relaxation time of the kinetic energy."""
        return self._time * unit.picosecond

    def setRelaxationTime(self, time: float | unit.Quantity) -> None:
        """Set the relaxation time of the kinetic energy, in ps if it has no unit."""
        self._time = positive(plain(time, unit.picosecond, "a relaxation time"), "a relaxation time", "ps")

    def scalesTogether(self) -> bool:
        """Tell whether one number multiplies the momenta of translation and rotation."""
        return self._together

    def heat(self) -> unit.Quantity:
        """Return the energy that the bath gave to the bodies since the integrator was made."""
        return account.read(self, account.HEAT) * unit.kilojoule_per_mole

    def effectiveEnergy(self) -> unit.Quantity:
        """Return the total energy less the heat.

        It is as constant as the total energy of the splitting without a bath: what it drifts or swings is the error of
        the step. So take a scheme of the catalogue to watch it; those with the bath within them end their steps where
        the sum of kinetic and potential energy is not what a step keeps. A barostat or a ``CMMotionRemover`` changes it
        too.
        """
        return self.totalEnergy() - self.heat()

    def getBathSettings(self) -> Mapping[str, Any]:
        """Return the settings that decide on the bits of a run, beside those of `ExactRigidBodyIntegrator`."""
        return {**super().getBathSettings(), "relaxation time": self._time, "together": self._together}

    def _arguments(self) -> dict[str, Any]:
        return {**super()._arguments(), "relaxationTime": self._time, "together": self._together}

    def _exchange(self, parts: Parts) -> Bath:
        bodies, kT = parts.bodies, gas_constant_times(self._temperature)
        freedom, draws = self.degreesOfFreedom(), Draws(kernels.twins().noise)
        rescale = rescaling(bodies.mass, bodies.principal_moments, kT, self._time, freedom, draws, self._together)

        def exchange(P: Array, m: Array, tau: float, at: Instant) -> tuple[Array, Array]:
            P, m, heat = rescale(P, m, tau, at)
            parts.account.add(account.HEAT, heat)
            return P, m

        return exchange
