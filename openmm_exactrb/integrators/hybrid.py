"""Generalised hybrid Monte Carlo of rigid bodies."""

from __future__ import annotations

from typing import Unpack

from openmm import unit

from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.integrators.thermostatted import Options
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.thermostats.hybrid import HybridMonteCarlo


class ExactRigidBodyHybridIntegrator(ExactRigidBodyLangevinIntegrator):
    """Generalised hybrid Monte Carlo: averages without a step-size error.

    A step is a proposal between two halves of the heat exchange of `ExactRigidBodyLangevinIntegrator`
    (doi:10.1016/0370-2693(91)90812-5). The splitting generates the proposal, a Metropolis test accepts or rejects the
    proposal, and momenta are reversed on rejection, so that the trajectory has no dynamical meaning. The distribution
    is canonical at any step size, up to the errors of the platform's potential energy.

    Parameters
    ----------
    temperature, frictionCoeff
        As in `ExactRigidBodyLangevinIntegrator`; the temperature must be positive.
    stepSize : float or Quantity, optional
        Duration of a proposal, in ps if it has no unit. Pass either ``stepSize`` or ``forceInterval``.
    scheme, rotor, rotationalFriction, flexibleFriction, bodies, fast, inner, innerSteps, forceInterval
        As in `ExactRigidBodyLangevinIntegrator`; the scheme must be symmetric and contain no thermostat, as is the case
        for the default, "S2_2". ``innerSteps`` is the number of inner steps in one step of the scheme.
    checkDivergence, constraints
        As in `ExactRigidBodyLangevinIntegrator`.
    stepsPerProposal : int, optional
        Number of steps of the scheme in a proposal, each of the size stepSize/stepsPerProposal.

    Raises
    ------
    ValueError
        As for `ExactRigidBodyLangevinIntegrator`, and if the temperature is zero, the scheme or the inner scheme is not
        symmetric, or ``stepsPerProposal`` is not a positive whole number.
    """

    _thermostat: HybridMonteCarlo

    def __init__(
        self,
        temperature: float | unit.Quantity,
        frictionCoeff: float | unit.Quantity,
        stepSize: float | unit.Quantity | None = None,
        scheme: str | Scheme | None = None,
        rotor: str | Rotor = "exact",
        rotationalFriction: float | unit.Quantity | None = None,
        stepsPerProposal: int = 1,
        flexibleFriction: float | unit.Quantity | None = None,
        **options: Unpack[Options],
    ) -> None:
        frictions = frictionCoeff, rotationalFriction
        thermostat = HybridMonteCarlo(temperature, *frictions, stepsPerProposal, flexibleFriction=flexibleFriction)
        super(ExactRigidBodyLangevinIntegrator, self).__init__(
            stepSize, scheme, rotor, thermostat=thermostat, **options
        )
