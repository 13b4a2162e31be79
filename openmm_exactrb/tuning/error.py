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

    The variance within windows of 1/8, 1/4, 1/2 and all of the run, as a power of their length, is carried on to the
    horizon; the power is kept between 0 (the energy swings about a mean) and 1 (it wanders as a random walk does).
    A walk is known badly from one run, so that its part is raised by up to a half: of random walks known over half the
    horizon 1 in 40 then exceeds twice the answer, and 1 in 18 of those that consist of rare jumps.

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
    n = len(energies)
    lengths = [n // k for k in _WINDOWS]
    logs = np.log(np.maximum([_window_variance(energies, m) for m in lengths], np.finfo(float).tiny))
    x = np.log(np.array(lengths) / n)
    weights = np.sqrt(np.array([4.0, 3.0, 2.0, 1.0]))
    slope, at_full_length = np.polyfit(x, logs, 1, w=weights)
    power = min(max(float(slope), 0.0), 1.0)
    known = math.exp(0.5 * (float(at_full_length) + power * math.log(max(horizon / (n * interval), 1.0))))
    return (1.0 + 0.5 * power) * known


def _window_variance(energies: Array, m: int) -> float:
    """Return the mean variance within windows of m samples."""
    k = len(energies) // m
    return float(energies[: k * m].reshape(k, m).var(axis=1).mean())
