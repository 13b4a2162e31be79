"""AverageReporter, which stores the data needed to correct averages for the step size."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from openmm import unit

from openmm_exactrb.averages.dynamics import Dynamics, dynamics_of
from openmm_exactrb.averages.frames import Frames, Observable
from openmm_exactrb.averages.record import Settings, columns_of, continues, head
from openmm_exactrb.context.updates import BAROSTATS, acting_updates
from openmm_exactrb.openmm_access.units import gas_constant_times, plain
from openmm_exactrb.support import checks


class AverageReporter:
    """Write the data for `corrected` and `pressure_offset` to a CSV file, with all digits.

    Unless pressure is requested, a report uses only the forces that the Simulation evaluates for this report.

    Parameters
    ----------
    file : str or path
    reportInterval : int
        Number of steps between two frames. In water, frames 0.1 ps apart are nearly independent.
    pressure : bool, optional
        Whether to store the molecular pressure and its slope, which costs two more evaluations of energy and forces per
        frame. Corrections at constant pressure and `pressure_offset` need this pressure.
    observables : mapping of str to callable, optional
        Functions that return a number for the positions, an array (n_particles, 3) in nm with whole molecules. These
        functions are also evaluated at displaced positions, to compute the slopes that the corrections need.
    around : (sequence of int, float), optional
        Particles, such as those of a solute, and a distance in nm (or a Quantity). The curvature of the potential is
        then also stored for the bodies within this distance alone. For observables that depend only on these particles,
        this reduces the statistical error of corrections: see the argument ``local`` of `corrected`.
    append : bool, optional
        Whether to continue an existing file of a run with the same settings.

    Notes
    -----
    The Simulation must use an `openmm_exactrb.ExactRigidBodyLangevinIntegrator` with one heat exchange per step, or
    OpenMM's LangevinMiddleIntegrator. Each line is flushed to the file immediately.
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
        self._pressure, self._observables = checks.switch(pressure, "pressure"), dict(observables or {})
        self._around = None if around is None else (around[0], plain(around[1], unit.nanometer, "a distance"))
        self._frames: Frames | None = None
        self._dynamics: Any = None
        self._out: Any = None
        self._present: object = None  # the settings that may be changed in a run

    def describeNextReport(self, simulation: Any) -> dict[str, Any]:
        """Return when the next frame is due and which data it needs, as OpenMM requires.

        Raises
        ------
        ValueError
            If averages of the Simulation's integrator cannot be corrected, or the file belongs to another run.
        """
        if self._frames is None:
            self._begin(simulation)
        left = int(self._interval - simulation.currentStep % self._interval)
        return {"steps": left, "periodic": False, "include": ["positions", "energy", "forces"]}

    def report(self, simulation: Any, state: Any) -> None:
        """Write a line for a Simulation and a State with positions, energy and forces."""
        frames = self._frames or self._begin(simulation)
        if self._changing(simulation) != self._present:
            raise ValueError(
                "the step size, the thermostat, the force groups or a parameter of the Context has changed since the "
                f"first frame in {self._file}: replace this AverageReporter by one with another file"
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
        settings = settings_of(simulation, dynamics, self._observables)
        frames = Frames(simulation, dynamics, self._pressure, self._around)
        columns = columns_of(settings, self._pressure, self._around is not None)
        continued = self._append and self._file.is_file() and self._file.stat().st_size > 0
        if continued:
            text = self._file.read_text(encoding="utf-8")
            if not continues(text, settings, columns):
                raise ValueError(
                    f"{self._file} belongs to a run with other settings: give the AverageReporter another file"
                )
            if not text.endswith("\n"):
                raise ValueError(f"{self._file} ends with an incomplete line: delete this line, or give another file")
        self._out = self._file.open("a" if continued else "w", encoding="utf-8")
        if not continued:
            self._out.write(head(settings, columns))
        self._frames, self._present = frames, self._changing(simulation)
        return frames

    def _changing(self, simulation: Any) -> object:
        """Return the settings that a user may change during a run."""
        groups = simulation.integrator.getIntegrationForceGroups()
        return self._dynamics.changing(), groups, dict(simulation.context.getParameters())


def settings_of(simulation: Any, dynamics: Dynamics, observables: Mapping[str, Any]) -> Settings:
    """Return the settings of a Simulation; raise ValueError if its averages cannot be corrected."""
    system, order = simulation.system, dynamics.order
    barostats = [force for force in acting_updates(simulation.context) if type(force).__name__ in BAROSTATS]
    if len(barostats) > 1:
        raise ValueError("averages cannot be corrected with several barostats: keep only one in the System")
    barostat = type(barostats[0]).__name__ if barostats else ""
    if barostat not in ("", "MonteCarloBarostat"):
        raise ValueError(f"averages cannot be corrected with a {barostat}: use a MonteCarloBarostat")
    pressure = simulation.context.getParameter(barostats[0].Pressure()) if barostats else 0.0
    masses = (system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(system.getNumParticles()))
    return Settings(
        scheme=dynamics.scheme,
        step=dynamics.step,
        alpha=order.alpha,
        beta=order.beta,
        slopes=(order.slope, order.inner_slope),
        barostat_slope=order.barostat_slope,
        quartic=order.quartic,
        temperature=dynamics.temperature,
        kT=gas_constant_times(dynamics.temperature),
        frictions=dynamics.frictions,
        freedom=dynamics.freedom,
        mass=sum(masses),
        barostat=barostat,
        pressure=pressure,
        observables=tuple(observables),
        chords=dynamics.chords is not None,
    )
