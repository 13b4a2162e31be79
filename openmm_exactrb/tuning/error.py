"""The energy error of a run, and its growth with the length of the run."""

from __future__ import annotations

import math

import numpy as np

from openmm_exactrb.support.types import Array

_WINDOWS = (8, 4, 2, 1)
# A drift is the slope of the means of this many parts of a run. The differences of successive residuals from a line
# show how the means scatter. For independent means, the sum of the squared differences is twice that of the squared
# residuals; for a random walk, the ratio is far smaller. The second number separates the two cases.
_PARTS, _SCATTER = 16, 1.5
# A slope is a drift if it exceeds this many of its standard errors. About one random walk in 25, and few oscillations,
# are then mistaken for a drift.
_SIGNIFICANT = 4.0


def expected_error(energies: Array, interval: float, horizon: float) -> float:
    """Extrapolate the standard deviation of an energy to a longer run.

    A significant drift is extrapolated linearly. The variance of the remainder within windows of 1/8, 1/4, 1/2 and all
    of the run is fitted by a power of the window length and extrapolated to the horizon. The power is kept between 0
    (the energy oscillates about a mean) and 1 (the energy is a random walk). A single run determines a random walk
    poorly, so the contribution of the remainder is increased by up to a half. The section "How long advice holds" of
    the documentation states how often the errors of longer runs exceed the result.

    Parameters
    ----------
    energies : (n,) array
        Energies at equal intervals of time, where n is at least 16.
    interval, horizon : float
        Time between two energies, and length of the longer run, in the same unit.
    """
    n, longer = len(energies), max(horizon / (len(energies) * interval), 1.0)
    drift = _drift(energies)
    rest = energies - drift * np.linspace(0.0, 1.0, n)
    lengths = [n // k for k in _WINDOWS]
    logs = np.log(np.maximum([_window_variance(rest, m) for m in lengths], np.finfo(float).tiny))
    x = np.log(np.array(lengths) / n)
    weights = np.sqrt(np.array([4.0, 3.0, 2.0, 1.0]))
    slope, at_full_length = np.polyfit(x, logs, 1, w=weights)
    power = min(max(float(slope), 0.0), 1.0)
    known = math.exp(0.5 * (float(at_full_length) + power * math.log(longer)))
    return math.hypot((1.0 + 0.5 * power) * known, drift * longer / math.sqrt(12.0))


def _drift(energies: Array) -> float:
    """Return the drift of an energy over the whole run, or zero if it is not significant.

    The standard error of the slope is that of independent means or of a random walk, whichever fits the data.
    """
    m = len(energies) // _PARTS
    t = (np.arange(_PARTS) - 0.5 * (_PARTS - 1)) / _PARTS
    means = energies[: _PARTS * m].reshape(_PARTS, m).mean(axis=1)
    slope = (t @ means) / (t @ t)
    rest, steps = means - means.mean() - slope * t, np.diff(means)
    if (np.diff(rest) ** 2).sum() > _SCATTER * (rest @ rest):
        error = math.sqrt(rest @ rest / ((_PARTS - 2) * (t @ t)))
    else:
        error = _PARTS * float(steps.std(ddof=1)) / math.sqrt(len(steps))
    return float(slope * len(energies) / (_PARTS * m)) if abs(slope) > _SIGNIFICANT * error else 0.0


def _window_variance(energies: Array, m: int) -> float:
    """Return the mean variance within windows of m samples."""
    k = len(energies) // m
    return float(energies[: k * m].reshape(k, m).var(axis=1).mean())
