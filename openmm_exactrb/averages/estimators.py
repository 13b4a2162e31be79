"""Observables as functions of the frames: their averages, and the data for the step-size errors of the averages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from openmm_exactrb.averages.frames import BAR
from openmm_exactrb.averages.record import RecordSettings
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array

# kg/m³ per Da/nm³.
_DENSITY = 1.66053906660


class Sampled(NamedTuple):
    """Values of an observable (frames,) and its slopes along M⁻¹f_s, for bodies without and with inner steps."""

    values: Array
    slopes: tuple[Array, Array]
    energy: bool = False  #: whether the observable is the potential energy, or differs from it by a function of volume


Columns = dict[str, Array]
#: The name of the column of frame numbers, which is computed and not read from a file.
FRAME = "frame"
#: A value, and an observable whose average has the same step-size error.
Estimate = tuple[float, Sampled]


def named(settings: RecordSettings, name: str) -> Callable[[Columns], Estimate]:
    """Return the estimator of a named observable."""
    if name in settings.observables:
        return lambda columns: _mean(columns[name], columns[f"{name} slope"], columns[f"{name} inner slope"])
    if name not in READY:
        known = ", ".join([*READY, *settings.observables])
        raise ValueError(
            f"the observable {name!r} is unknown: choose one of {known}, or pass an array of one value per frame"
        )
    needs, ensemble, of = READY[name]
    if ensemble == "constant pressure" and not settings.barostat:
        raise ValueError(
            f"the {name} can be corrected only for a run at constant pressure: add a MonteCarloBarostat to the "
            "System, and repeat the run"
        )

    def estimate(columns: Columns) -> Estimate:
        if needs not in columns:
            raise ValueError(f"the file contains no {needs}s: repeat the run with AverageReporter(..., pressure=True)")
        return of(settings, columns)

    return estimate


def given(values: Any, slope: Any, columns: Columns) -> Callable[[Columns], Estimate]:
    """Return the estimator of a user's values for each frame."""
    frames = len(columns[FRAME])
    array = checks.array(values, "observable", "one number for each frame")
    given = [0.0, 0.0] if slope is None else list(slope) if np.ndim(slope) == 2 else [slope, np.zeros(frames)]
    slopes = [checks.array(s, "slope", "one number for each frame, or two such arrays") for s in given]
    fits = array.shape == (frames,) and len(slopes) == 2 and all(s.shape in ((), (frames,)) for s in slopes)
    if not fits or not all(np.isfinite(some).all() for some in (array, *slopes)):
        raise ValueError(
            f"observable and slope must contain one finite number for each of the {frames} frames of the file"
        )
    slopes = [np.broadcast_to(s, (frames,)) for s in slopes]

    def estimate(some: Columns) -> Estimate:
        chosen = some[FRAME].astype(int)
        return _mean(array[chosen], *(s[chosen] for s in slopes))

    return estimate


def _mean(values: Array, slope: Array | None = None, inner: Array | None = None) -> Estimate:
    none = np.zeros_like(values)
    slopes = (none if slope is None else slope, none if inner is None else inner)
    return float(values.mean()), Sampled(values, slopes)


def _potential(settings: RecordSettings, columns: Columns) -> Estimate:
    return _energy(columns, columns["potential"])


def pressure_of(settings: RecordSettings, columns: Columns) -> Estimate:
    """Return the molecular pressure."""
    return _mean(columns["pressure"], columns["pressure slope"], columns["pressure inner slope"])


def _volume(settings: RecordSettings, columns: Columns) -> Estimate:
    return _mean(columns["volume"])


def _density(settings: RecordSettings, columns: Columns) -> Estimate:
    return _mean(_DENSITY * settings.mass / columns["volume"])


def _enthalpy(settings: RecordSettings, columns: Columns) -> Estimate:
    return _energy(columns, columns["potential"] + settings.pressure / BAR * columns["volume"])


def _energy(columns: Columns, values: Array) -> Estimate:
    return float(values.mean()), Sampled(values, (-columns["work"], -columns["inner work"]), energy=True)


def _heat_capacity(settings: RecordSettings, columns: Columns) -> Estimate:
    """Return the heat capacity from the fluctuations of the enthalpy, or of the energy at constant volume."""
    _, energy = (_enthalpy if settings.barostat else _potential)(settings, columns)
    off = energy.values - energy.values.mean()
    scale = 1.0 / (settings.kT * settings.temperature)
    outer, inner = (2.0 * scale * off * slope for slope in energy.slopes)
    value, of = _mean(scale * off**2, outer, inner)
    return value + 0.5 * settings.freedom * settings.kT / settings.temperature, of


def _compressibility(settings: RecordSettings, columns: Columns) -> Estimate:
    """Return the isothermal compressibility from the fluctuations of the volume."""
    volume = columns["volume"]
    off, mean = volume - volume.mean(), float(volume.mean())
    variance = float(np.mean(off**2))
    scale = 1.0 / (settings.kT * mean * BAR)
    _, of = _mean(scale * (off**2 - variance / mean * off))
    return scale * variance, of


def _expansion(settings: RecordSettings, columns: Columns) -> Estimate:
    """Return the thermal expansion coefficient from the covariance of the volume and the enthalpy."""
    volume, (_, enthalpy) = columns["volume"], _enthalpy(settings, columns)
    off, mean = volume - volume.mean(), float(volume.mean())
    product = off * (enthalpy.values - enthalpy.values.mean())
    scale = 1.0 / (settings.kT * settings.temperature * mean)
    outer, inner = (scale * off * slope for slope in enthalpy.slopes)
    _, of = _mean(scale * (product - product.mean() / mean * off), outer, inner)
    return float(scale * product.mean()), of


READY = {
    "potential energy": ("potential", "any", _potential),
    "pressure": ("pressure", "any", pressure_of),
    "volume": ("volume", "constant pressure", _volume),
    "density": ("volume", "constant pressure", _density),
    "enthalpy": ("volume", "constant pressure", _enthalpy),
    "heat capacity": ("potential", "any", _heat_capacity),
    "compressibility": ("volume", "constant pressure", _compressibility),
    "thermal expansion": ("volume", "constant pressure", _expansion),
}
