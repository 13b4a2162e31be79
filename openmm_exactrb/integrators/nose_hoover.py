"""Nosé-Hoover chains of rigid bodies."""

from __future__ import annotations

from typing import Unpack

from openmm import unit

from openmm_exactrb.integrators.thermostatted import Options, ThermostattedIntegrator
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.thermostats.nose_hoover import NoseHooverChain


class ExactRigidBodyNoseHooverIntegrator(ThermostattedIntegrator):
    """Rigid-body dynamics at constant temperature without random numbers: Nosé-Hoover chains.

    Parameters
    ----------
    temperature, collisionFrequency, chainLength, numMTS, numYoshidaSuzuki, together
        As in `NoseHooverChain`; ``chainLength``, ``numMTS`` and ``numYoshidaSuzuki`` have the same meaning as in
        OpenMM's NoseHooverIntegrator.
    stepSize, scheme, rotor, bodies, fast, inner, innerSteps, forceInterval, checkDivergence, constraints
        As in `ExactRigidBodyLangevinIntegrator`.

    Notes
    -----
    The default scheme is "BAOAB", whose steps are symmetric in time and evaluate forces once. Velocities at the end of
    a step differ by half a kick from the velocities that the chains scale. The results of `temperatures` are therefore
    below the temperature of the chains by an amount proportional to the square of the step.
    `temperaturesAroundThermostat` returns the temperatures of the chains.

    Momenta that are all zero stay zero: draw initial momenta with `setVelocitiesToTemperature`. Checkpoints, and States
    with ``integratorParameters=True``, can be loaded only with the same number and length of chains. Small or stiff
    systems may not be ergodic; a harmonic oscillator with a chain of one link, for example, is not.
    """

    _thermostat: NoseHooverChain

    def __init__(
        self,
        temperature: float | unit.Quantity,
        collisionFrequency: float | unit.Quantity,
        stepSize: float | unit.Quantity | None = None,
        scheme: str | Scheme | None = None,
        rotor: str | Rotor = "exact",
        chainLength: int = 3,
        numMTS: int = 3,
        numYoshidaSuzuki: int = 7,
        together: bool = False,
        **options: Unpack[Options],
    ) -> None:
        thermostat = NoseHooverChain(temperature, collisionFrequency, chainLength, numMTS, numYoshidaSuzuki, together)
        super().__init__(stepSize, scheme, rotor, thermostat=thermostat, **options)
