"""Averages of a peptide in water at long steps, corrected for the step size and compared with those of a small step.

The averages are those of records/protein_steps.csv over many runs. A correction is computed from the frames of a short
run at the same settings. This script makes these runs, with the start, integrator and barostat of protein_steps.py, and
stores the corrections in a separate record. Frames are stored in out/benchmarks/corrected_steps, from which an
interrupted command continues.

    python benchmarks/proteins/corrected_steps.py
    python benchmarks/proteins/corrected_steps.py --table
"""

from __future__ import annotations

import argparse
import math
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.group_temperatures import Groups
from benchmarks.common.markdown import table, with_error
from benchmarks.common.records import OUT, RECORDS, Record
from benchmarks.common.reported import reported
from benchmarks.common.starts import simulation_of
from benchmarks.proteins import protein_steps

FRAME, PART, NEAR = 0.2, 20.0, 0.6  # ps between two frames, and between two savings; nm around the solute
POINT = ("integrator", "masses", "fs", "ensemble")
#: Integrator, masses, fs between two forces, ensemble and ps of a run.
POINTS = [
    ("W2_3m", "all", 8.0, "NVT", 500.0),
    ("W2_3m", "all", 8.0, "NPT", 500.0),
    ("W2_3m", "all", 6.0, "NVT", 300.0),
    ("W2_3m", "plain", 6.0, "NVT", 300.0),
    ("W2_3m", "all", 4.0, "NVT", 200.0),
    ("W2_3m", "all", 4.0, "NPT", 200.0),
    ("LangevinMiddle", "all", 2.0, "NVT", 100.0),
    ("LangevinMiddle", "all", 2.0, "NPT", 100.0),
]
OF_ALL = {"solute": "peptide", "constraints": "HBonds", "friction": "5.0"}
AVERAGES = ("U", *protein_steps.KINDS, "density", "pressure")
#: Averages of the table.
LABELS = {"U": "U (kJ/mol per water)", "density": "density (kg/m³)"}
HELD = {"NVT": "constant volume", "NPT": "1 bar"}
#: Integrators and fs of the table, as they are or corrected.
SHOWN = [("LangevinMiddle", "2.0", False), ("W2_3m", "8.0", False), ("W2_3m", "8.0", True), ("W2_3m", "4.0", True)]
COLUMNS = [f"{name}{part}" for name in AVERAGES for part in ("", " error")]
RECORD = Record(RECORDS / "corrected_steps.csv", (*POINT, "ps", "seed"), COLUMNS)


class Kind:
    """The energy (kJ/mol) of one kind of bonded force, as a function of the positions."""

    def __init__(self, system: openmm.System, kind: type[openmm.Force]) -> None:
        alone = protein_steps.bonded(system, [kind])
        platform = openmm.Platform.getPlatform("Reference")
        self._context = openmm.Context(alone, openmm.VerletIntegrator(0.001), platform)

    def __call__(self, x: np.ndarray) -> float:
        """Return it for positions (n, 3) in nm."""
        self._context.setPositions(x)
        energy: float = self._context.getState(energy=True).getPotentialEnergy()._value
        return energy


def frames(run: dict[str, Any]) -> Path:
    """Make the frames of a run, from where an earlier command stopped."""
    topology, system, _ = protein_steps.molecules(None, run["masses"], OF_ALL["constraints"])
    mover = protein_steps.integrator_of(run["integrator"], 0.001 * run["fs"], OF_ALL["friction"])
    mover.setRandomNumberSeed(run["seed"])
    if run["ensemble"] == "NPT":
        step = mover.getStepSize()._value
        system = protein_steps.pressed(system, max(1, round(protein_steps.BAROSTAT / step)), run["seed"])
    simulation = simulation_of(topology, system, mover, protein_steps.start_of(None))
    simulation.context.applyConstraints(1e-9)
    simulation.context.setVelocitiesToTemperature(protein_steps.TEMPERATURE, run["seed"])
    kinds = {name: Kind(system, kind) for name, kind in protein_steps.KINDS.items()}
    solute = [atom.index for atom in topology.atoms() if atom.residue.name != "HOH"]
    reporter = partial(rb.AverageReporter, pressure=True, observables=kinds, around=(solute, NEAR))
    file = OUT / "corrected_steps" / ("_".join(str(run[name]) for name in RECORD.key) + ".csv")
    return reported(file, simulation, reporter, FRAME, run["ps"], PART)


def row_of(run: dict[str, Any]) -> dict[str, Any]:
    """Return the corrections of a run: U per molecule of water, as in records/protein_steps.csv."""
    file, row = frames(run), dict(run)
    per = {"U": len(Groups(*protein_steps.molecules(None, run["masses"], OF_ALL["constraints"])[:2]).water)}
    for name in AVERAGES:
        values = math.nan, math.nan
        if name != {"NVT": "density", "NPT": "pressure"}[run["ensemble"]]:
            observable = "potential energy" if name == "U" else name
            found = rb.corrected(file, observable, local=name in protein_steps.KINDS)
            values = found.correction / per.get(name, 1), found.correction_error / per.get(name, 1)
        row |= dict(zip((name, f"{name} error"), (f"{value:.4g}" for value in values), strict=True))
    return row


def corrected_steps() -> str:
    """Return the averages of records/protein_steps.csv, as they are and corrected, as a table of a page."""
    known = {(row["integrator"], row["masses"], row["fs"], row["ensemble"]): row for row in RECORD.rows().values()}
    runs, body = [*protein_steps.record_of(RECORDS / "protein_steps.csv").rows().values()], []
    for (ensemble, held), name in product(HELD.items(), LABELS):
        cells = []
        for integrator, fs, corrected in SHOWN:
            row = known.get((integrator, "all", fs, ensemble))
            if row is not None and math.isfinite(float(row[name])):
                same = {column: row[column] for column in POINT} | OF_ALL
                some = [run for run in runs if all(run[column] == value for column, value in same.items())]
                values = np.array([float(run[name]) for run in some])
                mean, error = values.mean(), values.std(ddof=1) / math.sqrt(len(values))
                if corrected:
                    mean, error = mean + float(row[name]), math.hypot(error, float(row[f"{name} error"]))
                cells.append(with_error(mean, error, max(0, 1 - math.floor(math.log10(error)))))
        if len(cells) == len(SHOWN):
            body.append([f"{LABELS[name]}, {held}", *cells])
    head = (f"`{name}`, {float(fs):g} fs{', corrected' * corrected}" for name, fs, corrected in SHOWN)
    return table(("", *head), body)


def main() -> None:
    """Make the runs that the record has not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", nargs="+", type=int, default=range(len(POINTS)), help="of the list; all")
    parser.add_argument("--seed", type=int, default=101, help="%(default)s")
    parser.add_argument("--table", action="store_true", help="print the table of the record only")
    arguments = parser.parse_args()
    if not arguments.table:
        for point in arguments.points:
            run = dict(zip((*POINT, "ps"), POINTS[point], strict=True)) | {"seed": arguments.seed}
            if run not in RECORD:
                RECORD.add(row_of(run))
    print(corrected_steps())


if __name__ == "__main__":
    main()
