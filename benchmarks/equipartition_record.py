"""The record of the study of equipartition: what each run gave, the means of points, and tables of them.

A line of docs/equipartition.csv is one run: what it was, and its means. The documentation makes its tables from it.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import NamedTuple, get_type_hints

import numpy as np

from openmm_exactrb.files import written_whole

RECORD = Path(__file__).resolve().parents[1] / "docs" / "equipartition.csv"
LFM = "LangevinMiddle"
MEASURED = ("T_tr", "T_rot - T_tr", "other T_rot - T_tr", "U", "density", "acceptance")
WHOLE = 1000.0  # ps of a point that is in the tables

# What a row of a table is called, of which method it is, and what it shows.
OURS = (("W2_3m, the default", "W2_3m"), ("W2_4g", "W2_4g"), ("W2_3", "W2_3"), ("BAOA", "BAOA"))
OTHERS = (("S2_2", "S2_2"), ("hybrid Monte Carlo, no error of the step", "hybrid"))
TEMPERATURES = (
    ("`LangevinMiddleIntegrator`, as reported", LFM, "T_rot - T_tr"),
    ("constrained", LFM, "other T_rot - T_tr"),
    ("BAOAB, at the step's end", "BAOAB", "T_rot - T_tr"),
    ("around the bath", "BAOAB", "other T_rot - T_tr"),
)
ROWS = {
    name: (
        *((*row, name) for row in OURS),
        *(
            TEMPERATURES
            if name == "T_rot - T_tr"
            else (("`LangevinMiddleIntegrator`", LFM, name), ("BAOAB", "BAOAB", name))
        ),
        *((*row, name) for row in OTHERS),
    )
    for name in ("T_rot - T_tr", "U", "density")
}
DIGITS = {"T_tr": 1, "T_rot - T_tr": 1, "other T_rot - T_tr": 1, "U": 2, "density": 1}
FRICTIONS = {LFM: "`LangevinMiddleIntegrator`, constrained", "BAOAB": "BAOAB, at the step's end"}
LABELS = {
    "T_tr": "T_tr (K)",
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
    friction: float  # 1/ps
    ps: float
    seed: int


COLUMNS = {"fs per force" if name == "interval" else name: kind for name, kind in get_type_hints(Run).items()}
Record = dict[Run, dict[str, float]]


class Point(NamedTuple):
    """Runs that differ in their seeds only: the time of all, and (mean, error of the mean) by name."""

    model: str
    ensemble: str
    method: str
    interval: float
    friction: float
    ps: float
    found: dict[str, tuple[float, float]]


def read(file: Path) -> Record:
    """Return what runs gave, by what they were."""
    if not file.exists():
        return {}
    with file.open(newline="") as text:
        return {
            Run(*(kind(row[name]) for name, kind in COLUMNS.items())): {name: float(row[name]) for name in MEASURED}
            for row in csv.DictReader(text)
        }


def add(found: Record, file: Path) -> None:
    """Add runs to the record, in its order; what other commands added meanwhile stays."""
    record = read(file) | found
    with written_whole(file) as out:
        lines = csv.writer(out, lineterminator="\n")
        lines.writerow([*COLUMNS, *MEASURED])
        for run, means in sorted(record.items()):
            lines.writerow([*run, *(f"{means[name]:.7g}" for name in MEASURED)])


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
        )
        for kind, runs in alike.items()
    ]


def mean_and_error(values: np.ndarray) -> tuple[float, float]:
    error = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else math.nan
    return float(np.mean(values)), float(error)


def over_steps(record: Record, quantity: str, model: str, ensemble: str, friction: float = 5.0) -> str:
    """Return a table in Markdown: a row for each method, a column for each time per force, of whole points."""
    of_interest = [p for p in points(record) if p[:2] == (model, ensemble) and p.friction == friction and p.ps >= WHOLE]
    found = {(p.method, p.interval): p.found for p in of_interest}
    intervals = sorted({p.interval for p in of_interest})
    lines = [[LABELS[quantity], *(f"{interval:g} fs" for interval in intervals)], ["---"] * (1 + len(intervals))]
    for label, method, name in ROWS[quantity]:
        cells = [shown(found.get((method, interval), {}), name) for interval in intervals]
        lines += [[label, *cells]] if any(cells) else []
    return markdown(lines)


def over_frictions(record: Record, model: str, interval: float) -> str:
    """Return a table in Markdown: a row for each method and friction, a column for each quantity, at constant volume.

    Temperatures of LangevinMiddleIntegrator are those of its constrained velocities.
    """
    lines = [["", "friction (1/ps)", *(LABELS[name] for name in ("T_tr", "T_rot - T_tr", "U"))], ["---"] * 5]
    for point in sorted(points(record), key=lambda point: (point.method, point.friction)):
        if (point.model, point.ensemble, point.interval) == (model, "NVT", interval) and point.ps >= WHOLE:
            difference = "other T_rot - T_tr" if point.method == LFM else "T_rot - T_tr"
            cells = (shown(point.found, name) for name in ("T_tr", difference, "U"))
            lines.append([FRICTIONS.get(point.method, point.method), f"{point.friction:g}", *cells])
    return markdown(lines)


def shown(found: dict[str, tuple[float, float]], name: str) -> str:
    """Return a mean and its error as a reader wants them, or nothing."""
    if name not in found:
        return ""
    mean, error = (round(value, DIGITS[name]) + 0.0 for value in found[name])  # + 0.0: no minus before a zero
    return f"{mean:.{DIGITS[name]}f} ± {error:.{DIGITS[name]}f}".replace("-", "−")


def markdown(lines: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
