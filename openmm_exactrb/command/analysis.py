"""The summary and the picture of a run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.runs import Run

#: Names of output files in the folder of a run.
ENERGIES, VOLUME, PICTURE = "energies.csv", "volume.csv", "picture.png"

_FEW = 3  # smallest number of lines of a table for which a standard deviation is reported
_TEMPERATURES = {"translation": 4, "rotation": 5}  # indices of columns of `EnergyReporter`


def summary(simulation: Any, job: Run, ensemble: str) -> Iterator[str]:
    """Yield the lines that summarise a run, given its Simulation after the last step."""
    integrator = simulation.integrator
    table, (bodies, _) = _table(job.folder / ENERGIES), integrator.bodyState()
    length = simulation.currentStep * integrator.getStepSize().value_in_unit(unit.picosecond)
    speed = f", {job.wall / length:.3g} s per ps, {86.4 * length / job.wall:.3g} ns/day" if job.wall > 0.0 else ""
    note, _, _ = integrator.engineNote().rpartition("; ")  # without what a step is, which the command said before
    yield f"{integrator.getScheme().name}: {length:.4g} ps{speed}"
    yield f"{integrator.getEngine()} engine: {note}"
    yield "temperature: " + ", ".join(f"{name} {T.mean():.1f} K" for name, T in _temperatures(table).items())
    if ensemble == "nve" and len(table) >= _FEW:
        yield f"total energy: standard deviation {table[:, -1].std() / len(bodies):.1e} kJ/mol per body"
    if ensemble == "npt":
        yield f"density: {_table(job.folder / VOLUME)[:, -1].mean():.4g} g/mL"
    yield f"{job.folder}: {', '.join(sorted(file.name for file in job.folder.iterdir()))}"


def draw(folder: Path, ensemble: str) -> None:
    """Plot the temperatures, and the energy or the density, against time if matplotlib is installed."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        print("no picture: matplotlib is not installed", file=sys.stderr)
        return
    table = _table(folder / ENERGIES)
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, sharex=True)
    for name, T in _temperatures(table).items():
        upper.plot(table[:, 1], T, lw=1.0, label=f"{name}, mean {T.mean():.1f} K")
    upper.set_ylabel("temperature (K)")
    upper.legend(fontsize=9)
    if ensemble == "npt":
        volume = _table(folder / VOLUME)
        lower.plot(volume[:, 1], volume[:, -1], color="black", lw=1.0)
        lower.set_ylabel("density (g/mL)")
    else:
        lower.plot(table[:, 1], table[:, -1] - table[0, -1], color="black", lw=1.0)
        lower.set_ylabel("change of the total energy (kJ/mol)")
    lower.set_xlabel("time (ps)")
    figure.savefig(folder / PICTURE, dpi=150)


def _temperatures(table: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the translational and rotational temperatures, except those without degrees of freedom."""
    return {name: table[:, k] for name, k in _TEMPERATURES.items() if not np.isnan(table[:, k]).any()}


def _table(file: Path) -> NDArray[np.float64]:
    return np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2, comments="#")
