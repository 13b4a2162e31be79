"""The energy error of a run, and what to expect of a longer one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: A run is unstable once its energy is off by this part of the kinetic energy.
LOST = 0.1

_WINDOWS = (8, 4, 2, 1)
# Into how many parts a run falls where a drift is looked for. Squares of the changes between parts are twice those of
# what is left of them beside a line, where they scatter, and far less where they walk. A drift is that many errors of
# itself, so that one walk in 25 is taken for one, and of the swings few.
_PARTS, _SCATTER, _CLEAR_OF_SCATTER, _CLEAR_OF_WALK = 16, 1.5, 4.0, 4.0


@dataclass(frozen=True)
class Series:
    """Energies of one run.

    Attributes
    ----------
    energies : (n,) array
        Total energy in kJ/mol per body.
    interval : float
        Time between two of them in ps.
    stable : bool
        Whether the run came to its end with its energy.
    """

    energies: Array
    interval: float
    stable: bool

    def error(self, horizon: float) -> float:
        """Return the standard deviation to expect within a run of a length in ps; see `expected_error`."""
        return expected_error(self.energies, self.interval, horizon) if self.stable else math.inf


def expected_error(energies: Array, interval: float, horizon: float) -> float:
    """Extrapolate the standard deviation of an energy to a longer run.

    A drift that cannot be chance is carried on as a line. Of what is left the
    variance within windows of 1/8, 1/4, 1/2 and all of the run, as a power of their length, is carried on to the
    horizon; the power is kept between 0 (the energy swings about a mean) and 1 (it wanders as a random walk does).

    A walk is known badly from one run, so that its part is raised by up to a half. Of random walks that are known over
    half the horizon 1 in 40 then exceeds twice the answer, and 1 in 10 of those that consist of ten jumps; over a tenth
    of the horizon 1 in 8 and 1 in 4. What hides beneath a swing for now is not foreseen: of walks that are as large as
    a swing about them by the end of a run of a tenth of the horizon 1 in 20 exceeds twice the answer, of those three
    times as large 3 in 10.

    Parameters
    ----------
    energies : (n,) array
        n of 16 or more, at equal times.
    interval : float
        Time between two of them.
    horizon : float
        Length of the longer run, in the unit of `interval`.

    Returns
    -------
    float
        In the unit of `energies`.
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
    """Return by how much an energy drifts within all of a run; zero where that may be chance.

    The means of parts of the run scatter about a line, or they walk: the error of the slope is that of the one or the
    other.
    """
    m = len(energies) // _PARTS
    t = (np.arange(_PARTS) - 0.5 * (_PARTS - 1)) / _PARTS
    means = energies[: _PARTS * m].reshape(_PARTS, m).mean(axis=1)
    slope = (t @ means) / (t @ t)
    rest, steps = means - means.mean() - slope * t, np.diff(means)
    if (np.diff(rest) ** 2).sum() > _SCATTER * (rest @ rest):
        clear = _CLEAR_OF_SCATTER * math.sqrt(rest @ rest / ((_PARTS - 2) * (t @ t)))
    else:
        clear = _CLEAR_OF_WALK * _PARTS * float(steps.std(ddof=1)) / math.sqrt(len(steps))
    return float(slope * len(energies) / (_PARTS * m)) if abs(slope) > clear else 0.0


def _window_variance(energies: Array, m: int) -> float:
    """Return the mean variance within windows of m samples."""
    k = len(energies) // m
    return float(energies[: k * m].reshape(k, m).var(axis=1).mean())
