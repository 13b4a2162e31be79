"""Sampling of the canonical ensemble by momenta that are drawn at intervals."""

from __future__ import annotations

from typing import Any

import numpy as np
from openmm import unit

from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.openmm_access.units import kelvin
from openmm_exactrb.support.checks import whole


class CanonicalMomenta:
    """Sample the canonical ensemble by drawing all momenta at intervals.

    Between two draws the run is at constant energy. This is Andersen's thermostat (J. Chem. Phys. 72, 2380 (1980))
    applied to all bodies at once. Static averages are canonical up to the error of the scheme. Time correlations over
    more than an interval differ from those at constant energy.

    Parameters
    ----------
    temperature : float or Quantity
        Temperature, in K if it has no unit.
    reportInterval : int
        Number of steps between two draws.
    seed : int
        Seed of the random numbers.

    Raises
    ------
    ValueError
        If the temperature is negative or not finite, or the interval or the seed is not a whole number. The first step
        also raises this error if the integrator is not one of this package or has its own thermostat.

    Notes
    -----
    Append the object to ``Simulation.reporters``. The random numbers of a draw depend only on the seed and the number
    of the step, so that a resumed run has the same draws as an uninterrupted one.
    """

    def __init__(self, temperature: float | unit.Quantity, reportInterval: int, seed: int = 0) -> None:
        self._temperature = kelvin(temperature)
        self._interval = whole(reportInterval, "reportInterval", of="steps")
        self._seed = whole(seed, "the seed", least=0)

    def settings(self) -> str:
        """Return the settings that determine the momenta, as text."""
        return f"{self._temperature!r} K every {self._interval} steps, seed {self._seed}"

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Return the number of steps until the next draw, in OpenMM's format."""
        integrator = simulation.integrator
        if not isinstance(integrator, ExactRigidBodyIntegrator) or integrator.getThermostat() is not None:
            with_thermostat = " with a thermostat" if type(integrator) is ExactRigidBodyIntegrator else ""
            raise ValueError(
                "CanonicalMomenta needs an ExactRigidBodyIntegrator without a thermostat, but this Simulation uses "
                f"{type(integrator).__name__}{with_thermostat}: remove the CanonicalMomenta from simulation.reporters"
            )
        steps = self._interval - simulation.currentStep % self._interval
        return {"steps": steps, "periodic": None, "include": []}

    def report(self, simulation: Any, state: Any) -> None:
        """Draw all momenta.

        Parameters
        ----------
        simulation : openmm.app.Simulation
        state : openmm.State
        """
        seed = np.random.SeedSequence([self._seed, simulation.currentStep]).generate_state(1)[0]
        simulation.integrator.setVelocitiesToTemperature(self._temperature, int(seed))
