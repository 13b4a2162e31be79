"""Corrections of averages for the step size, with error estimates.

Let f be the generalised force, f_s the generalised force of the kicks (f without inner steps), S = f_s·M⁻¹f_s and W =
f·M⁻¹f_s. The error that a splitting with steps h causes in the average of an observable A of the positions is

    h² {-(alpha + beta) Cov(A, S)/kT - kappa <grad A · M⁻¹f_s> + J},

where kappa = alpha + y²/2 - c (`openmm_exactrb.schemes.step_errors`) and J depends on the friction. For frictions far
below the rate of energy exchange between motions, and for frictions far above all frequencies, respectively,

    J = 2 alpha <W> Cov(A, U)/(n (kT)²),        J = -2 alpha <grad A · M⁻¹f_s> - alpha Cov(A, W)/kT,

with n degrees of freedom. In <W>, the bodies are weighted by their frictions. The second limit is exact only without
inner steps. For harmonic motions that exchange no energy, the second limit holds at any friction. A correction uses the
mean of the two limits. The conserved energy of drifts along chords has the additional term h² T
(`openmm_exactrb.averages.chord`), which adds

    -Cov(A, T)/kT + 4 <T> Cov(A, U)/(n (kT)²)

to the average at weak friction, and to the energy of a harmonic liquid at any friction; corrections contain this term
in both limits. A barostat accepts changes of volume according to the true energy. The error dP of the pressure at a
fixed volume therefore changes any average by Cov(A, V) dP/kT. In dP, kappa is that of the point in a step at which the
barostat acts. All other terms contain the fluctuations of A, S and W at a fixed volume, because the volume changes
slowly.

For harmonic motions with frequencies w, Var(S) = 2 (kT)² sum w⁴ over the motions without inner steps. The fourth-order
error of these motions in the average of U is

    h⁴ quartic Var(S)/(4 kT),

which is subtracted from the potential energy and the enthalpy. Anharmonic terms of fourth order are not known. In their
place, the error estimate contains a uniform distribution as wide as the harmonic term.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import openmm
from numpy.typing import ArrayLike
from openmm import unit

from openmm_exactrb.averages.correlation import error_of_mean
from openmm_exactrb.averages.estimators import FRAME, READY, Columns, Sampled, given, named, pressure_of
from openmm_exactrb.averages.frames import BAR
from openmm_exactrb.averages.record import RecordSettings, read
from openmm_exactrb.openmm_access.units import plain
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array

# The largest number of blocks of the jackknife, and the smallest number of frames.
_BLOCKS, _FEWEST = 100, 40


@dataclass(frozen=True)
class Average:
    """A corrected average.

    Attributes
    ----------
    mean : float
        The average minus the step-size error.
    error : float
        The standard deviation of the mean, which includes statistical errors and the uncertainty of the correction.
        Statistical errors account for the autocorrelation of the frames.
    correction : float
        `mean` minus the average over the frames.
    correction_error : float
        The standard deviation of the correction, which includes statistical errors, a uniform distribution over
        `bracket`, and, for energies, a uniform distribution as wide as the fourth-order term.
    systematic_error : float
        The contribution of these uniform distributions to `error` and `correction_error`. It does not decrease in
        longer runs, and is common to runs with different seeds.
    bracket : (float, float)
        The corrected averages for weak and for strong friction; `mean` is halfway between them.
    """

    mean: float
    error: float
    correction: float
    correction_error: float
    systematic_error: float
    bracket: tuple[float, float]


@dataclass(frozen=True)
class PressureOffset:
    """An offset for the pressure of a barostat: the step-size error of the pressure where the barostat acts in a step.

    Attributes
    ----------
    bar, error : float
        The error of the pressure at a fixed volume, and its standard deviation, in bar; see `Average`.
    bracket : (float, float)
        The offsets for weak and for strong friction, in bar.
    scheme, step, temperature : str, float (ps), float (K)
        The settings for which the offset is valid. The offset also depends on the force field and the density.
    """

    bar: float
    error: float
    bracket: tuple[float, float]
    scheme: str
    step: float
    temperature: float

    def barostat(self, pressure: float | unit.Quantity, frequency: int = 25) -> openmm.MonteCarloBarostat:
        """Return a barostat that corrects the density for the step size, at a pressure (in bar if it has no unit)."""
        wanted = plain(pressure, unit.bar, "a pressure")
        frequency = checks.whole(frequency, "frequency", of="steps")
        return openmm.MonteCarloBarostat((wanted + self.bar) * unit.bar, self.temperature * unit.kelvin, frequency)


def corrected(
    file: str | os.PathLike[str],
    observable: str | ArrayLike,
    slope: ArrayLike | Sequence[ArrayLike] | None = None,
    local: bool = False,
    pressure: float | unit.Quantity | None = None,
) -> Average:
    """Return the average of an observable without the second-order step-size error.

    The fourth-order error of harmonic motions is also subtracted from the potential energy and the enthalpy.

    Parameters
    ----------
    file : str or path
        File of an `AverageReporter` that contains only frames in equilibrium.
    observable : str or (frames,) array_like
        "potential energy" (kJ/mol), "pressure" (bar), "volume" (nm³), "density" (kg/m³), "enthalpy" (kJ/mol, without
        the kinetic energy), "heat capacity" (kJ/mol/K), "compressibility" (1/bar), "thermal expansion" (1/K), the name
        of one of the reporter's observables, or an array with one value per frame.
    slope : (frames,) array_like or two of them, optional
        Slopes along M⁻¹f_s (1/ps²) of values that depend on positions, for bodies without and with inner steps. Omit
        them for values that depend on the volume alone.
    local : bool, optional
        Whether S contains only the bodies near the particles that the reporter received as ``around``.
    pressure : float or Quantity, optional
        Pressure to which the average is corrected, in bar if it has no unit. The default is the pressure of the
        barostat; other values must be close to this pressure. After a run with the barostat of a `PressureOffset`, pass
        the pressure without the offset.

    Returns
    -------
    Average

    Raises
    ------
    ValueError
        If the file lacks data that the correction needs, or the theory does not apply to the run.
    """
    settings, columns = _checked(file)
    if isinstance(observable, str) and slope is not None:
        raise ValueError(
            f"slope= cannot be combined with a named observable, here {observable!r}: omit slope=, or pass an array "
            "of one value per frame as the observable"
        )
    if checks.switch(local, "local") and isinstance(observable, str) and observable in READY:
        raise ValueError(f"local=True does not apply to the {observable}, a property of the whole System: omit local=")
    excess = 0.0
    if pressure is not None:
        if not settings.barostat:
            raise ValueError(
                f"{file} is from a run at constant volume, whose averages cannot be corrected to a pressure: omit "
                "pressure="
            )
        wanted = plain(pressure, unit.bar, "a pressure")
        settings, excess = replace(settings, pressure=wanted), settings.pressure - wanted
    if settings.barostat and "pressure" not in columns:
        raise ValueError(f"{file} contains no pressures: repeat the run with AverageReporter(..., pressure=True)")
    if local and "square around" not in columns:
        raise ValueError(
            f"{file} was written without around=, which local=True needs: repeat the run with "
            "AverageReporter(..., around=(particles, distance))"
        )
    of = named(settings, observable) if isinstance(observable, str) else given(observable, slope, columns)

    def result(some: Columns) -> _Result:
        value, observable_of = of(some)
        limits = _errors(settings, some, observable_of, local, excess)
        return value, *limits, _of_harmonic_motions(settings, some) if observable_of.energy else 0.0

    return _jackknife(columns, result)


def pressure_offset(file: str | os.PathLike[str]) -> PressureOffset:
    """Return the step-size error of the pressure where a barostat acts, from a run at constant volume.

    This error differs from that of ``corrected(file, "pressure")`` if a barostat does not act at the end of the step.
    With W2_3m, a barostat acts at the positions of the next kick.

    Parameters
    ----------
    file : str or path
        File of an `AverageReporter` with ``pressure=True``. For example, 200 ps of 216 TIP3P molecules at 8 fs per
        force evaluation gave an `error` of 12 or 17 bar.

    Raises
    ------
    ValueError
        If the file contains no pressures, or too few frames.
    """
    settings, columns = _checked(file)
    if "pressure" not in columns:
        raise ValueError(f"{file} contains no pressures: repeat the run with AverageReporter(..., pressure=True)")

    def result(some: Columns) -> _Result:
        value, of = pressure_of(settings, some)
        return value, *_of_barostat(settings, some, of, some["volume"] if settings.barostat else None), 0.0

    found = _jackknife(columns, result)
    weak, strong = (found.mean - found.correction - mean for mean in found.bracket)
    return PressureOffset(
        -found.correction, found.correction_error, (weak, strong), settings.scheme, settings.step, settings.temperature
    )


#: The average over the frames, its second-order errors for weak and for strong friction, and its fourth-order error.
_Result = tuple[float, float, float, float]


def _errors(settings: RecordSettings, columns: Columns, of: Sampled, local: bool, excess: float) -> tuple[float, float]:
    """Return errors of an average for weak and strong friction; `excess` is that of the barostat's pressure (bar)."""
    if not settings.barostat:
        return _at_fixed_volume(settings, columns, of, local, None)
    volume = columns["volume"]
    _, pressure = pressure_of(settings, columns)
    own = _at_fixed_volume(settings, columns, of, local, volume)
    offset = _of_barostat(settings, columns, pressure, volume)
    response = _covariance(of.values, volume) / (settings.kT * BAR)
    return own[0] + response * (offset[0] - excess), own[1] + response * (offset[1] - excess)


def _of_barostat(
    settings: RecordSettings, columns: Columns, pressure: Sampled, volume: Array | None
) -> tuple[float, float]:
    """Return the errors, for weak and for strong friction, of the pressure under which a barostat samples volumes."""
    there = replace(settings, slopes=(settings.barostat_slope, settings.barostat_slope))
    return _at_fixed_volume(there, columns, pressure, False, volume)


def _at_fixed_volume(
    settings: RecordSettings, columns: Columns, of: Sampled, local: bool, volume: Array | None
) -> tuple[float, float]:
    """Return the errors of an average for weak and for strong friction, at a constant or a slowly changing volume."""
    alpha, kT, values = settings.alpha, settings.kT, of.values
    slopes = [float(slope.mean()) for slope in of.slopes]
    work = columns["work"] + columns["inner work"]
    square = columns["square around"] if local else columns["square"] + columns["inner square"]
    own = -(alpha + settings.beta) * _covariance(values, square, volume) / kT
    own -= sum(part * slope for part, slope in zip(settings.slopes, slopes, strict=True))
    with_energy = _covariance(values, columns["potential"], volume) / kT**2
    if settings.chords:
        chord = columns["chord"]
        own += 4.0 * float(chord.mean()) / settings.freedom * with_energy - _covariance(values, chord, volume) / kT
    weak = 2.0 * alpha * float(columns["damped work"].mean()) / settings.freedom * with_energy
    strong = -2.0 * alpha * sum(slopes) - alpha * _covariance(values, work, volume) / kT
    return settings.step**2 * (own + weak), settings.step**2 * (own + strong)


def _of_harmonic_motions(settings: RecordSettings, columns: Columns) -> float:
    """Return the fourth-order error of the average potential energy of harmonic motions."""
    square, volume = columns["square"], columns["volume"] if settings.barostat else None
    return settings.step**4 * settings.quartic * _covariance(square, square, volume) / (4.0 * settings.kT)


def _covariance(a: Array, b: Array, given: Array | None = None) -> float:
    """Return the covariance of two observables, or of their residuals after regression on a third."""
    own = float(np.mean((a - a.mean()) * (b - b.mean())))
    if given is None or not np.ptp(given):
        return own
    return own - _covariance(a, given) * _covariance(b, given) / _covariance(given, given)


def _jackknife(columns: Columns, of: Callable[[Columns], _Result]) -> Average:
    """Return an average over all frames, with jackknife errors."""
    frames = len(columns["step"])
    value, weak, strong, higher = of(columns)
    left_out = []
    for block in np.array_split(np.arange(frames), min(frames, _BLOCKS)):
        kept = np.ones(frames, dtype=bool)
        kept[block] = False
        mean, *limits, rest = of({name: values[kept] for name, values in columns.items()})
        left_out.append((mean - np.mean(limits) - rest, np.mean(limits) + rest))
    # The pseudo-values of the jackknife, up to a constant: their mean has the variance of the result.
    statistical = [error_of_mean((len(left_out) - 1) * series) for series in np.transpose(left_out)]
    systematic = float(np.hypot(weak - strong, higher) / np.sqrt(12.0))  # standard deviation of uniform distributions
    error, of_correction = map(float, np.hypot(statistical, systematic))
    off = 0.5 * (weak + strong) + higher
    return Average(
        value - off, error, -off, of_correction, systematic, (value - weak - higher, value - strong - higher)
    )


def _checked(file: str | os.PathLike[str]) -> tuple[RecordSettings, Columns]:
    """Return the settings and columns of a file; raise ValueError if there are too few frames."""
    settings, columns = read(file)
    frames = len(columns["step"])
    if frames < _FEWEST:
        raise ValueError(
            f"error estimates need at least {_FEWEST} frames, but the number of frames in {file} is {frames}: extend "
            "the run"
        )
    return settings, columns | {FRAME: np.arange(float(frames))}
