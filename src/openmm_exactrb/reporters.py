"""Reporters for openmm.app.Simulation."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, TextIO

from openmm import unit

_COLUMNS = ("step", "time (ps)", "translational", "rotational", "kinetic", "potential", "total (kJ/mol)")


class EnergyReporter:
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
        if reportInterval < 1:
            raise ValueError(f"reportInterval must be at least one step, not {reportInterval}")
        self._interval = reportInterval
        self._owned = isinstance(file, (str, os.PathLike))
        self._out: TextIO = _open(file, append) if isinstance(file, (str, os.PathLike)) else file
        if not append or (self._owned and self._out.tell() == 0):
            self._out.write(",".join(_COLUMNS) + "\n")

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Tell OpenMM when the next line is due and what it needs."""
        steps = self._interval - simulation.currentStep % self._interval
        return {"steps": steps, "periodic": None, "include": ["energy"]}

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
        time = state.getTime().value_in_unit(unit.picosecond)
        values = (time, translational, rotational, kinetic, potential, kinetic + potential)
        self._out.write(",".join([str(simulation.currentStep), *(repr(float(v)) for v in values)]) + "\n")
        self._out.flush()

    def close(self) -> None:
        """Close the file, if the reporter opened it."""
        if self._owned:
            self._out.close()


def _open(file: str | os.PathLike[str], append: bool) -> TextIO:
    return Path(file).open("a") if append else Path(file).open("w")
