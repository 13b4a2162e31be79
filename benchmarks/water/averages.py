"""Averages of water at long steps, without and with the correction for the step size, compared with small steps.

Boxes of 216 molecules with PME and a switch at 298.15 K, friction 5/ps, run on the CPU platform with one thread, or
larger ones on a GPU. At constant volume, the averages are the potential energy and the pressure; at 1 bar, they are the
density, the enthalpy and their response coefficients. Corrections are those of `openmm_exactrb.corrected`. With
`--offset`, the pressure of the barostat is 1 bar plus the offset that the runs at constant volume of the same point
predict. Frames are stored in out/benchmarks/averages, from which an interrupted command continues. Each seed is a run
and a row of the record.

    python benchmarks/water/averages.py --fs 2 4 8 --seeds 1 2
    python benchmarks/water/averages.py --fs 8 --ensemble NPT --offset
    python benchmarks/water/averages.py --models tip4p2005 --masses plain --schemes LangevinMiddle --fs 2 4
    python benchmarks/water/averages.py --platform CUDA --molecules 8192 --frame 1 --fs 4 8
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.records import OUT, RECORDS, Record, Row
from benchmarks.common.reported import reported
from benchmarks.common.starts import REPEATED

TEMPERATURE, FRICTION, HEAVY = 298.15, 5.0, 3.0
PART = 100  # frames between two savings
SMOOTH = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.85, "switchDistance": 0.75, "ewaldErrorTolerance": 1e-4}
KEY = ("model", "molecules", "masses", "scheme", "fs", "ensemble", "bar", "ps", "seed")
UNITS = {
    "potential energy": "kJ/mol",
    "pressure": "bar",
    "density": "kg/m³",
    "enthalpy": "kJ/mol",
    "compressibility": "10⁻⁶/bar",
    "thermal expansion": "10⁻⁴/K",
}
SCALES = {"compressibility": 1e6, "thermal expansion": 1e4}
OF_BOX = "potential energy", "enthalpy"
NAMES, PARTS = tuple(UNITS), ("", " corrected", " error", " correction error", " systematic error")
OFFSET = "pressure offset", "pressure offset error", "pressure offset systematic error"
COLUMNS = [*(f"{name}{part}" for name in NAMES for part in PARTS), *OFFSET]
RECORD = Record(RECORDS / "averages.csv", KEY, COLUMNS)


def simulation_of(run: dict[str, Any], platform: str) -> app.Simulation:
    """Return the minimised start of a run on a platform."""
    topology, system, positions = rb.rigid_water(run["molecules"], model=run["model"], **SMOOTH)
    if run["masses"] == "heavy":
        rb.heavy_hydrogens(system, topology, HEAVY)
    if run["ensemble"] == "NPT":
        barostat = openmm.MonteCarloBarostat(run["bar"], TEMPERATURE, max(1, round(0.1 / step_of(run))))
        barostat.setRandomNumberSeed(run["seed"])
        system.addForce(barostat)
    integrator = integrator_of(run["scheme"], 0.001 * run["fs"])
    integrator.setRandomNumberSeed(run["seed"])
    properties = REPEATED if platform == "CPU" else {"Precision": "mixed"}
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform(platform), properties)
    simulation.context.setPositions(positions)
    simulation.minimizeEnergy(maxIterations=300)
    simulation.context.setVelocitiesToTemperature(TEMPERATURE, run["seed"])
    return simulation


def integrator_of(scheme: str, interval: float) -> openmm.Integrator:
    """Return an integrator with a force evaluation in an interval (ps)."""
    if scheme == "LangevinMiddle":
        return openmm.LangevinMiddleIntegrator(TEMPERATURE, FRICTION, interval)
    return rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, FRICTION, forceInterval=interval, scheme=scheme)


def step_of(run: dict[str, Any]) -> float:
    """Return the step of a run in ps."""
    return 0.001 * run["fs"] * {"W2_3m": 3, "W2_4g": 4, "S2_2": 2}.get(run["scheme"], 1)


def frames(run: dict[str, Any], platform: str, interval: float) -> Path:
    """Make the frames of a run, one in an interval (ps), from where an earlier command stopped."""
    file = OUT / "averages" / ("_".join(str(run[name]) for name in KEY) + ".csv")
    reporter = partial(rb.AverageReporter, pressure=True)
    return reported(file, simulation_of(run, platform), reporter, interval, run["ps"], PART * interval)


def row_of(run: dict[str, Any], file: Path) -> dict[str, Any]:
    """Return the row of a run with the frames in a file."""
    row = dict(run)
    for name in NAMES:
        if (name in ("potential energy", "pressure")) != (run["ensemble"] == "NVT"):
            values: tuple[float, ...] = (np.nan,) * len(PARTS)
        else:
            found = rb.corrected(file, name, pressure=1.0 if run["ensemble"] == "NPT" else None)
            values = found.mean - found.correction, found.mean, found.error, found.correction_error
            values = *values, found.systematic_error
            scale = 1.0 / run["molecules"] if name in OF_BOX else SCALES.get(name, 1.0)
            values = tuple(scale * value for value in values)
        columns = (f"{name}{part}" for part in PARTS)
        row |= dict(zip(columns, (f"{value:.6g}" for value in values), strict=True))
    values = (np.nan,) * len(OFFSET)
    if run["ensemble"] == "NVT":
        of_barostat = rb.pressure_offset(file)
        values = of_barostat.bar, of_barostat.error, np.ptp(of_barostat.bracket) / math.sqrt(12.0)
    return row | dict(zip(OFFSET, (f"{value:.6g}" for value in values), strict=True))


def runs(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the runs of a command."""
    points = itertools.product(arguments.models, arguments.masses, arguments.schemes, arguments.fs, arguments.seeds)
    for model, masses, scheme, fs, seed in points:
        run = {"model": model, "molecules": arguments.molecules, "masses": masses, "scheme": scheme, "fs": fs}
        run["ensemble"] = arguments.ensemble
        bar = 0.0 if arguments.ensemble == "NVT" else round(1.0 + (offset(run) if arguments.offset else 0.0), 1)
        yield run | {"bar": bar, "ps": arguments.ps, "seed": seed}


def offset(run: dict[str, Any]) -> float:
    """Return the mean offset (bar), weighted by the lengths, of the runs at constant volume of a point."""
    same = [row for row in RECORD.rows().values() if row["ensemble"] == "NVT" and _is_of(row, run)]
    if not same:
        raise SystemExit(f"run {run} with --ensemble NVT first, of which the offset follows")
    offsets, lengths = np.array([[float(row[name]) for name in (OFFSET[0], "ps")] for row in same]).T
    return float(np.average(offsets, weights=lengths))


def _is_of(row: Row, run: dict[str, Any]) -> bool:
    return all(row[name] == str(run[name]) for name in ("model", "masses", "scheme", "fs"))


def main() -> None:
    """Make the runs that the record has not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", default=["tip3p"], help="%(default)s")
    parser.add_argument("--masses", nargs="+", default=["heavy"], choices=["heavy", "plain"], help="%(default)s")
    parser.add_argument("--schemes", nargs="+", default=["W2_3m"], help="%(default)s")
    parser.add_argument("--fs", nargs="+", type=float, default=[4.0, 8.0], help="between two forces")
    parser.add_argument("--ensemble", default="NVT", choices=["NVT", "NPT"])
    parser.add_argument("--offset", action="store_true", help="set the barostat to 1 bar and the predicted offset")
    parser.add_argument("--ps", type=float, default=400.0, help="of a run; %(default)s")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1], help="%(default)s")
    parser.add_argument("--molecules", type=int, default=216, help="%(default)s")
    parser.add_argument("--frame", type=float, default=0.2, help="ps between two frames; %(default)s")
    parser.add_argument("--platform", default="CPU", help="%(default)s")
    arguments = parser.parse_args()
    for run in runs(arguments):
        if run not in RECORD:
            RECORD.add(row_of(run, frames(run, arguments.platform, arguments.frame)))


if __name__ == "__main__":
    main()
