"""AverageReporter, which stores the data needed to correct averages for the step size."""

from __future__ import annotations

import logging
import os
import re
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import openmm
from openmm import unit

from openmm_exactrb.averages.dynamics import dynamics_of
from openmm_exactrb.averages.estimators import READY
from openmm_exactrb.averages.frames import Frames, Observable
from openmm_exactrb.averages.record import COLUMNS, RecordSettings, columns_of, continued, head, of_observable
from openmm_exactrb.context.updates import BAROSTATS, acting_updates
from openmm_exactrb.openmm_access.units import gas_constant_times, plain
from openmm_exactrb.support import checks
from openmm_exactrb.support.files import written_whole
from openmm_exactrb.support.messages import shown
from openmm_exactrb.support.stable_text import digest

_log = logging.getLogger("openmm_exactrb")


class AverageReporter:
    """Write the data for `corrected` and `pressure_offset` to a CSV file, with all digits.

    Without pressure, a report evaluates no forces except fast forces, because the Simulation provides all forces.

    Parameters
    ----------
    file : str or path
    reportInterval : int
        Number of steps between two frames. Error estimates account for correlations between frames.
    pressure : bool, optional
        Whether to store the molecular pressure and its slope, which costs two more evaluations of energy and forces per
        frame. Corrections at constant pressure and `pressure_offset` need this pressure. All forces must follow the
        periodic box: see Notes.
    observables : mapping of str to callable, optional
        Functions that return a number for the positions, an array (n_particles, 3) in nm with whole molecules. These
        functions are also evaluated at displaced positions, to compute the slopes that the corrections need.
    around : (sequence of int, float), optional
        Particles, such as those of a solute, and a distance in nm (or a Quantity). The reporter then also stores S,
        the sum of f_s·M⁻¹f_s, of only those bodies that are within this distance of the particles. For observables that
        depend only on these particles, the statistical error of corrections is then smaller: see the argument
        ``local`` of `corrected`.
    append : bool, optional
        Whether to continue an existing file of a run with the same settings. Frames after the step at which the run
        continues, such as those after the last checkpoint of a killed run, are removed.

    Notes
    -----
    After a change of forces with ``updateParametersInContext``, create a new reporter with another file. The Simulation
    must use an `openmm_exactrb.ExactRigidBodyLangevinIntegrator` with one heat exchange per step, or OpenMM's
    LangevinMiddleIntegrator. Each line is flushed to the file immediately.

    A force that depends on absolute positions, such as a restraint to points or a wall, has no virial pressure, and
    neither has a force that uses a box of its own. With ``pressure=True``, the first step raises a ValueError with the
    name of such a force. Restrain particles relative to a centre of mass instead. Molecules with frozen particles
    (mass 0) move with the box, but are not counted in the kinetic pressure N kT/V. OpenMM's barostats count them.
    """

    def __init__(
        self,
        file: str | os.PathLike[str],
        reportInterval: int,
        pressure: bool = False,
        observables: Mapping[str, Observable] | None = None,
        around: tuple[Sequence[int], float | unit.Quantity] | None = None,
        append: bool = False,
    ) -> None:
        self._file, self._append = Path(file), append
        self._interval = checks.whole(reportInterval, "reportInterval", of="steps")
        checks.switch(append, "append")
        self._pressure, self._observables = checks.switch(pressure, "pressure"), _named(observables)
        self._around = None if around is None else _around(around)
        self._frames: Frames | None = None
        self._dynamics: Any = None
        self._simulation: Any = None
        self._out: Any = None
        self._present: object = None  # the settings that may be changed in a run

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Return when the next frame is due and which data it needs, as OpenMM requires.

        Raises
        ------
        ValueError
            If averages of the Simulation's integrator cannot be corrected, the file belongs to another run, or a force
            has no virial pressure.
        """
        if self._frames is None:
            self._begin(simulation)
        left = int(self._interval - simulation.currentStep % self._interval)
        return {"steps": left, "periodic": False, "include": ["positions", "energy", "forces"]}

    def report(self, simulation: Any, state: Any) -> None:
        """Write a line for a Simulation and a State with positions, energy and forces."""
        frames = self._frames or self._begin(simulation)
        if self._simulation() is not simulation:
            raise ValueError(
                f"the frames in {self._file} are from another Simulation: use a separate AverageReporter for each "
                "Simulation"
            )
        if self._changing(simulation) != self._present:
            raise ValueError(
                "the step size, the thermostat, the barostat, the force groups, a parameter of the Context, or (by "
                f"reinitialize) the System has changed since the first frame in {self._file}: use a new "
                "AverageReporter with another file"
            )
        values = [state.getTime().value_in_unit(unit.picosecond), *frames.row(state, self._observables)]
        self._out.write(",".join([str(simulation.currentStep), *(repr(float(v)) for v in values)]) + "\n")
        self._out.flush()

    def close(self) -> None:
        """Close the file."""
        if self._out is not None:
            self._out.close()

    def _begin(self, simulation: Any) -> Frames:
        dynamics = self._dynamics = dynamics_of(simulation)
        if self._around is not None and max(self._around[0]) >= simulation.system.getNumParticles():
            raise ValueError(
                f"the particles of around= must be numbers from 0 to {simulation.system.getNumParticles() - 1}, not "
                f"{max(self._around[0])}: choose particles of the System"
            )
        frames = Frames(simulation, dynamics, self._pressure, self._around)
        settings = self._settings(simulation)
        columns = columns_of(settings, self._pressure, self._around is not None)
        if self._append and self._file.is_file() and self._file.stat().st_size > 0:
            text = continued(self._file, simulation.currentStep, settings, columns)
        else:
            text = head(settings, columns)
        with written_whole(self._file, "wb") as out:
            out.write(text.encode())
        self._out = self._file.open("a", encoding="utf-8")
        if settings.barostat and frames.frozen:
            _log.warning(
                "OpenMM's %s also counts the molecules with frozen particles (number: %d), so its pressure is too high "
                "by their kT/V",
                settings.barostat,
                frames.frozen,
            )
        self._frames, self._present = frames, self._changing(simulation)
        self._simulation = weakref.ref(simulation)
        return frames

    def _changing(self, simulation: Any) -> object:
        """Return the settings that a user may change during a run."""
        groups, context = simulation.integrator.getIntegrationForceGroups(), simulation.context
        return self._dynamics.changing(), groups, dict(context.getParameters()), _barostat(context)

    def _settings(self, simulation: Any) -> RecordSettings:
        """Return the settings of a Simulation; raise ValueError if its averages cannot be corrected."""
        system, dynamics, errors = simulation.system, self._dynamics, self._dynamics.errors
        barostat, pressure = _barostat(simulation.context)
        masses = (system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(system.getNumParticles()))
        return RecordSettings(
            scheme=dynamics.scheme,
            step=dynamics.step,
            alpha=errors.alpha,
            beta=errors.beta,
            slopes=(errors.slope, errors.inner_slope),
            barostat_slope=errors.barostat_slope,
            quartic=errors.quartic,
            temperature=dynamics.temperature,
            kT=gas_constant_times(dynamics.temperature),
            frictions=dynamics.frictions,
            freedom=dynamics.freedom,
            mass=sum(masses),
            barostat=barostat,
            pressure=pressure,
            observables=tuple(self._observables),
            chords=dynamics.chords is not None,
            interval=self._interval,
            around=() if self._around is None else (self._around[1], *map(float, self._around[0])),
            system=_hash(system),
        )


def _barostat(context: Any) -> tuple[str, float]:
    """Return the type and the pressure (bar) of the barostat of a Context; the type is empty without a barostat."""
    barostats = [force for force in acting_updates(context) if type(force).__name__ in BAROSTATS]
    if len(barostats) > 1:
        raise ValueError("averages cannot be corrected with several barostats: keep only one in the System")
    barostat = type(barostats[0]).__name__ if barostats else ""
    if barostat not in ("", "MonteCarloBarostat"):
        raise ValueError(f"averages cannot be corrected with a {barostat}: use a MonteCarloBarostat")
    return barostat, context.getParameter(barostats[0].Pressure()) if barostats else 0.0


def _named(observables: Any) -> dict[str, Observable]:
    """Return the observables by name; raise ValueError if a name or a function is not valid."""
    asked = "observables must be a mapping from names to functions of the positions"
    if observables is None:
        return {}
    if not isinstance(observables, Mapping):
        raise ValueError(f"{asked}, not {shown(observables)}")
    for name, observable in observables.items():
        if not isinstance(name, str) or not callable(observable):
            raise ValueError(f"{asked}, not a mapping that contains {shown(name)}: {shown(observable)}")
    columns = [*COLUMNS, *(column for name in observables for column in of_observable(name))]
    for name in observables:
        plain_text = name.isprintable() and name == name.strip() != "" and not set(name) & set(',("')
        if name in READY or not plain_text or any(columns.count(column) > 1 for column in of_observable(name)):
            raise ValueError(
                f"an observable cannot have the name {name!r}: choose a name that contains no comma, opening "
                "parenthesis or double quotation mark, neither begins nor ends with a space, and is neither the name "
                f"of a column of the file nor one of {', '.join(READY)}"
            )
    return dict(observables)


def _around(around: Any) -> tuple[list[int], float]:
    """Return the particles and the distance (nm) of a neighbourhood."""
    if not isinstance(around, Sequence) or len(around) != 2:
        raise ValueError(
            "around= must be a tuple of particle indices and a distance in nm, such as ([0, 1, 2], 0.5), not "
            f"{shown(around)}"
        )
    try:
        (particles,) = checks.lists_of_indices([around[0]], "around")
    except ValueError:
        particles = []
    if not particles or min(particles) < 0:
        raise ValueError(
            f"the particles of around= must be a list of particle indices, such as [0, 1, 2], not {shown(around[0])}"
        )
    distance = checks.positive(plain(around[1], unit.nanometer, "a distance"), "the distance of around=", of="nm")
    return particles, distance


def _hash(system: openmm.System) -> str:
    """Return a hash of a System without seeds, or an empty text if OpenMM cannot serialise the System."""
    try:
        text = openmm.XmlSerializer.serialize(system)
    except Exception:  # any error of pickle, for a PythonForce; such Systems are not compared
        return ""
    return digest(re.sub(r'randomSeed="\d*"', "", text).encode())
