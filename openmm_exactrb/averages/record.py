"""The file of an `AverageReporter`: a line of settings, the names of the columns, and a row for each frame."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from openmm_exactrb.support.types import Array

_MARK = "# "


@dataclass(frozen=True)
class RecordSettings:
    """The settings of a run that the corrections need.

    Attributes
    ----------
    scheme : str
    step : float
        Step size h in ps.
    alpha, beta : float
        Coefficients of the conserved energy; see `openmm_exactrb.schemes.step_errors`.
    slopes : (float, float)
        Factors of the slope of an observable in a correction, for bodies without and with inner steps.
    barostat_slope : float
        Factor of the slope of the pressure at the point in a step at which a barostat acts.
    quartic : float
        Coefficient of the fourth-order error of the energy of harmonic motions; see `schemes.step_errors`.
    temperature : float
        Temperature in K.
    kT : float
        Thermal energy in kJ/mol.
    frictions : tuple of float
        Frictions in 1/ps.
    freedom : int
        Number of degrees of freedom.
    mass : float
        Total mass of all particles, in Da.
    barostat : str
        The type of the System's barostat, or "" without a barostat.
    pressure : float
        Pressure of the barostat, in bar.
    observables : tuple of str
        Names of the user's observables.
    chords : bool, optional
        Whether drifts follow chords, as in `openmm_exactrb.averages.chord`.
    interval : int, optional
        Number of steps between two frames.
    around : tuple of float, optional
        The reporter's argument `around`: the distance in nm, followed by the particles.
    system : str, optional
        A hash of the System, without the seeds of its forces; empty if OpenMM cannot serialise the System.
    """

    scheme: str
    step: float
    alpha: float
    beta: float
    slopes: tuple[float, float]
    barostat_slope: float
    quartic: float
    temperature: float
    kT: float
    frictions: tuple[float, ...]
    freedom: int
    mass: float
    barostat: str = ""
    pressure: float = 0.0
    observables: tuple[str, ...] = ()
    chords: bool = False
    interval: int = 0
    around: tuple[float, ...] = ()
    system: str = ""


#: The names of the columns that a file may contain in addition to those of the user's observables.
COLUMNS = (
    *("step", "time", "potential", "volume", "square", "inner square", "work", "inner work", "damped work", "chord"),
    *("square around", "pressure", "pressure slope", "pressure inner slope", "frame"),
)


def of_observable(name: str) -> tuple[str, str, str]:
    """Return the names of the columns of a user's observable: its values, and its slopes."""
    return name, f"{name} slope", f"{name} inner slope"


def columns_of(settings: RecordSettings, pressure: bool, around: bool) -> tuple[str, ...]:
    """Return the names of the columns of a file."""
    names = ["step", "time (ps)", "potential (kJ/mol)", "volume (nm^3)"]
    names += ["square (kJ/mol/ps^2)", "inner square (kJ/mol/ps^2)"]
    names += ["work (kJ/mol/ps^2)", "inner work (kJ/mol/ps^2)", "damped work (kJ/mol/ps^2)"]
    names += ["chord (kJ/mol/ps^2)"] * settings.chords
    names += ["square around (kJ/mol/ps^2)"] * around
    names += ["pressure (bar)", "pressure slope (bar/ps^2)", "pressure inner slope (bar/ps^2)"] * pressure
    for name in settings.observables:
        value, *slopes = of_observable(name)
        names += [value, *(f"{slope} (1/ps^2)" for slope in slopes)]
    return tuple(names)


def head(settings: RecordSettings, columns: tuple[str, ...]) -> str:
    """Return the first two lines of a file."""
    return f"{_MARK}{json.dumps(asdict(settings))}\n{','.join(columns)}\n"


def continued(file: Path, step: int, settings: RecordSettings, columns: tuple[str, ...]) -> str:
    """Return the text of a file whose run continues at a step, without the frames after this step.

    Raises
    ------
    ValueError
        If the file is from a run with other settings, all its frames are after the step, or its last line is
        incomplete.
    """
    text = file.read_text(encoding="utf-8")
    first, second, *rows = [*text.splitlines(keepends=True), "", ""]
    if _settings(first) != settings or second.strip() != ",".join(columns):
        raise ValueError(f"{file} belongs to a run with other settings: pass another file to the AverageReporter")
    if not text.endswith("\n"):
        raise ValueError(f"{file} ends with an incomplete line: delete this line, or use another file")
    kept = [row for row in rows if row and int(row.split(",")[0]) <= step]
    if not kept and any(rows):
        raise ValueError(
            f"all frames in {file} are after step {step}, at which this run begins: load the State in which the "
            "earlier run ended, or use another file"
        )
    return "".join((first, second, *kept))


def _settings(line: str) -> RecordSettings | None:
    """Return the settings in a line, or None for a line that this version of `AverageReporter` did not write."""
    known = _values(line)
    tuples = {name: tuple(value) for name, value in known.items() if isinstance(value, list)}
    try:
        return RecordSettings(**{**known, **tuples})
    except TypeError:
        return None


def _values(line: str) -> dict[str, Any]:
    """Return the settings in a line by name, or an empty mapping for any other line."""
    try:
        known = json.loads(line.removeprefix(_MARK)) if line.startswith(_MARK) else {}
    except ValueError:
        known = {}
    return known if isinstance(known, dict) else {}


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def read(file: str | os.PathLike[str]) -> tuple[RecordSettings, dict[str, Array]]:
    """Return the settings of a file, and its columns by name (without units).

    Raises
    ------
    ValueError
        If the file is not from an `AverageReporter`, or a line is incomplete or has a value that is not finite.
    OSError
        If the file cannot be read.
    """
    lines = Path(file).read_text(encoding="utf-8").splitlines()
    if len(lines) < 2 or not _values(lines[0]):
        raise ValueError(f"{file} was not written by an AverageReporter: pass a file that an AverageReporter wrote")
    settings = _settings(lines[0])
    if settings is None:
        raise ValueError(
            f"{file} was written by another version of openmm_exactrb: read the file with that version, or run the "
            "simulation again with this version"
        )
    names = [name.split(" (")[0] for name in lines[1].split(",")]
    rows = [line.split(",") for line in lines[2:]]
    for number, row in enumerate(rows, start=3):
        if len(row) != len(names):
            raise ValueError(f"line {number} of {file} is incomplete: delete this line")
    values = np.array([[*map(_value, row)] for row in rows]).reshape(-1, len(names))
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        raise ValueError(
            f"line {3 + np.argmin(finite)} of {file} contains a non-finite value: delete this line and all later ones"
        )
    return settings, dict(zip(names, values.T, strict=True))
