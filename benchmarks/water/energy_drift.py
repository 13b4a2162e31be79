"""The energy of a periodic box of TIP3P over 300 ps: how far it moves from its start, and which setting moves it.

The box has PME, as in water_boxes.py: each start is drawn from the canonical distribution on the CPU platform, and all
methods share it. A row of records/energy_drift.csv is one run: the standard deviation of the total energy per molecule
within windows of 2 to 300 ps, and the slope of a line through it. Runs that the record contains are not repeated. The
energies of a run are kept in out/energy_drift.

--direct makes the direct sum more precise than --tolerance and leaves the mesh as it is: the terms of pairs at the
cutoff become smaller, at the same cost. --width is that of the switch.

    python benchmarks/water/energy_drift.py --methods W4_4 W2_1 Verlet
    python benchmarks/water/energy_drift.py --molecules 64 --cutoff 0.6 --picoseconds 50 --methods W4_4 --fs 1 2
    python benchmarks/water/energy_drift.py --molecules 64 --cutoff 0.6 --picoseconds 50 --methods W4_4 --direct 1e-8
"""

from __future__ import annotations

import argparse
import itertools
import math
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.energies import along, variance
from benchmarks.common.provenance import of_run
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import canonical, context_of, put, thermostat

OUT = Path("out/energy_drift")
VERLET = "Verlet"
WINDOWS = (2, 10, 30, 100, 300)  # ps
SAMPLED = 0.1  # ps
RUN = ("molecules", "method", "fs", "cutoff", "width", "tolerance", "direct", "platform", "picoseconds", "start")
MEASURED = (*(f"std_{window}_ps" for window in WINDOWS), "drift_a_ns")


def water(integrator: openmm.Integrator, point: dict) -> openmm.Context:
    """Return a box of TIP3P with the settings of a point."""
    cutoff, tolerance = point["cutoff"], point["tolerance"]
    _, system, positions = rb.rigid_water(
        point["molecules"],
        nonbondedMethod=app.PME,
        nonbondedCutoff=cutoff,
        switchDistance=round(cutoff - point["width"], 6),
        ewaldErrorTolerance=tolerance,
    )
    if point["direct"] != tolerance:
        (force,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
        # As OpenMM chooses them.
        splitting, of_mesh = (math.sqrt(-math.log(2.0 * error)) / cutoff for error in (point["direct"], tolerance))
        edge = system.getDefaultPeriodicBoxVectors()[0][0]._value
        force.setPMEParameters(splitting, *3 * [math.ceil(2.0 * of_mesh * edge / (3.0 * tolerance**0.2))])
    return context_of(system, integrator, positions, platform=point["platform"])


def integrator_of(method: str, fs: float) -> openmm.Integrator:
    """Return what evaluates the forces every so many fs."""
    if method != VERLET:
        return rb.ExactRigidBodyIntegrator(rb.SCHEMES[method].forces * 0.001 * fs, scheme=method)
    integrator = openmm.VerletIntegrator(0.001 * fs)
    integrator.setConstraintTolerance(1e-8)
    return integrator


def energies_of(point: dict) -> tuple[np.ndarray, float, dict[str, str]]:
    """Return the total energies of a run in kJ/mol per molecule, how many ps apart, and where they come from."""
    usual = point | {"direct": point["tolerance"], "platform": "CPU"}
    (start,) = canonical(water(thermostat(seed=point["start"]), usual), 2_500, seed=point["start"])
    context = water(integrator_of(point["method"], point["fs"]), point)
    put(context, start)
    energies, interval = along(context, point["picoseconds"], SAMPLED)
    return energies / point["molecules"], interval, of_run(context)


def measured(energies: np.ndarray, interval: float) -> dict[str, str]:
    """Return the standard deviations within windows that fit into a run, and the slope per ns."""
    length = len(energies) * interval
    stds = (
        math.sqrt(variance(energies, interval, window)) if window < 1.01 * length else math.nan for window in WINDOWS
    )
    finite = np.isfinite(energies).all()
    slope = np.polyfit(interval * np.arange(len(energies)), energies, 1)[0] if finite else math.nan
    return {name: f"{value:.4g}" for name, value in zip(MEASURED, (*stds, 1000.0 * slope), strict=True)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--molecules", type=int, default=216)
    add("--methods", nargs="+", default=["W4_4"], help="schemes, or Verlet (%(default)s)")
    add("--fs", nargs="+", type=float, default=[2.0], help="between two force evaluations (%(default)s)")
    add("--cutoff", type=float, default=0.85, metavar="NM", help="%(default)s")
    add("--width", type=float, default=0.1, metavar="NM", help="from the switch distance to the cutoff (%(default)s)")
    add("--tolerance", type=float, default=1e-5, help="ewaldErrorTolerance (%(default)s)")
    add("--direct", type=float, help="that of the direct sum alone; the same unless given")
    add("--platform", default="CPU", help="of double precision: Reference (%(default)s)")
    add("--starts", type=int, nargs="+", default=[1, 2, 3], help="their seeds (%(default)s)")
    add("--picoseconds", type=float, default=300.0, help="length of a run (%(default)s)")
    add("--record", type=Path, default=RECORDS / "energy_drift.csv", metavar="CSV", help="%(default)s")
    args = parser.parse_args()
    record = Record(args.record, RUN, (*MEASURED, "engine", "openmm", "commit"))
    fixed = {"molecules": args.molecules, "cutoff": args.cutoff, "width": args.width, "tolerance": args.tolerance}
    fixed |= {"direct": args.direct or args.tolerance, "platform": args.platform, "picoseconds": args.picoseconds}
    OUT.mkdir(parents=True, exist_ok=True)
    for start, method, fs in itertools.product(args.starts, args.methods, args.fs):
        point = fixed | {"method": method, "fs": fs, "start": start}
        if point in record:
            continue
        energies, interval, origin = energies_of(point)
        np.save(OUT / ("_".join(record.key_of(point)) + ".npy"), energies)
        record.add(origin | point | measured(energies, interval))


if __name__ == "__main__":
    main()
