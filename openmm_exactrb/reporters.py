"""Reporters for openmm.app.Simulation."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike
from openmm import unit

from openmm_exactrb.checks import whole
from openmm_exactrb.integrator import ExactRigidBodyIntegrator

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
        self._interval = whole(reportInterval, "reportInterval", of="steps")
        if not isinstance(file, (str, os.PathLike)) and not hasattr(file, "write"):
            raise ValueError(f"file must be a path or an open text file, not {file!r}")
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
        """Tell OpenMM when the next line is due and what it needs.

        Raises
        ------
        ValueError
            If the Simulation has another integrator than an `ExactRigidBodyIntegrator`.
        """
        if not isinstance(simulation.integrator, ExactRigidBodyIntegrator):
            raise ValueError(
                f"EnergyReporter writes the energies of an ExactRigidBodyIntegrator, and this Simulation has a "
                f"{type(simulation.integrator).__name__}: use openmm.app.StateDataReporter"
            )
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


def _open(file: str | os.PathLike[str], append: bool) -> TextIO:
    return Path(file).open("a" if append else "w")
