"""The energy error of a run at constant energy: the standard deviation of the total energy within time windows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.starts import put

#: In ps. Short ones show how far the energy swings, long ones its slow wandering too.
WINDOWS = (0.5, 2.0, 10.0, 30.0)


def total(context: openmm.Context) -> float:
    """Return potential and kinetic energy as a State has them, in kJ/mol."""
    state = context.getState(energy=True)
    return state.getPotentialEnergy()._value + state.getKineticEnergy()._value


def along(context: openmm.Context, duration: float, interval: float) -> tuple[np.ndarray, float]:
    """Return the total energies (kJ/mol) of a run of this Context, infinite if it diverges, and how many ps apart."""
    integrator = context.getIntegrator()
    step = integrator.getStepSize()._value
    every = max(1, round(interval / step))
    energies = np.full(round(duration / (every * step)), np.inf)
    try:
        for k in range(len(energies)):
            integrator.step(every)
            energies[k] = total(context)
    except (openmm.OpenMMException, rb.IntegrationError):
        energies[:] = np.inf
    return energies, every * step


def variance(energies: Sequence[float], interval: float, window: float) -> float:
    """Return the mean variance within windows of so many ps; infinite of a run that diverged."""
    if not np.isfinite(energies).all():
        return np.inf
    parts = np.array_split(energies, max(1, round(len(energies) * interval / window)))
    return float(np.mean([part.var() for part in parts]))


def windows(duration: float) -> list[float]:
    """Return those of `WINDOWS` that fit into a run."""
    return [window for window in WINDOWS if window <= duration]


def spread(runs: Iterable[Sequence[float]], duration: float) -> tuple[float, ...]:
    """Return the standard deviations within each of the windows, root mean square over runs of this length."""
    runs = list(runs)
    return tuple(
        float(np.sqrt(np.mean([variance(energies, duration / len(energies), window) for energies in runs])))
        for window in windows(duration)
    )


def noise(context: openmm.Context, starts: Iterable[Any], duration: float) -> tuple[float, ...]:
    """Return the `spread` of runs of a Context from several starts, sampled every 20 fs."""
    runs = []
    for start in starts:
        put(context, start)
        runs.append(along(context, duration, 0.02)[0])
    return spread(runs, duration)


def root_mean_square(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))
