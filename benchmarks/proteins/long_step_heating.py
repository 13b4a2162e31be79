"""The rate at which long steps heat a protein in water: the energy gain of Langevin integrators without friction.

Modes of the solute that are in resonance with the kicks of the nonbonded forces gain energy, which a thermostat
removes. With a friction g, a solute of n degrees of freedom is hotter than the thermostat by P/(n k g), where P is the
power. All hydrogens have 3 amu, and bonded forces have inner steps. For each start, the script prints the slope of the
total energy over 3 ps, and adds the slope to records/long_step_heating.csv unless the record contains the run.

    python benchmarks/proteins/long_step_heating.py --pdb villin.pdb
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
import openmm
from openmm import app

from benchmarks.common.energies import along
from benchmarks.common.group_temperatures import Groups
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import simulation_of
from benchmarks.proteins import protein_steps

TABLE = RECORDS / "long_step_heating.csv"
RUN = ("solute", "freedom", "scheme", "fs", "start")
PICOSECONDS, LOOKED, APART = 3.0, 0.07, 0.5  # ps of a run, between two looks, and between two starts


def starts(topology: app.Topology, system: openmm.System, begin: openmm.State, n: int) -> list[openmm.State]:
    """Return canonical States."""
    integrator = protein_steps.integrator_of("W2_3m", 0.004, "5.0")
    integrator.setRandomNumberSeed(1)
    run = simulation_of(topology, system, integrator, begin)
    run.context.applyConstraints(1e-9)
    run.context.setVelocitiesToTemperature(protein_steps.TEMPERATURE, 1)
    step, found = integrator.getStepSize()._value, []
    for picoseconds in (4.0, *[APART] * (n - 1)):
        run.step(round(picoseconds / step))
        found.append(run.context.getState(positions=True, velocities=True))
    return found


def power(topology: app.Topology, system: openmm.System, start: openmm.State, name: str, fs: float) -> dict[str, str]:
    """Return the slope of the total energy in kJ/mol/ps, and where it comes from."""
    integrator = protein_steps.integrator_of(name, 0.001 * fs, "0.0")
    context = simulation_of(topology, system, integrator, start).context
    energies, interval = along(context, PICOSECONDS, LOOKED)
    slope = np.polyfit(interval * np.arange(len(energies)), energies, 1)[0]
    return {"kJ/mol/ps": f"{slope:.4g}"} | of_run(context)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pdb", type=Path, help="a solvated protein, instead of alanine dipeptide")
    parser.add_argument("--schemes", nargs="+", default=["W2_3m", "V2"], help="%(default)s")
    parser.add_argument("--fs", nargs="+", type=float, default=[6.0, 7.0, 8.0, 9.0, 10.0], help="between two forces")
    parser.add_argument("--starts", type=int, default=6)
    parser.add_argument("--record", type=Path, default=TABLE, metavar="CSV", help="%(default)s")
    args = parser.parse_args()
    record = Record(args.record, RUN, ("kJ/mol/ps", *OF_RUN))
    topology, system, _ = protein_steps.molecules(args.pdb, "all", "HBonds")
    solute = "peptide" if args.pdb is None else args.pdb.stem
    freedom = f"{Groups(topology, system).freedom}"
    begins = starts(topology, system, protein_steps.start_of(args.pdb), args.starts)
    for scheme, fs, number in itertools.product(args.schemes, args.fs, range(args.starts)):
        point = dict(zip(RUN, (solute, freedom, scheme, f"{fs:g}", number + 1), strict=True))
        if point not in record:
            record.add(point | power(topology, system, begins[number], scheme, fs))


if __name__ == "__main__":
    main()
