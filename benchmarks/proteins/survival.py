"""Do runs of a protein at one force evaluation every 8 fs survive, and what do they give? Runs that can go on for days.

The systems, starts and temperatures are those of protein_steps.py, at constant volume with a friction of 5/ps. All
settings advance in turns, a part of a run at a time, so that all of them are equally long whenever the command is
stopped. Every run is an `rb.Run` in a folder: the same command continues it from its last checkpoint, with its random
numbers, and a larger --picoseconds makes it longer. A run that fails is not repeated, and counts.

After every part, records/protein_survival.csv contains the means over each run so far, without its first 4 ps, with
errors from ten blocks, and whether the run has failed. RMSD is that of the C-alpha atoms from the start.

    python benchmarks/proteins/survival.py runs/peptide --seeds 1 2 3 --picoseconds 50
    python benchmarks/proteins/survival.py runs/villin --pdb villin.pdb --picoseconds 2000
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common import records
from benchmarks.common.group_temperatures import Groups
from benchmarks.common.provenance import commit
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import positions_and_velocities, simulation_of
from benchmarks.proteins.protein_steps import (
    BURN,
    KINDS,
    OPENMM,
    TEMPERATURE,
    integrator_of,
    molecules,
    start_of,
)

#: Integrator, fs between two force evaluations, hydrogens of 3 amu, constraints.
SETTINGS = {
    "BAOA": ("BAOA", 8.0, "all", "HBonds"),
    "W2_3m": ("W2_3m", 8.0, "all", "HBonds"),
    "AllBonds": ("LangevinMiddle", 8.0, "all", "AllBonds"),
    "4fs": ("LangevinMiddle", 4.0, "solute", "HBonds"),
    "2fs": ("LangevinMiddle", 2.0, "all", "HBonds"),
}
FRICTION = "5.0"
SAMPLED, BLOCKS = 0.24, 10  # ps between two samples, a whole number of steps of every setting; blocks of a run
FREE = ("T_tr", "T_rot", "T_solute", "T_rot reported", "T_solute reported", "U", *KINDS, "rest", "RMSD")
RUN = ("solute", "integrator", "fs", "masses", "constraints", "seed")
FAILED = "failed"  # a file, with the reason


class Samples:
    """A reporter of temperatures (K), energies and the RMSD (nm) as a table, with the processor time in s."""

    def __init__(self, file: str, interval: int, append: bool, groups: Groups, start: np.ndarray, core: list[int]):
        self._interval, self._groups, self._core = interval, groups, core
        self._start = start[core]
        self._out = Path(file).open("a" if append else "w", encoding="utf-8")  # noqa: SIM115 - which the run closes
        if not append:
            print("ps", *(name.replace(" ", "_") for name in FREE), "processor", sep=",", file=self._out)

    def describeNextReport(self, simulation: app.Simulation) -> dict:
        """Return when, and what a State must contain."""
        steps = self._interval - simulation.currentStep % self._interval
        return {"steps": steps, "periodic": False, "include": ["positions", "velocities", "energy"]}

    def report(self, simulation: app.Simulation, state: openmm.State) -> None:
        """Write a line; NonFiniteError if it is not finite."""
        x, v = positions_and_velocities(state)
        total = state.getPotentialEnergy()._value
        found = self._groups(x, v) | {"U": total / len(self._groups.water)}
        for group, kind in enumerate(KINDS, 1):
            part = simulation.context.getState(energy=True, groups=1 << group)
            found[kind] = part.getPotentialEnergy()._value
        found["rest"] = total - sum(found[kind] for kind in KINDS)
        found["RMSD"] = rmsd(x[self._core], self._start) if self._core else math.nan
        if not np.isfinite([found[name] for name in FREE[:-1]]).all():
            raise rb.NonFiniteError("a temperature or an energy is not finite")
        values = (state.getTime()._value, *(found[name] for name in FREE), time.process_time())
        print(*(f"{value:.8g}" for value in values), sep=",", file=self._out)


def rmsd(x: np.ndarray, y: np.ndarray) -> float:
    """Return the root mean square distance of two sets of places (n, 3), one of them moved onto the other."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    u, s, w = np.linalg.svd(x.T @ y)
    s[-1] *= np.sign(np.linalg.det(u @ w))
    return math.sqrt(max(0.0, ((x * x).sum() + (y * y).sum() - 2.0 * s.sum()) / len(x)))


class Course:
    """A run of one setting: it advances in parts, and returns what it has found so far."""

    def __init__(self, folder: Path, pdb: Path | None, setting: str, seed: int) -> None:
        self.integrator, self.fs, self.masses, self.constraints = SETTINGS[setting]
        self.row = {"solute": "peptide" if pdb is None else pdb.stem, "integrator": self.integrator, "fs": self.fs}
        self.row |= {"masses": self.masses, "constraints": self.constraints, "seed": seed}
        self.folder, self.pdb, self.seed = folder / f"{setting}_{seed}", pdb, seed
        self.failure, self.made = self.folder / FAILED, None

    @property
    def failed(self) -> bool:
        """Whether it has failed, in this command or an earlier one."""
        return self.failure.exists()

    def advance(self, picoseconds: float) -> None:
        """Advance to a time; a failure is noted in the folder."""
        try:
            run, simulation = self.made = self.made or self.make()
            run.advance(simulation, round(picoseconds / simulation.integrator.getStepSize()._value))
        except (openmm.OpenMMException, rb.IntegrationError, np.linalg.LinAlgError) as error:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.failure.write_text(f"{type(error).__name__}: {error}\n", encoding="utf-8")

    def make(self) -> tuple[rb.Run, app.Simulation]:
        """Return the run and its Simulation in its initial state."""
        topology, system, _ = molecules(self.pdb, self.masses, self.constraints)
        mover = integrator_of(self.integrator, 0.001 * self.fs, FRICTION)
        mover.setRandomNumberSeed(self.seed)
        start = start_of(self.pdb)
        simulation = simulation_of(topology, system, mover, start)
        simulation.context.setTime(0.0)
        simulation.context.applyConstraints(1e-9)
        simulation.context.setVelocitiesToTemperature(TEMPERATURE, self.seed)
        core = [atom.index for atom in topology.atoms() if atom.name == "CA" and atom.residue.name != "HOH"]
        of = Groups(topology, system), positions_and_velocities(start)[0], core if len(core) > 3 else []

        def samples(file: str, interval: int, append: bool = False) -> Samples:
            return Samples(file, interval, append, *of)

        run = rb.Run(self.folder, resume=True)
        run.add_reporter(samples, "samples.csv", round(SAMPLED / mover.getStepSize()._value))
        return run, simulation

    def found(self) -> dict[str, object]:
        """Return the row of the record: means and errors of the run so far."""
        rows = records.read(self.folder / "samples.csv")
        ps = max((float(row["ps"]) for row in rows), default=0.0)
        rows = [row for row in rows if float(row["ps"]) > BURN]
        values = {"picoseconds": f"{ps:.6g}", "failed": "yes" if self.failed else "no", "samples": len(rows)}
        for name in FREE:
            some = np.array([float(row[name.replace(" ", "_")]) for row in rows])
            blocks = [block.mean() for block in np.array_split(some, BLOCKS)] if len(some) >= 2 * BLOCKS else []
            values[name] = f"{some.mean():.7g}" if len(some) else "nan"
            values[f"{name} error"] = f"{np.std(blocks, ddof=1) / math.sqrt(BLOCKS):.3g}" if blocks else "nan"
        taken = np.diff([float(row["processor"]) for row in rows])
        taken = taken[taken > 0.0]  # not where a process began
        values["ms"] = f"{np.median(taken) * self.fs / SAMPLED:.4g}" if len(taken) else "nan"
        engine = "" if self.integrator in OPENMM else "host"
        origin = {"engine": engine, "platform": "CPU", "openmm": openmm.__version__, "commit": commit()}
        return self.row | values | origin


COLUMNS = ("picoseconds", "failed", "samples", *(f"{n}{e}" for n in FREE for e in ("", " error")), "ms")
COLUMNS = (*COLUMNS, "engine", "platform", "openmm", "commit")


def in_turns(courses: list[Course], ends: list[float], tell: Callable[[dict], object]) -> None:
    """Advance all runs to each of the times, one after another."""
    for until, course in itertools.product(ends, courses):
        before = float(course.found()["picoseconds"])
        if not course.failed and before < until - SAMPLED:
            course.advance(until)
            tell(course.found())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("folder", type=Path, help="of the runs")
    add("--pdb", type=Path, help="a solvated protein, instead of alanine dipeptide")
    add("--settings", nargs="+", choices=SETTINGS, default=[*SETTINGS], help="%(default)s")
    add("--seeds", nargs="+", type=int, default=[1], help="%(default)s")
    add("--picoseconds", type=float, default=100.0, help="length of a run (%(default)s)")
    add("--part", type=float, default=4.8, metavar="PS", help="of a run before the next one's turn (%(default)s)")
    add("--record", type=Path, default=RECORDS / "protein_survival.csv", metavar="CSV", help="%(default)s")
    args = parser.parse_args()
    record = Record(args.record, RUN, COLUMNS)
    courses = [Course(args.folder, args.pdb, *of) for of in itertools.product(args.settings, args.seeds)]
    parts = math.ceil(args.picoseconds / args.part)
    in_turns(courses, [min(k * args.part, args.picoseconds) for k in range(1, parts + 1)], record.add)


if __name__ == "__main__":
    main()
