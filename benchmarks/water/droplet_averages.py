"""Corrected averages of small droplets at long steps, compared with averages that have no step-size error.

The system contains 32 distant droplets of 8 TIP3P molecules, each in a harmonic well, at 298.15 K and 5/ps. Force
evaluations are so cheap that the step-size error is many times the statistical error, which is not feasible for a
liquid on a CPU. The exact averages are those of generalised hybrid Monte Carlo. Cutoffs are longer than the diameter of
a droplet, so that no pair crosses them. Frames are stored in out/benchmarks/droplet_averages, from which an interrupted
command continues.

    python benchmarks/water/droplet_averages.py --ns 5 --seeds 1 2
    python benchmarks/water/droplet_averages.py --table
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.markdown import table, with_error
from benchmarks.common.records import OUT, RECORDS, Record, Row
from benchmarks.common.reported import error_over_runs, reported
from benchmarks.common.starts import REPEATED
from openmm_exactrb.averages.record import read

TEMPERATURE, FRICTION, MOLECULES, DROPLETS, APART, WELL, CUTOFF = 298.15, 5.0, 8, 32, 6.0, 500.0, 2.5
FRAME, PART = 0.24, 24.0  # ps between two frames, and between two savings
#: Integrator, scheme, time between two forces (fs), mass of a hydrogen (Da).
POINTS = [
    ("Langevin", "W2_3m", 8.0, 3.0),
    ("Langevin", "BAOA", 8.0, 3.0),
    ("hybrid", "S2_2", 4.0, 3.0),
    ("Langevin", "W2_3m", 4.0, 1.0),
    ("Langevin", "BAOA", 4.0, 1.0),
    ("LangevinMiddle", "", 4.0, 1.0),
    ("LangevinMiddle", "", 2.0, 1.0),
    ("Langevin", "W2_3m", 5.0, 3.0),
]
KEY = ("integrator", "scheme", "fs", "hydrogen", "ns", "seed")
COLUMNS = ("energy", "energy error", "corrected", "corrected error", "correction error", "systematic error")
RECORD = Record(RECORDS / "droplet_averages.csv", KEY, COLUMNS)


def droplets(hydrogen: float) -> tuple[app.Topology, openmm.System, np.ndarray]:
    """Return the droplets, on a cubic lattice."""
    topology, system, positions = rb.rigid_water(MOLECULES * DROPLETS)
    if hydrogen > 1.0:
        rb.heavy_hydrogens(system, topology, hydrogen)
    own = np.asarray(positions.value_in_unit(openmm.unit.nanometer)).reshape(-1, 3, 3)
    small = rb.rigid_water(MOLECULES)[2].value_in_unit(openmm.unit.nanometer)
    small = np.asarray(small) - np.mean(small, axis=0)
    side = math.ceil(DROPLETS ** (1.0 / 3.0))
    centres = APART * np.array(list(np.ndindex(side, side, side)), dtype=float)[:DROPLETS]
    well = openmm.CustomExternalForce(f"{0.5 * WELL}*((x-x0)^2+(y-y0)^2+(z-z0)^2)")
    for name in "x0", "y0", "z0":
        well.addPerParticleParameter(name)
    for molecule in range(len(own)):
        well.addParticle(3 * molecule, centres[molecule // MOLECULES])
    system.addForce(well)
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    force.setNonbondedMethod(openmm.NonbondedForce.CutoffNonPeriodic)
    force.setCutoffDistance(CUTOFF)
    return topology, system, (centres[:, None] + small).reshape(-1, 3)


def integrator_of(run: dict[str, Any]) -> openmm.Integrator:
    """Return the integrator of a run."""
    interval = 0.001 * run["fs"]
    if run["integrator"] == "LangevinMiddle":
        return openmm.LangevinMiddleIntegrator(TEMPERATURE, FRICTION, interval)
    kinds = {"hybrid": rb.ExactRigidBodyHybridIntegrator, "Langevin": rb.ExactRigidBodyLangevinIntegrator}
    return kinds[run["integrator"]](TEMPERATURE, FRICTION, forceInterval=interval, scheme=run["scheme"])


def simulation_of(run: dict[str, Any]) -> app.Simulation:
    """Return the minimised start of a run."""
    topology, system, positions = droplets(run["hydrogen"])
    integrator = integrator_of(run)
    integrator.setRandomNumberSeed(run["seed"])
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("CPU"), REPEATED)
    simulation.context.setPositions(positions)
    simulation.minimizeEnergy(maxIterations=300)
    simulation.context.setVelocitiesToTemperature(TEMPERATURE, run["seed"])
    return simulation


class EnergyOnly:
    """Write the potential energy, for hybrid Monte Carlo: its averages have no step-size error."""

    def __init__(self, file: Path, interval: int, append: bool) -> None:
        self.interval, self.out = interval, file.open("a" if append else "w", encoding="utf-8")

    def describeNextReport(self, simulation: app.Simulation) -> dict[str, Any]:
        """Return when the next report is due."""
        return {"steps": self.interval - simulation.currentStep % self.interval, "include": ["energy"]}

    def report(self, simulation: app.Simulation, state: openmm.State) -> None:
        """Write a line."""
        self.out.write(f"{state.getPotentialEnergy()._value!r}\n")
        self.out.flush()

    def close(self) -> None:
        """Close the file."""
        self.out.close()


def frames(run: dict[str, Any]) -> Path:
    """Make the frames of a run, from where an earlier command stopped."""
    file = OUT / "droplet_averages" / ("_".join(str(run[name]) for name in KEY) + ".csv")
    kind = EnergyOnly if run["integrator"] == "hybrid" else rb.AverageReporter
    return reported(file, simulation_of(run), kind, FRAME, 1000.0 * run["ns"], PART)


def row_of(run: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a run, per molecule."""
    file = frames(run)
    if run["integrator"] != "hybrid":
        found = rb.corrected(file, "potential energy")
        energies = read(file)[1]["potential"]
        after = found.mean, found.error, found.correction_error, found.systematic_error
    else:
        energies, after = np.loadtxt(file), (np.nan,) * 4
    error = np.std([part.mean() for part in np.array_split(energies, 20)], ddof=1) / math.sqrt(20.0)
    values = (f"{value / MOLECULES / DROPLETS:.6g}" for value in (energies.mean(), error, *after))
    return run | dict(zip(COLUMNS, values, strict=True))


def droplet_averages() -> str:
    """Return the means over seeds as a table of a page."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in RECORD.rows().values():
        groups.setdefault(tuple(row[name] for name in KEY[:4]), []).append(row)
    body = []
    for (integrator, scheme, fs, hydrogen), rows in groups.items():
        values = np.array([[float(row[name]) for name in COLUMNS] for row in rows])
        lengths = np.array([float(row["ns"]) for row in rows])
        weights = lengths / lengths.sum()
        energy, _, after, *_ = weights @ values
        error = math.sqrt(weights**2 @ values[:, 1] ** 2)
        of_after, of_correction = (error_over_runs(weights, values[:, k], values[:, -1]) for k in (3, 4))
        cells = ["", ""]
        if math.isfinite(after):
            cells = [with_error(after, of_after, 4), with_error(after - energy, of_correction, 4)]
        name = "hybrid Monte Carlo" if integrator == "hybrid" else f"`{scheme or integrator}`"
        plain = with_error(energy, error, 4)
        body.append([name, f"{float(fs):g}", f"{float(hydrogen):g}", plain, *cells, f"{lengths.sum():g}"])
    return table(("", "fs per force evaluation", "hydrogen (Da)", "as it is", "corrected", "correction", "ns"), body)


def main() -> None:
    """Make the runs that the record has not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", nargs="+", type=int, default=range(len(POINTS)), help="of the list; all")
    parser.add_argument("--ns", type=float, default=1.0, help="of a run; %(default)s")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1], help="%(default)s")
    parser.add_argument("--table", action="store_true", help="print the table of the record only")
    arguments = parser.parse_args()
    if not arguments.table:
        for seed in arguments.seeds:
            for point in arguments.points:
                run = dict(zip(KEY, (*POINTS[point], arguments.ns, seed), strict=True))
                if run not in RECORD:
                    RECORD.add(row_of(run))
    print(droplet_averages())


if __name__ == "__main__":
    main()
