"""Momenta drawn anew at intervals."""

from __future__ import annotations

from typing import Any

import numpy as np
from openmm import unit

from openmm_exactrb.checks import whole


class CanonicalMomenta:
    """Draw all momenta anew at intervals: a run that samples the canonical ensemble.

    Between two draws the run is at constant energy. It is Andersen's thermostat that strikes all bodies at once
    (J. Chem. Phys. 72, 2380 (1980)): static averages are canonical up to the error of the scheme, time correlations
    longer than an interval are not those of the free system.

    Parameters
    ----------
    temperature : float or Quantity
        In K if it has no unit.
    reportInterval : int
        Steps between two draws.
    seed : int

    Notes
    -----
    It is appended to ``Simulation.reporters``. The momenta after a draw depend on the seed and the number of the step
    only, so that a run that is resumed ends as one without a break.
    """

    def __init__(self, temperature: float | unit.Quantity, reportInterval: int, seed: int = 0) -> None:
        self._temperature, self._seed = temperature, seed
        self._interval = whole(reportInterval, "reportInterval", of="steps")

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Tell OpenMM when momenta are due."""
        steps = self._interval - simulation.currentStep % self._interval
        return {"steps": steps, "periodic": None, "include": []}

    def report(self, simulation: Any, state: Any) -> None:
        """Draw momenta.

        Parameters
        ----------
        simulation : openmm.app.Simulation
        state : openmm.State
        """
        seed = np.random.SeedSequence([self._seed, simulation.currentStep]).generate_state(1)[0]
        simulation.integrator.setVelocitiesToTemperature(self._temperature, int(seed))
