"""Runs with a reporter that continue after an interruption."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from openmm import app

#: ps that are not counted.
BURN = 20.0


def reported(
    file: Path, simulation: app.Simulation, reporter: Callable[..., Any], interval: float, ps: float, part: float
) -> Path:
    """Report a run of so many ps to a file, from where an earlier command stopped, and return the file.

    ``reporter(file, steps, append=)`` makes the reporter; ``interval`` is the time between two reports, and ``part``
    that between two States that are saved next to the file, both in ps.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    saved, step = file.with_suffix(".xml"), simulation.integrator.getStepSize()._value
    again = saved.exists()
    if again:
        simulation.loadState(str(saved))
    else:
        simulation.step(round(BURN / step))
    reports = reporter(file, max(1, round(interval / step)), append=again)
    simulation.reporters.append(reports)
    end = round((BURN + ps) / step)
    while simulation.currentStep < end:
        simulation.step(min(round(part / step), end - simulation.currentStep))
        simulation.saveState(str(saved))
    reports.close()
    return file


def error_over_runs(weights: np.ndarray, errors: np.ndarray, systematic: np.ndarray) -> float:
    """Return the error of a mean over runs (runs,) whose statistical errors are independent, but not the others."""
    return float(np.sqrt(weights**2 @ (errors**2 - systematic**2) + (weights @ systematic) ** 2))
