"""Langevin dynamics: friction and noise by the exact Ornstein-Uhlenbeck flow of momenta.

Momenta are P (2, 3, N) in space and m (2, 3, K) in the body frame, sums high + low of `openmm_exactrb.compensated`, or
(1, 3, N) and (1, 3, K) without the low part. The first K of N bodies rotate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Unpack

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.checks import not_negative
from openmm_exactrb.compensated import add
from openmm_exactrb.context.units import gas_constant_times, kelvin
from openmm_exactrb.context.units import not_negative as not_negative_quantity
from openmm_exactrb.device import names
from openmm_exactrb.mechanics.free_motion import advancing
from openmm_exactrb.mechanics.rng import Instant, Purpose
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.thermostat import Exchange, Thermostat
from openmm_exactrb.thermostats.face import Options, ThermostattedIntegrator

Array = NDArray[np.float64]
_RATE = unit.picosecond**-1


@dataclass(frozen=True)
class Langevin(Thermostat):
    """Friction and noise on linear and angular momenta.

    Parameters
    ----------
    temperature : float or Quantity
        In K if it has no unit.
    friction : float or Quantity
        Of translation, in 1/ps if it has no unit.
    rotationalFriction : float or Quantity, optional
        Of rotation, in 1/ps if it has no unit; by default that of translation.
    """

    temperature: float
    friction: float
    rotationalFriction: float | None = None

    on_device: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "temperature", kelvin(self.temperature))
        object.__setattr__(self, "friction", _rate(self.friction))
        if self.rotationalFriction is not None:
            object.__setattr__(self, "rotationalFriction", _rate(self.rotationalFriction))

    @property
    def frictions(self) -> tuple[float, float]:
        """The frictions of translation and of rotation in 1/ps."""
        return self.friction, self.friction if self.rotationalFriction is None else self.rotationalFriction

    @property
    def relaxation(self) -> float | None:
        """The time in ps of the smaller friction that is not 0."""
        rates = [rate for rate in self.frictions if rate > 0.0]
        return 1.0 / min(rates) if rates else None

    def bind(self, environment: Any) -> Exchange:
        """Return the Ornstein-Uhlenbeck flow."""
        bodies, kT = environment.bodies, gas_constant_times(self.temperature)
        return ornstein_uhlenbeck(bodies.mass, bodies.principal_moments, kT, *self.frictions)

    def device_numbers(self) -> Mapping[str, float]:
        """Return the numbers that a program on a device needs."""
        numbers = gas_constant_times(self.temperature), *self.frictions
        return dict(zip((names.KT, names.FRICTION, names.TURNING_FRICTION), numbers, strict=True))


def _rate(friction: Any) -> float:
    return not_negative_quantity(friction, _RATE, "a friction")


def ornstein_uhlenbeck(mass: Array, moments: Array, kT: float, friction: float, rotational_friction: float) -> Exchange:
    """Prepare the exact flow of dP = -g P dt + sqrt(2 g M kT) dW, and the same of m with I and a friction of its own.

    It is P <- a P + sqrt((1 - a²) kT M) xi with a = exp(-g tau). Two flows one after the other are one of both times,
    and the Maxwell-Boltzmann distribution is invariant. For splittings with it see B. Leimkuhler and C. Matthews
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
        In the unit of 1/time. Where it is 0 the momenta are returned as they came; else time must not run back.
    """
    kT = not_negative(kT, "kT")
    g_P, g_m = not_negative(friction, "friction"), not_negative(rotational_friction, "rotational friction")
    width_P, width_m = np.sqrt(kT * np.tile(mass, (3, 1))), np.sqrt(kT * moments)
    advance = advancing()

    def relaxed(x: Array, width: Array, elapsed: float, at: Instant, part: Purpose) -> Array:
        """Return momenta after a time in units of 1/friction."""
        if elapsed == 0.0:
            return x
        if elapsed < 0.0:
            raise ValueError("stepSize must be positive when friction is non-zero")
        # As a change of x, for then rounding fades together with the friction.
        fade, spread = math.expm1(-elapsed), math.sqrt(-math.expm1(-2.0 * elapsed))
        change = fade * x[0] + (spread * width) * at.normals(part, width.shape)
        return advance(x, change, 1.0) if len(x) == 2 else add(x, change)

    def exchange(P: Array, m: Array, tau: float, at: Instant) -> tuple[Array, Array]:
        return (
            relaxed(P, width_P, g_P * tau, at, Purpose.TRANSLATION),
            relaxed(m, width_m, g_m * tau, at, Purpose.ROTATION),
        )

    return exchange


class ExactRigidBodyLangevinIntegrator(ThermostattedIntegrator):
    """Rigid-body Langevin dynamics: a splitting with an exact Ornstein-Uhlenbeck flow.

    Friction and noise act on linear momenta and on angular momenta in the principal axes of each body, for as many
    degrees of freedom as a particle or a linear molecule has. Everything else is as in `ExactRigidBodyIntegrator`. A
    scheme of the catalogue is enclosed by two halves of the Ornstein-Uhlenbeck flow: without friction it gives the
    trajectory of `ExactRigidBodyIntegrator`, bit for bit.

    Parameters
    ----------
    temperature : float or Quantity
        In K if it has no unit.
    frictionCoeff : float or Quantity
        Friction of translation, in 1/ps if it has no unit.
    stepSize : float or Quantity, optional
        Size of a whole step of the scheme, in ps if it has no unit. Pass either it or ``forceInterval``.
    scheme : str or Scheme, optional
        A key of `openmm_exactrb.SCHEMES` without a processor, or of `openmm_exactrb.schemes.WITH_THERMOSTAT`, whose
        schemes contain the thermostat, or a scheme of your own. The default, "BAOA", is the splitting of
        LangevinMiddleIntegrator and evaluates the forces once per step. "W2_3m" evaluates them three times per step;
        with it, the temperatures of translation and rotation of rigid water are within 1 K of each other up to 6 fs per
        force evaluation (SPC/E, TIP4P/2005; friction 5/ps). Both end a step with a drift after the heat exchange.
        Bodies with inner steps, whose momenta such a drift would change, end it at the heat exchange.
    rotor : str or Rotor, optional
        A key of `openmm_exactrb.ROTORS`, or a `Rotor` of your own.
    rotationalFriction : float or Quantity, optional
        Friction of rotation, in 1/ps if it has no unit; by default that of translation.
    bodies, fast, inner, innerSteps, forceInterval, checkDivergence : optional
        As in `ExactRigidBodyIntegrator`.
    engine : {"auto", "host", "device"}, optional
        As in `ExactRigidBodyIntegrator`. With the same seed, the device draws other random numbers than the host; there
        too the noise of a step depends only on the seed and the number of the step. `temperaturesAroundThermostat` is
        not available on the device.

    Raises
    ------
    ValueError
        If the temperature or a friction is negative or not finite, or the scheme, the rotor or the step size is
        invalid.

    Notes
    -----
    `step` raises a ValueError if the System also has a thermostat, or a barostat of another temperature.

    The noise depends only on the seed and the number of the step: a second trajectory needs another seed.
    """

    _thermostat: Langevin

    def __init__(
        self,
        temperature: float | unit.Quantity,
        frictionCoeff: float | unit.Quantity,
        stepSize: float | unit.Quantity | None = None,
        scheme: str | Scheme | None = None,
        rotor: str | Rotor = "exact",
        rotationalFriction: float | unit.Quantity | None = None,
        **options: Unpack[Options],
    ) -> None:
        thermostat = Langevin(temperature, frictionCoeff, rotationalFriction)
        super().__init__(thermostat, stepSize, scheme, rotor, **options)

    def getFriction(self) -> unit.Quantity:
        """Return the friction of translation."""
        return self._thermostat.frictions[0] * _RATE

    def setFriction(self, coeff: float | unit.Quantity) -> None:
        """Set the friction of translation, and of rotation unless set separately, in 1/ps if it has no unit."""
        self._change(friction=coeff)

    def getRotationalFriction(self) -> unit.Quantity:
        """Return the friction of rotation."""
        return self._thermostat.frictions[1] * _RATE

    def setRotationalFriction(self, coeff: float | unit.Quantity | None) -> None:
        """Set the friction of rotation, in 1/ps if it has no unit; None means that of translation."""
        self._change(rotationalFriction=coeff)

    def _arguments(self) -> dict[str, Any]:
        arguments = super()._arguments()
        return arguments | {"frictionCoeff": arguments.pop("friction")}
