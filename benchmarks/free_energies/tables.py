"""Tables of hydration.py and metadynamics.py: free energies with long steps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from benchmarks.common.markdown import distinct, table, with_error
from benchmarks.common.records import RECORDS, Row, read

ANGLES = ("phi", "psi")
BELOW = 15.0  # kJ/mol up to which profiles are compared
LABELS = {
    "2fs": "`LangevinMiddleIntegrator`, 2 fs, `HBonds`",
    "4fs": "`LangevinMiddleIntegrator`, 4 fs, `HBonds`",
    "8fs AllBonds": "`LangevinMiddleIntegrator`, 8 fs, `AllBonds`",
    "BAOA 8fs": "`BAOA`, 8 fs, `HBonds`",
}


def hydration(record: Path = RECORDS / "hydration.csv") -> str:
    """Return the hydration free energies, the failures and the forces of each integrator."""
    found = read(record)
    body = [_hydration(kind, [row for row in found if row["kind"] == kind]) for (kind,) in distinct(found, "kind")]
    head = "integrator", "seeds", "ΔG (kcal/mol)", "smallest overlap", "ns", "failed runs"
    return table((*head, "forces per ns", "density (kg/m³)"), body)


def _hydration(kind: str, rows: list[Row]) -> list[str]:
    """Return a line, with the error of MBAR."""
    values, errors = (np.array([float(row[name]) for row in rows]) for name in ("value", "error"))
    n, ns = len(rows), 0.001 * sum(float(row["simulated"]) for row in rows)
    failures, forces = (sum(int(row[name]) for row in rows) for name in ("failures", "forces"))
    return [
        *(LABELS.get(kind, kind), f"{n}", with_error(values.mean(), math.sqrt(np.square(errors).sum()) / n, 2)),
        f"{min(float(row['overlap']) for row in rows):.2f}",
        *(f"{ns:.2f}", f"{failures} of {failures + sum(int(row['windows']) for row in rows)}", f"{forces / ns:.0f}"),
        f"{np.mean([float(row['density']) for row in rows]):.1f}",
    ]


def metadynamics(record: Path = RECORDS / "metadynamics.csv") -> str:
    """Return how far the profiles of each integrator are from the reference, the first kind, and their scatter."""
    found = read(record)
    (reference, *kinds), body = (kind for (kind,) in distinct(found, "kind")), []
    for kind in kinds:
        cells = []
        for angle in ANGLES:
            expected, low = profiles(found, reference, angle)
            energies, _ = profiles(found, kind, angle, low)
            apart = np.abs(energies.mean(axis=0) - expected.mean(axis=0))[low].max()
            scatter = energies[:, low].std(axis=0, ddof=1).max() if len(energies) > 1 else math.nan
            cells += [f"{apart:.2f}", f"{scatter:.2f}"]
        body.append([kind, f"{len(energies)}", *cells])
    head = [f"{text} {angle}" for angle in ANGLES for text in ("largest difference,", "scatter of a run,")]
    return table(("integrator", "runs", *head), body)


def profiles(rows: list[Row], kind: str, angle: str, low: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the profiles (runs, bins) in kJ/mol, relative to their means over the low bins, and which bins these are.

    Without `low`, these are the bins at which the mean of the profiles is below `BELOW`.
    """
    some = [row for row in rows if (row["kind"], row["angle"]) == (kind, angle)]
    energies = np.array([
        [float(row["energy"]) for row in some if row["seed"] == seed] for (seed,) in distinct(some, "seed")
    ])  # fmt: skip
    if low is None:
        mean = energies.mean(axis=0)
        low = mean - mean.min() < BELOW
    return energies - energies[:, low].mean(axis=1, keepdims=True), low
