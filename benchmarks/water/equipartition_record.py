"""The record of the study of equipartition: the results of each run, the means of points, and their tables.

A row of records/equipartition.csv contains the settings and the means of one run. The tables of the documentation are
generated from this record.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from benchmarks.common import records
from benchmarks.common.markdown import markdown, with_error
from benchmarks.common.provenance import OF_RUN

RECORD = records.RECORDS / "equipartition.csv"
#: Later runs: in those of RECORD, W2_3m has positions at its next kick, now at the end of its step. A barostat acts at
#: the next kick in both.
AGAIN = records.RECORDS / "water_densities.csv"
LFM = "LangevinMiddle"
NAMES = {"spce": "SPC/E", "tip4p2005": "TIP4P/2005", "tip3p": "TIP3P", "tip4pew": "TIP4P-Ew"}
MEASURED = ("T_tr", "T_rot - T_tr", "other T_rot - T_tr", "U", "density", "acceptance")
WHOLE = 1000.0  # ps of a point that is in the tables
FRICTION, KELVIN = 5.0, 298.15  # 1/ps and K, of the points in the tables over steps
GOALS = {"T_rot - T_tr": 1.0, "U": 0.03, "density": 0.1}  # K, kJ/mol per molecule, % of the reference

# What a row of a table is called, of which method it is, and what it shows.
ROWS = {
    "T_rot - T_tr": (
        ("W2_3m", "W2_3m", "T_rot - T_tr"),
        ("W2_4g", "W2_4g", "T_rot - T_tr"),
        ("`LangevinMiddleIntegrator`, as reported", LFM, "T_rot - T_tr"),
        ("constrained", LFM, "other T_rot - T_tr"),
        ("BAOAB, at the step's end", "BAOAB", "T_rot - T_tr"),
        ("around the heat exchange", "BAOAB", "other T_rot - T_tr"),
        ("hybrid Monte Carlo, no error of the step", "hybrid", "T_rot - T_tr"),
    ),
    "U": (
        ("W2_3m, at the next kick", "W2_3m", "U"),
        ("W2_4g", "W2_4g", "U"),
        ("`LangevinMiddleIntegrator`", LFM, "U"),
        ("BAOAB", "BAOAB", "U"),
        ("hybrid Monte Carlo, no error of the step", "hybrid", "U"),
    ),
}
DIGITS = {"T_rot - T_tr": 1, "other T_rot - T_tr": 1, "U": 2}
LABELS = {
    "T_rot - T_tr": "T_rot − T_tr (K)",
    "U": "potential energy (kJ/mol per molecule)",
    "density": "density (kg/m³)",
}


class Run(NamedTuple):
    """What a run was."""

    model: str
    ensemble: str
    method: str
    interval: float  # fs per force
    molecules: int
    friction: float  # 1/ps; of Nosé-Hoover chains the collision frequency
    kelvin: float
    ps: float
    seed: int


COLUMNS = {"fs per force" if name == "interval" else name: kind for name, kind in get_type_hints(Run).items()}
Record = dict[Run, dict[str, Any]]  # numbers of MEASURED, and texts of OF_RUN
Mean = tuple[float, float]  # and its error
Means = dict[str, Mean]


class Point(NamedTuple):
    """Runs that differ in their seeds only: the time of all, and (mean, error of the mean) by name."""

    model: str
    ensemble: str
    method: str
    interval: float
    friction: float
    ps: float
    found: Means
    kelvin: float


def read(file: Path) -> Record:
    """Return what runs gave and where they come from, by what they were."""
    return {
        Run(*(kind(row[name]) for name, kind in COLUMNS.items())): {name: float(row[name]) for name in MEASURED}
        | {name: row[name] for name in OF_RUN}
        for row in records.read(file)
    }


def merge(found: Record, file: Path) -> Record:
    """Add runs to the record, in its order, and return all of it; what other commands added meanwhile stays."""
    record = read(file) | found
    rows = (
        [*run, *(f"{of_run[name]:.7g}" for name in MEASURED), *(of_run[name] for name in OF_RUN)]
        for run, of_run in sorted(record.items(), key=itemgetter(0))
    )
    records.write(file, [*COLUMNS, *MEASURED, *OF_RUN], rows)
    return record


def points(record: Record) -> list[Point]:
    """Return the means over runs that differ in their seeds; errors are those of the mean of independent runs."""
    alike: dict[Run, list[Run]] = {}
    for run in record:
        alike.setdefault(run._replace(seed=0), []).append(run)
    return [
        Point(
            *(kind.model, kind.ensemble, kind.method, kind.interval, kind.friction, len(runs) * kind.ps),
            {
                name: mean_and_error(values)
                for name in MEASURED
                if np.isfinite(values := np.array([record[run][name] for run in runs])).all()
            },
            kind.kelvin,
        )
        for kind, runs in alike.items()
    ]


def mean_and_error(values: np.ndarray) -> Mean:
    error = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else math.nan
    return float(np.mean(values)), float(error)


def whole(record: Record) -> dict[tuple[str, str, str, float, float], Means]:
    """Return the means of whole points, by model, ensemble, method, time per force and friction."""
    return {point[:5]: point.found for point in points(record) if point.ps >= WHOLE and point.kelvin == KELVIN}


def over_steps(record: Record, quantity: str, model: str, ensemble: str, omitted: Collection[float] = ()) -> str:
    """Return a table in Markdown: a row for each method, a column for each time per force, of whole points.

    Columns of the times that are omitted are left out.
    """
    found = {
        (method, interval): means
        for (*where, method, interval, friction), means in whole(record).items()
        if (*where, friction) == (model, ensemble, FRICTION)
    }
    intervals = sorted({interval for _, interval in found}.difference(omitted))
    lines = [[LABELS[quantity], *(f"{interval:g} fs" for interval in intervals)], ["---"] * (1 + len(intervals))]
    for label, method, name in ROWS[quantity]:
        cells = [shown(found.get((method, interval), {}), name) for interval in intervals]
        lines += [[label, *cells]] if any(cells) else []
    return markdown(lines)


def denser(record: Record) -> dict[str, tuple[Mean, float]]:
    """Return by how many percent W2_3m at 4 fs is denser than OpenMM's integrator at the smallest step, and this step.

    The steps of OpenMM's integrator are 1 fs or less.
    """
    found, differences = whole(record), {}
    for model, name in NAMES.items():
        step = min(step for *what, step, g in found if (*what, g) == (model, "NPT", LFM, FRICTION))
        ours, theirs = (
            found[model, "NPT", method, fs, FRICTION]["density"] for method, fs in (("W2_3m", 4.0), (LFM, step))
        )
        differences[name] = less(ours, theirs, 100.0), step
    return differences


def less(a: Mean, b: Mean, scale: float | None = None) -> Mean:
    """Return the difference of two means with its error, as a part of the second one times a scale if there is one."""
    factor = 1.0 if scale is None else scale / b[0]
    return factor * (a[0] - b[0]), abs(factor) * math.hypot(a[1], b[1])


def shown(found: Means, name: str) -> str:
    """Return a mean and its error as a reader wants them, or nothing."""
    if name not in found:
        return ""
    return with_error(*found[name], DIGITS[name])
