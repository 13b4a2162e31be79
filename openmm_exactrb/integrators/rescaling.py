"""Stochastic velocity rescaling of rigid bodies."""

from __future__ import annotations

from typing import Unpack

from openmm import unit

from openmm_exactrb.integrators.thermostatted import Options, ThermostattedIntegrator
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.thermostats.rescaling import StochasticRescaling


class ExactRigidBodyRescalingIntegrator(ThermostattedIntegrator):
    """Rigid-body dynamics at constant temperature with little disturbance: stochastic velocity rescaling.

    At every step, all momenta are multiplied by one number, or by two with ``together=False``, such that kinetic
    energies have their canonical distribution (doi:10.1063/1.2408420). Unlike friction, this thermostat has little
    effect on diffusion and time correlations.

    Parameters
    ----------
    temperature, relaxationTime, together
        As in `StochasticRescaling`.
    stepSize, scheme, rotor, bodies, fast, inner, innerSteps, forceInterval, checkDivergence, constraints
        As in `ExactRigidBodyLangevinIntegrator`.

    Notes
    -----
    If all momenta are zero, rescaling leaves them zero: draw initial momenta with `setVelocitiesToTemperature`.
    Rescaling also preserves a total momentum of zero. If the forces of the System preserve the total momentum too, add
    a ``CMMotionRemover``, so that `degreesOfFreedom` excludes the three degrees of freedom of the centre of mass.
    """

    _thermostat: StochasticRescaling

    def __init__(
        self,
        temperature: float | unit.Quantity,
        relaxationTime: float | unit.Quantity,
        stepSize: float | unit.Quantity | None = None,
        scheme: str | Scheme | None = None,
        rotor: str | Rotor = "exact",
        together: bool = True,
        **options: Unpack[Options],
    ) -> None:
        thermostat = StochasticRescaling(temperature, relaxationTime, together)
        super().__init__(stepSize, scheme, rotor, thermostat=thermostat, **options)
