"""Averages of liquid water at 0.5 to 6 fs per force evaluation, without and with the correction for the step size.

The averages are those of records/equipartition.csv, over 1 ns per point with a friction of 5/ps. To second order, a
correction consists of equilibrium averages, which are the same for all schemes and steps, and of coefficients of the
scheme. The equilibrium averages are computed from the frames of a run with LangevinMiddleIntegrator at 4 fs, and used
for all schemes and steps; records/corrected_water.csv contains the corrections. Frames are stored in
out/benchmarks/averages, from which an interrupted command continues.

    python benchmarks/water/corrected_water.py --models spce tip4p2005 --ps 300 --seeds 1
    python benchmarks/water/corrected_water.py --table
"""

from __future__ import annotations

import argparse
import itertools
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import openmm_exactrb as rb
from benchmarks.common.markdown import table, with_error
from benchmarks.common.records import RECORDS, Record
from benchmarks.water import averages, equipartition_record
from benchmarks.water.equipartition_record import AGAIN, FRICTION, KELVIN, LFM, NAMES, WHOLE
from benchmarks.water.equipartition_record import RECORD as RUNS
from openmm_exactrb.averages.record import head, read
from openmm_exactrb.schemes import scheme_for_thermostat, splitting
from openmm_exactrb.schemes.step_errors import step_errors
from openmm_exactrb.schemes.thermostatted import with_thermostat

#: In records/equipartition.csv, W2_3m has positions at its next kick, in later runs at the end of its step. In both, a
#: barostat acts at the next kick.
NEXT_KICK, AT_END = 0.135, "W2_3m, at the end"
MOLECULES, FRAME = 216, 0.2  # of a box; ps between two frames
METHODS, STEPS = (LFM, "BAOAB", "W2_3m", AT_END), (0.5, 1.0, 2.0, 4.0, 6.0)
#: Quantities of records/equipartition.csv by ensemble, their names here, and whether they are for a molecule.
QUANTITIES = {
    "NVT": (("U", "potential energy", True),),
    "NPT": (("U", "potential energy", True), ("density", "density", False)),
}
NAMED = ("potential energy", "density", "enthalpy")
BAR, MOLAR_MASS = 0.1, 18.0154  # kJ/mol of 1 bar in a molar volume of 1 L; g/mol
HELD = {"NVT": "constant volume", "NPT": "1 bar"}
COLUMNS = [f"{name}{part}" for name in ("U", "density") for part in ("", " error")]
RECORD = Record(
    RECORDS / "corrected_water.csv",
    ("model", "ensemble", "method", "fs", "ps", "seed"),
    COLUMNS,
    order=lambda row: (row["model"], [*HELD].index(row["ensemble"]), METHODS.index(row["method"]), float(row["fs"])),
)


class Corrected(NamedTuple):
    """An average at a step as it is, and its correction, each with its error."""

    method: str
    fs: float
    mean: float
    error: float
    correction: float
    correction_error: float

    @property
    def after(self) -> tuple[float, float]:
        """The corrected average and its error."""
        return self.mean + self.correction, math.hypot(self.error, self.correction_error)


def as_if(file: Path, method: str, fs: float, other: Path) -> None:
    """Write the frames of a LangevinMiddleIntegrator to another file, with the settings of another integrator."""
    lines, settings = file.read_text(encoding="utf-8").splitlines(keepends=True), read(file)[0]
    own, scheme = method == LFM, "W2_3m" if method == AT_END else method
    order = step_errors(with_thermostat(scheme_for_thermostat("BAOA" if own else scheme)))
    if method == "W2_3m":
        order = order._replace(late=NEXT_KICK)
    step = 0.001 * fs * (1 if own else splitting(scheme).forces)
    changed = replace(
        settings,
        step=step,
        alpha=order.alpha,
        beta=order.beta,
        slopes=(order.slope, order.inner_slope),
        barostat_slope=order.barostat_slope,
        quartic=order.quartic,
        chords=own,
    )
    other.write_text(head(changed, lines[1].strip().split(",")) + "".join(lines[2:]), encoding="utf-8")


def rows_of(model: str, ensemble: str, ps: float, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the corrections of all methods and steps from one run."""
    bar = 0.0 if ensemble == "NVT" else 1.0
    run = {"model": model, "molecules": MOLECULES, "masses": "plain", "scheme": LFM, "fs": 4.0, "ensemble": ensemble}
    file = averages.frames(run | {"bar": bar, "ps": ps, "seed": seed}, "CPU", FRAME)
    for method, fs in itertools.product(METHODS, STEPS):
        row = dict.fromkeys(COLUMNS, "nan")
        for name, quantity, of_molecule in QUANTITIES[ensemble]:
            with tempfile.TemporaryDirectory() as folder:
                other = Path(folder) / "frames.csv"
                as_if(file, method, fs, other)
                found = rb.corrected(other, quantity)
            per = MOLECULES if of_molecule else 1
            row |= {name: f"{found.correction / per:.4g}", f"{name} error": f"{found.correction_error / per:.2g}"}
        yield row | {"model": model, "ensemble": ensemble, "method": method, "fs": fs, "ps": ps, "seed": seed}


@cache
def points(model: str, ensemble: str, name: str) -> list[Corrected]:
    """Return the averages of a model that have a correction, by method and step."""
    corrections = [row for row in RECORD.rows().values() if (row["model"], row["ensemble"]) == (model, ensemble)]
    measured = [(point.method, point) for point in equipartition_record.points(equipartition_record.read(RUNS))]
    again = equipartition_record.points(equipartition_record.read(AGAIN))
    measured += [
        (AT_END, point) for point in again if (point.method, point.kelvin) == ("W2_3m", KELVIN) and point.ps >= WHOLE
    ]
    found = []
    for method, point in measured:
        rows = [row for row in corrections if (row["method"], row["fs"]) == (method, str(point.interval))]
        if (point.model, point.ensemble, point.friction) == (model, ensemble, FRICTION) and rows:
            *correction, _ = agreement([(float(row[name]), float(row[f"{name} error"])) for row in rows])
            found.append(Corrected(method, point.interval, *point.found[name], *correction))
    return sorted(found, key=lambda point: (METHODS.index(point.method), point.fs))


def agreement(values: list[tuple[float, float]]) -> tuple[float, float, float]:
    """Return the mean of values with errors, its error, and the sum of squares of what they are off in their errors."""
    mean, error = np.array(values).T
    weights = error**-2.0
    common = float(weights @ mean / weights.sum())
    return common, float(weights.sum() ** -0.5), float(weights @ (mean - common) ** 2)


def at_small_steps(model: str, ensemble: str, name: str, method: str | None = None) -> tuple[float, float] | None:
    """Return an average without an error of the step, the mean of all corrected ones up to 4 fs, and its error.

    With a method, it is the mean of its averages at 4 fs. Enthalpies (kJ/mol per molecule) are those of
    averages.py, without the kinetic energy.
    """
    quantity = "U" if name in ("potential energy", "enthalpy") else name
    found = points(model, ensemble, quantity) if name in NAMED else []
    some = [p.after for p in found if (p.fs <= 4.0 if method is None else (p.method, p.fs) == (method, 4.0))]
    if not some:
        return None
    mean, error, _ = agreement(some)
    known = at_small_steps(model, ensemble, "density") if name == "enthalpy" else None
    return (mean + BAR * MOLAR_MASS / known[0] if known else mean), error


def studied() -> list[tuple[str, str, str]]:
    """Return model, ensemble and quantity of all that the record has."""
    known = dict.fromkeys((row["model"], row["ensemble"]) for row in RECORD.rows().values())
    return [(model, ensemble, name) for model, ensemble in known for name, _, _ in QUANTITIES[ensemble]]


UNITS = {"U": ("U (kJ/mol per molecule)", 3), "density": ("density (kg/m³)", 1)}


def corrected_water() -> str:
    """Return energies at constant volume, 4 and 6 fs, as they are and corrected, as a table of a page."""
    body = []
    for model, ensemble, name in studied():
        for point in points(model, ensemble, name):
            if point.fs >= 4.0 and ensemble == "NVT":
                cells = (point.mean, point.error), (point.correction, point.correction_error), point.after
                body.append(
                    [NAMES[model], f"`{point.method}`", f"{point.fs:g}"]
                    + [with_error(*cell, UNITS[name][1]) for cell in cells]
                )
    return table(("U (kJ/mol per molecule), constant volume", "", "fs", "as it is", "correction", "corrected"), body)


def corrected_water_agreement() -> str:
    """Return how well averages at steps up to 4 fs agree, and what extrapolation gives, as a table of a page."""
    body = []
    for model, ensemble, name in studied():
        label, digits = UNITS[name]
        some = [point for point in points(model, ensemble, name) if point.fs <= 4.0]
        _, _, before = agreement([(point.mean, point.error) for point in some])
        *common, after = agreement([point.after for point in some])
        by_step = {point.fs: point for point in some if point.method == "W2_3m"}
        fine, coarse = by_step[2.0], by_step[4.0]
        line = (4.0 * fine.mean - coarse.mean) / 3.0, math.hypot(4.0 * fine.error, coarse.error) / 3.0
        body.append(
            [f"{NAMES[model]}, {HELD[ensemble]}", label, f"{before:.0f}", f"{after:.0f}", f"{len(some) - 1}"]
            + [with_error(*cell, digits) for cell in (common, coarse.after, line)]
        )
    head = (
        "",
        "",
        "χ² as it is",
        "corrected",
        "expected",
        "mean of all",
        "`W2_3m`, 4 fs, corrected",
        "2 and 4 fs, extrapolated",
    )
    return table(head, body)


def main() -> None:
    """Make the runs that the record has not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", default=["spce", "tip4p2005"], help="%(default)s")
    parser.add_argument("--ensembles", nargs="+", default=["NVT", "NPT"], choices=["NVT", "NPT"])
    parser.add_argument("--ps", type=float, default=300.0, help="of a run; %(default)s")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1], help="%(default)s")
    parser.add_argument("--table", action="store_true", help="print the tables of the record only")
    arguments = parser.parse_args()
    if not arguments.table:
        for model, ensemble, seed in itertools.product(arguments.models, arguments.ensembles, arguments.seeds):
            for row in rows_of(model, ensemble, arguments.ps, seed):
                RECORD.add(row)
    print(corrected_water(), corrected_water_agreement(), sep="\n\n")


if __name__ == "__main__":
    main()
