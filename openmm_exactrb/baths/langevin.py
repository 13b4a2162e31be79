"""Langevin dynamics of rigid bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from openmm import unit

from openmm_exactrb import kernels
from openmm_exactrb.baths.thermostatted import ThermostattedIntegrator
from openmm_exactrb.context.letters import Parts
from openmm_exactrb.context.units import gas_constant_times, not_negative
from openmm_exactrb.device import names
from openmm_exactrb.device.choice import LANGEVIN, Engine
from openmm_exactrb.motion.bath import Bath, langevin
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme

_RATE = unit.picosecond**-1


class ExactRigidBodyLangevinIntegrator(ThermostattedIntegrator):
    """Rigid-body Langevin dynamics: a splitting with an exact Ornstein-Uhlenbeck flow.

    Linear and angular momenta are damped and get noise, the angular ones in the principal axes of the body. Free
    particles and linear molecules take part with the degrees of freedom that they have. Everything else is as in
    `ExactRigidBodyIntegrator`. A scheme of the catalogue stands between two halves of that flow: without friction it
    gives the trajectory of that integrator, bit for bit.

    Parameters
    ----------
    temperature : float or Quantity
        In K if it has no unit.
    frictionCoeff : float or Quantity
        Friction of translation, in 1/ps if it has no unit.
    stepSize : float or Quantity
        Size of a whole step of the scheme, in ps if it has no unit.
    scheme : str or Scheme, optional
        A key of `openmm_exactrb.SCHEMES` without a processor or of `openmm_exactrb.schemes.WITH_BATH`, which have the
        bath within them, or a scheme of your own. The default takes three forces per step: up to 6 fs per force
        translation and rotation of rigid water were within a kelvin of each other (SPC/E, TIP4P/2005; friction 5/ps).
        "W2_4g" takes four, up to 4 fs per force, and has the potential energy right too. "BAOA", the splitting of
        LangevinMiddleIntegrator, "BAOAB" and "ABOBA" take one; with a friction of 30/ps BAOA had temperatures and
        potential energy of both right at 6 fs per force.
    rotor : str or Rotor, optional
        A key of `openmm_exactrb.ROTORS`, or a `Rotor` of your own.
    rotationalFriction : float or Quantity, optional
        Friction of rotation; that of translation unless given.
    bodies, fast, inner, innerSteps : optional
        As in `ExactRigidBodyIntegrator`.
    engine : {"auto", "host", "device"}, optional
        As in `ExactRigidBodyIntegrator`. The device draws other random numbers from the same seed; there too the noise
        of a step depends on the seed and the number of the step alone. It has no `temperaturesAroundBath`.

    Raises
    ------
    ValueError
        If temperature or a friction is negative or not finite, or scheme, rotor or step size do not fit.

    Notes
    -----
    `step` raises ValueError if the System has a thermostat too, or a barostat of another temperature.

    The noise is that of the seed and the number of the step: a second trajectory needs another seed.
    """

    _bath_in_steps: ClassVar[str | None] = LANGEVIN

    def __init__(
        self,
        temperature: float | unit.Quantity,
        frictionCoeff: float | unit.Quantity,
        stepSize: float | unit.Quantity,
        scheme: str | Scheme = "W2_3m",
        rotor: str | Rotor = "exact",
        rotationalFriction: float | unit.Quantity | None = None,
        bodies: Sequence[Sequence[int]] | None = None,
        fast: str | Sequence[int] | None = "auto",
        inner: str | Scheme | None = None,
        innerSteps: int | None = None,
        engine: Engine = "auto",
    ) -> None:
        super().__init__(temperature, stepSize, scheme, rotor, bodies, fast, inner, innerSteps, engine)
        self.setFriction(frictionCoeff)
        self.setRotationalFriction(rotationalFriction)

    def getFriction(self) -> unit.Quantity:
        """Return the friction of translation."""
        return self._friction * _RATE

    def setFriction(self, coeff: float | unit.Quantity) -> None:
        """Set the friction of translation, and of rotation where that has none of its own, in 1/ps without a unit."""
        self._friction = not_negative(coeff, _RATE, "a friction")

    def getRotationalFriction(self) -> unit.Quantity:
        """Return the friction of rotation."""
        return (self._friction if self._rotational is None else self._rotational) * _RATE

    def setRotationalFriction(self, coeff: float | unit.Quantity | None) -> None:
        """Set the friction of rotation, in 1/ps if it has no unit; None for that of translation."""
        self._rotational = None if coeff is None else not_negative(coeff, _RATE, "a friction")

    def getBathSettings(self) -> Mapping[str, Any]:
        """Return the settings that decide on the bits of a run, beside those of `ExactRigidBodyIntegrator`."""
        frictions = {"friction": self._friction, "rotational friction": self.getRotationalFriction()._value}
        return {**super().getBathSettings(), **frictions}

    def _arguments(self) -> dict[str, Any]:
        return {
            **super()._arguments(),
            "frictionCoeff": self._friction,
            "rotationalFriction": self._rotational,
        }

    def _numbers(self) -> Mapping[str, float]:
        kT = gas_constant_times(self._temperature)
        frictions = {names.FRICTION: self._friction, names.TURNING_FRICTION: self.getRotationalFriction()._value}
        return {names.KT: kT, **frictions} if self._engine.on_device else {}

    def _exchange(self, parts: Parts) -> Bath:
        bodies, kT = parts.bodies, gas_constant_times(self._temperature)
        frictions = self._friction, self.getRotationalFriction()._value
        return langevin(bodies.mass, bodies.principal_moments, kT, *frictions, kernels.twins().bath.relax)
