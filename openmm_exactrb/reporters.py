"""Reporters for openmm.app.Simulation."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike
from openmm import unit

_COLUMNS = ("step", "time (ps)", "translational", "rotational", "kinetic", "potential", "total (kJ/mol)")


class _Lines:
    """Lines of CSV at intervals, each written through at once."""

    def __init__(
        self,
        file: str | os.PathLike[str] | TextIO,
        reportInterval: int,
        columns: Sequence[str],
        append: bool,
    ) -> None:
        if reportInterval < 1:
            raise ValueError(f"reportInterval must be at least one step, not {reportInterval}")
        self._interval = reportInterval
        self._owned = isinstance(file, (str, os.PathLike))
        self._out: TextIO = _open(file, append) if isinstance(file, (str, os.PathLike)) else file
        if not append or (self._owned and self._out.tell() == 0):
            self._out.write(",".join(columns) + "\n")

    def _steps_left(self, simulation: Any) -> int:
        return int(self._interval - simulation.currentStep % self._interval)

    def _write(self, simulation: Any, state: Any, values: Iterable[float]) -> None:
        time = state.getTime().value_in_unit(unit.picosecond)
        self._out.write(",".join([str(simulation.currentStep), *(repr(float(v)) for v in (time, *values))]) + "\n")
        self._out.flush()

    def close(self) -> None:
        """Close the file, if the reporter opened it."""
        if self._owned:
            self._out.close()


class EnergyReporter(_Lines):
    """Write the energies of rigid bodies as CSV, every digit of float64.

    Parameters
    ----------
    file : str, path or open text file
    reportInterval : int
        Steps between two lines.
    append : bool, optional
        Write behind the lines that the file has; the names of the columns only where it has none.

    Notes
    -----
    The simulation must use an `openmm_exactrb.ExactRigidBodyIntegrator`. Each line is written through at once, so that
    a run that ends badly leaves all lines before.
    """

    def __init__(self, file: str | os.PathLike[str] | TextIO, reportInterval: int, append: bool = False) -> None:
        super().__init__(file, reportInterval, _COLUMNS, append)

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Tell OpenMM when the next line is due and what it needs."""
        return {"steps": self._steps_left(simulation), "periodic": None, "include": ["energy"]}

    def report(self, simulation: Any, state: Any) -> None:
        """Write a line.

        Parameters
        ----------
        simulation : openmm.app.Simulation
        state : openmm.State
            With energies.
        """
        translational, rotational = (e._value for e in simulation.integrator.kineticEnergies())
        kinetic = translational + rotational
        potential = state.getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
        self._write(simulation, state, (translational, rotational, kinetic, potential, kinetic + potential))


class MomentReporter(_Lines):
    """Write the total dipole moment as CSV, every digit of float64.

    The moment is the sum of charge times position over all particles, with molecules whole. For soft dipoles the
    charge is strength/length at the tip of an arrow and its negative at the centre, as in the example
    `dielectric_constant.py`.

    Parameters
    ----------
    file : str, path or open text file
    reportInterval : int
        Steps between two lines.
    charges : (n_particles,) array_like
        They must add up to zero in every molecule.
    append : bool, optional
        As for `EnergyReporter`.
    """

    def __init__(
        self, file: str | os.PathLike[str] | TextIO, reportInterval: int, charges: ArrayLike, append: bool = False
    ) -> None:
        super().__init__(file, reportInterval, ("step", "time (ps)", "Mx", "My", "Mz"), append)
        self._charges = np.asarray(charges, dtype=np.float64)

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Tell OpenMM when the next line is due and what it needs."""
        return {"steps": self._steps_left(simulation), "periodic": False, "include": ["positions"]}

    def report(self, simulation: Any, state: Any) -> None:
        """Write a line.

        Parameters
        ----------
        simulation : openmm.app.Simulation
        state : openmm.State
            With positions.
        """
        moment = self._charges @ state.getPositions(asNumpy=True).value_in_unit(unit.nanometer)
        self._write(simulation, state, moment)


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
        if reportInterval < 1:
            raise ValueError(f"reportInterval must be at least one step, not {reportInterval}")
        self._temperature, self._interval, self._seed = temperature, reportInterval, seed

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


def _open(file: str | os.PathLike[str], append: bool) -> TextIO:
    return Path(file).open("a" if append else "w")
