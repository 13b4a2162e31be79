"""The file of an `AverageReporter`: a line of settings, the names of the columns, and a row for each frame."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from openmm_exactrb.support.types import Array

_MARK = "# "


@dataclass(frozen=True)
class Settings:
    """The settings of a run that the corrections need.

    Attributes
    ----------
    scheme : str
    step : float
        Step size h in ps.
    alpha, beta : float
        Coefficients of the conserved energy; see `openmm_exactrb.schemes.step_errors`.
    slopes : (float, float)
        Factors with which a correction subtracts the slope of an observable, for bodies without and with inner steps.
    barostat_slope : float
        The same factor for the slope of the pressure at the point of a step where a barostat acts.
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


def columns_of(settings: Settings, pressure: bool, around: bool) -> tuple[str, ...]:
    """Return the names of the columns of a file."""
    names = ["step", "time (ps)", "potential (kJ/mol)", "volume (nm^3)"]
    names += ["square (kJ/mol/ps^2)", "inner square (kJ/mol/ps^2)"]
    names += ["work (kJ/mol/ps^2)", "inner work (kJ/mol/ps^2)", "damped work (kJ/mol/ps^2)"]
    names += ["chord (kJ/mol/ps^2)"] * settings.chords
    names += ["square around (kJ/mol/ps^2)"] * around
    names += ["pressure (bar)", "pressure slope (bar/ps^2)", "pressure inner slope (bar/ps^2)"] * pressure
    for name in settings.observables:
        names += [name, f"{name} slope (1/ps^2)", f"{name} inner slope (1/ps^2)"]
    return tuple(names)


def head(settings: Settings, columns: tuple[str, ...]) -> str:
    """Return the first two lines of a file."""
    return f"{_MARK}{json.dumps(asdict(settings))}\n{','.join(columns)}\n"


def continues(text: str, settings: Settings, columns: tuple[str, ...]) -> bool:
    """Return whether a file with this text is from a run with these settings and columns."""
    first, second, *_ = [*text.splitlines(), "", ""]
    return first.startswith(_MARK) and _settings(first) == settings and second == ",".join(columns)


def _settings(line: str) -> Settings | None:
    """Return the settings in a line, or None if another version wrote them."""
    known = json.loads(line.removeprefix(_MARK))
    tuples = {name: tuple(value) for name, value in known.items() if isinstance(value, list)}
    try:
        return Settings(**{**known, **tuples})
    except TypeError:
        return None


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def read(file: str | os.PathLike[str]) -> tuple[Settings, dict[str, Array]]:
    """Return the settings of a file, and its columns by names without units.

    Raises
    ------
    ValueError
        If the file is not from an `AverageReporter`, or a line is incomplete or has a value that is not finite.
    OSError
        If the file cannot be read.
    """
    lines = Path(file).read_text(encoding="utf-8").splitlines()
    if len(lines) < 2 or not lines[0].startswith(_MARK):
        raise ValueError(f"{file} was not written by an AverageReporter: give a file that an AverageReporter wrote")
    settings = _settings(lines[0])
    if settings is None:
        raise ValueError(
            f"{file} was written by another version of openmm_exactrb: read the file with that version, "
            "or run the simulation again with this one"
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
            f"line {3 + np.argmin(finite)} of {file} has a non-finite value: delete this line and all later ones"
        )
    return settings, dict(zip(names, values.T, strict=True))
