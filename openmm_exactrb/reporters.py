"""Reporters for openmm.app.Simulation."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray
from openmm import unit

from openmm_exactrb.detection.whole import molecular_links
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.images import joined
from openmm_exactrb.mechanics.links import Links
from openmm_exactrb.openmm_access.molecules import molecule_of
from openmm_exactrb.openmm_access.units import stripped
from openmm_exactrb.support import checks
from openmm_exactrb.support.messages import shown
from openmm_exactrb.support.types import Array

# Largest net charge (e) of a molecule that counts as neutral, because force fields round charges.
_NEUTRAL = 1e-3
_COLUMNS = ("translational (kJ/mol)", "rotational (kJ/mol)", "translational (K)", "rotational (K)")
_SUMS = ("kinetic (kJ/mol)", "potential (kJ/mol)", "total (kJ/mol)")
# Significant digits of a time in ps; more digits would show the roundoff of summed steps.
_DIGITS = 12


class _Lines:
    """A reporter that writes a line of CSV every `reportInterval` steps, and flushes it immediately."""

    def __init__(
        self, file: str | os.PathLike[str] | TextIO, reportInterval: int, columns: Sequence[str], append: bool
    ) -> None:
        self._interval = checks.whole(reportInterval, "reportInterval", of="steps")
        self._owned = isinstance(file, (str, os.PathLike))
        if isinstance(file, (str, os.PathLike)):
            path = Path(file)
            if append and path.is_file() and path.read_bytes()[-1:] not in (b"", b"\n"):
                raise ValueError(f"{file} ends with an incomplete line: delete this line, or use another file")
            self._out: TextIO = path.open("a" if append else "w")
        elif hasattr(file, "write"):
            self._out = file
        else:
            raise ValueError(f"file must be a path or an open text file, not {shown(file)}")
        if not append or (self._owned and self._out.tell() == 0):
            self._out.write(",".join(columns) + "\n")

    def _steps_left(self, simulation: Any) -> int:
        return int(self._interval - simulation.currentStep % self._interval)

    def _write(self, simulation: Any, state: Any, values: Iterable[float]) -> None:
        time = float(f"{state.getTime().value_in_unit(unit.picosecond):.{_DIGITS}g}")
        self._out.write(",".join([str(simulation.currentStep), *(repr(float(v)) for v in (time, *values))]) + "\n")
        self._out.flush()

    def close(self) -> None:
        """Close the file if the reporter opened it."""
        if self._owned:
            self._out.close()


class EnergyReporter(_Lines):
    """Write the energies and temperatures of rigid bodies as CSV, in full float64 precision.

    Temperatures are those of ``ExactRigidBodyIntegrator.temperatures()``.

    Parameters
    ----------
    file : str, path or open text file
    reportInterval : int
        Number of steps between two lines.
    append : bool, optional
        Whether to append to an existing file; the names of the columns are then written only if the file is empty. A
        ValueError is raised if the last line of the file is incomplete, for example because a script was killed.

    Notes
    -----
    The simulation must use an `openmm_exactrb.ExactRigidBodyIntegrator`. Each line is flushed immediately, so the file
    contains all lines written before a crash.
    """

    def __init__(self, file: str | os.PathLike[str] | TextIO, reportInterval: int, append: bool = False) -> None:
        super().__init__(file, reportInterval, ("step", "time (ps)", *_COLUMNS, *_SUMS), append)

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Return the number of steps until the next line and the data that the line needs, in OpenMM's format.

        Raises
        ------
        ValueError
            If the integrator of the Simulation is not an `ExactRigidBodyIntegrator`.
        """
        if not isinstance(simulation.integrator, ExactRigidBodyIntegrator):
            raise ValueError(
                "EnergyReporter needs an ExactRigidBodyIntegrator, but this Simulation uses "
                f"{type(simulation.integrator).__name__}: use openmm.app.StateDataReporter"
            )
        return {"steps": self._steps_left(simulation), "periodic": None, "include": ["energy"]}

    def report(self, simulation: Any, state: Any) -> None:
        """Write the line of a State that contains energies."""
        integrator = simulation.integrator
        motion = [a._value for a in (*integrator.kineticEnergies(), *integrator.temperatures())]
        kinetic, potential = sum(motion[:2]), state.getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
        self._write(simulation, state, (*motion, kinetic, potential, kinetic + potential))


class MomentReporter(_Lines):
    """Write the total dipole moment as CSV, in full float64 precision.

    The moment is the sum of charge times position over all particles. In a periodic box, molecules are first made whole
    along constraints and bonds. For soft dipoles, assign the charge strength/length to the tip of each arrow and
    -strength/length to its centre, as in the example `dielectric_constant.py`.

    Parameters
    ----------
    file : str, path or open text file
    reportInterval : int
        Number of steps between two lines.
    charges : (n_particles,) array_like or Quantity
        Quantities are converted to elementary charges, so that the moment is in e nm. Plain numbers are used unchanged.
        The charges of every molecule must add up to zero to within 0.001.
    append : bool, optional
        As in `EnergyReporter`.

    Raises
    ------
    ValueError
        If charges are not a list of finite numbers.
    """

    def __init__(
        self, file: str | os.PathLike[str] | TextIO, reportInterval: int, charges: ArrayLike, append: bool = False
    ) -> None:
        self._charges = _elementary(charges)
        self._links: Links | None = None  # within molecules, found at the first report
        super().__init__(file, reportInterval, ("step", "time (ps)", "Mx", "My", "Mz"), append)

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Return the number of steps until the next line and the data that the line needs, in OpenMM's format.

        Raises
        ------
        ValueError
            If the number of charges differs from the number of particles, or a molecule is not neutral.
        """
        self._links_of(simulation)
        return {"steps": self._steps_left(simulation), "periodic": False, "include": ["positions"]}

    def report(self, simulation: Any, state: Any) -> None:
        """Write the line of a State that contains positions."""
        x, links = state.getPositions(asNumpy=True).value_in_unit(unit.nanometer), self._links_of(simulation)
        if simulation.system.usesPeriodicBoundaryConditions():
            box = state.getPeriodicBoxVectors(asNumpy=True).value_in_unit(unit.nanometer)
            x = joined(x, links, box)
        self._write(simulation, state, self._charges @ x)

    def _links_of(self, simulation: Any) -> Links:
        """Return the links that join the particles of each molecule, after checking the charges."""
        particles = simulation.system.getNumParticles()
        if len(self._charges) != particles:
            raise ValueError(
                f"charges must contain one entry for each particle of the System, so the length must be {particles}, "
                f"not {len(self._charges)}: use 0 for particles without a charge"
            )
        if self._links is None:
            _check_ions(self._charges, _molecules(simulation))
            self._links = molecular_links(simulation.system, molecule_of(simulation.context, None))
        return self._links


def _elementary(charges: Any) -> Array:
    """Return a copy of charges as an array, with Quantities converted to elementary charges."""
    e = unit.elementary_charge
    given = [stripped(q, e) for q in charges] if isinstance(charges, (list, tuple)) else stripped(charges, e)
    asked = "a list of numbers or Quantities of charge, one for each particle"
    values = checks.array(given, "charges", asked).copy()
    if values.ndim != 1:
        raise ValueError(f"charges must be {asked}, not {shown(charges)}")
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ValueError(f"charges must be finite numbers, but the charge of particle {first} is {values[first]}")
    return values


def _check_ions(charges: Array, molecule: NDArray[np.integer[Any]]) -> None:
    """Raise ValueError if a molecule is not neutral, because the moment would depend on its periodic image."""
    total = np.bincount(molecule, charges)
    worst = int(np.abs(total).argmax())
    if abs(total[worst]) > _NEUTRAL:
        first = int(np.flatnonzero(molecule == worst)[0])
        raise ValueError(
            f"charges must add up to 0 in every molecule, but those of the molecule with particle {first} add up to "
            f"{total[worst]:.6g}: correct these charges, or use 0 for the particles of an ion"
        )


def _molecules(simulation: Any) -> NDArray[np.intp]:
    integrator = simulation.integrator
    named = integrator.getNamedBodies() if isinstance(integrator, ExactRigidBodyIntegrator) else None
    return molecule_of(simulation.context, named)
