"""Langevin dynamics of rigid bodies."""

from __future__ import annotations

from typing import Any, Unpack

from openmm import unit

from openmm_exactrb.integrators.thermostatted import Options, ThermostattedIntegrator
from openmm_exactrb.openmm_access.units import RATE
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.thermostats.langevin import Langevin


class ExactRigidBodyLangevinIntegrator(ThermostattedIntegrator):
    """Rigid-body Langevin dynamics: a splitting with an exact Ornstein-Uhlenbeck flow.

    Friction and noise act on linear momenta and on angular momenta in the principal axes of each body. Linear molecules
    have two rotational degrees of freedom, and particles none. All other arguments and methods are those of
    `ExactRigidBodyIntegrator`. A scheme without a thermostat is applied between two halves of the Ornstein-Uhlenbeck
    flow. Without friction, the trajectory with such a scheme is bit-identical to that of `ExactRigidBodyIntegrator`.

    Parameters
    ----------
    temperature : float or Quantity
        Temperature, in K if it has no unit.
    frictionCoeff : float or Quantity
        Friction of translation, in 1/ps if it has no unit.
    stepSize : float or Quantity, optional
        Step size of the scheme, in ps if given without a unit. Pass either ``stepSize`` or ``forceInterval``.
    scheme : str or Scheme, optional
        A key of `openmm_exactrb.SCHEMES` for a scheme without a processor, a key of
        `openmm_exactrb.schemes.WITH_THERMOSTAT`, whose schemes contain the thermostat, or a scheme of your own. The
        default, "BAOA", is the splitting of LangevinMiddleIntegrator and evaluates the forces once per step. "W2_3m"
        evaluates them three times per step. With this scheme, the temperatures of translation and rotation of rigid
        water are within 1 K of each other up to 6 fs per force evaluation (SPC/E, TIP4P/2005; friction 5/ps). With
        either scheme, a step ends with a drift after the heat exchange. Since this drift would change the momenta of
        bodies with inner steps, these bodies end the step at the heat exchange.
    rotor : str or Rotor, optional
        A key of `openmm_exactrb.ROTORS`, or a `Rotor` of your own.
    rotationalFriction : float or Quantity, optional
        Friction of rotation, in 1/ps if it has no unit; by default the friction of translation.
    flexibleFriction : float or Quantity, optional
        Friction of molecules that consist of more than one body, such as a protein or a flexible molecule, in 1/ps if
        it has no unit; by default the frictions of all other bodies. This friction controls the temperature of a
        protein at long steps without affecting the friction of water. Molecules are those of ``Context.getMolecules``,
        and a body of ``bodies`` joins its molecules.
    bodies, fast, inner, innerSteps, forceInterval, checkDivergence, constraints : optional
        As in `ExactRigidBodyIntegrator`.
    engine : {"auto", "host", "native"}, optional
        As in `ExactRigidBodyIntegrator`.

    Raises
    ------
    ValueError
        If the temperature or a friction is negative or not finite, or the scheme, the rotor or the step size is
        invalid.

    Notes
    -----
    `step` raises a ValueError if the System also has a thermostat, or a barostat at another temperature, unless the
    frequency of this thermostat or barostat is 0, so that it never acts.

    Runs with the same seed have the same noise: use different seeds for independent trajectories.
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
        flexibleFriction: float | unit.Quantity | None = None,
        **options: Unpack[Options],
    ) -> None:
        thermostat = Langevin(temperature, frictionCoeff, rotationalFriction, flexibleFriction=flexibleFriction)
        super().__init__(stepSize, scheme, rotor, thermostat=thermostat, **options)

    def getFriction(self) -> unit.Quantity:
        """Return the friction of translation."""
        return self._thermostat.frictions[0] * RATE

    def setFriction(self, coeff: float | unit.Quantity) -> None:
        """Set the friction of translation (and of rotation, unless set separately), in 1/ps if it has no unit."""
        self.changeThermostat(friction=coeff)

    def getRotationalFriction(self) -> unit.Quantity:
        """Return the friction of rotation."""
        return self._thermostat.frictions[1] * RATE

    def setRotationalFriction(self, coeff: float | unit.Quantity | None) -> None:
        """Set the friction of rotation, in 1/ps if it has no unit; None means the friction of translation."""
        self.changeThermostat(rotationalFriction=coeff)

    def getFlexibleFriction(self) -> unit.Quantity:
        """Return the translational friction of molecules of more than one body."""
        return self._thermostat.flexible_frictions[0] * RATE

    def setFlexibleFriction(self, coeff: float | unit.Quantity | None) -> None:
        """Set the friction of molecules of more than one body, in 1/ps if it has no unit; None restores the default."""
        self.changeThermostat(flexibleFriction=coeff)

    def _arguments(self) -> dict[str, Any]:
        arguments = super()._arguments()
        return arguments | {"frictionCoeff": arguments.pop("friction")}
