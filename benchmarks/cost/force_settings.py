"""The cost of a switch and a tight Ewald tolerance: steps of VerletIntegrator, compared with OpenMM's defaults.

The boxes are of TIP3P with PME, as in water/water_boxes.py, on the CPU platform with one thread. Each row of
records/force_settings.csv is the median and the quartiles of the ratios of processor times in rounds in which the
settings alternate on one core.

    python benchmarks/cost/force_settings.py
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.clocks import QUARTILES, in_turns, on_one_core, quartiles
from benchmarks.common.provenance import OF_RUN, PROVENANCE, of_run, provenance
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import canonical, context_of, put, thermostat

DEFAULTS, SMOOTH = "defaults", "switch and tolerance 1e-5"
SETTINGS = {
    DEFAULTS: {},
    "switch": {"switchDistance": 0.75},
    "tolerance 1e-5": {"ewaldErrorTolerance": 1e-5},
    SMOOTH: {"switchDistance": 0.75, "ewaldErrorTolerance": 1e-5},
}
RECORD = Record(RECORDS / "force_settings.csv", ("molecules", "settings"), (*QUARTILES, *OF_RUN, PROVENANCE[-1]))


def water(molecules: int, integrator: openmm.Integrator, settings: str) -> openmm.Context:
    """Return a box of water on a lattice."""
    options = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.85} | SETTINGS[settings]
    _, system, positions = rb.rigid_water(molecules, **options)
    return context_of(system, integrator, positions)


def measure(molecules: int, rounds: int, steps: int) -> None:
    """Add the rows of a box."""
    (start,) = canonical(water(molecules, thermostat(), SMOOTH), 1_000)
    contexts = {name: water(molecules, openmm.VerletIntegrator(0.002), name) for name in SETTINGS}
    for context in contexts.values():
        put(context, start)
        context.getIntegrator().step(steps)
    times = in_turns({name: partial(c.getIntegrator().step, steps) for name, c in contexts.items()}, rounds)
    for name, context in contexts.items():
        ratios = quartiles(np.array(times[name]) / times[DEFAULTS])
        RECORD.add({"molecules": molecules, "settings": name, **ratios, **provenance(), **of_run(context)})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--molecules", type=int, nargs="+", default=[216, 895], metavar="N", help="%(default)s")
    parser.add_argument("--rounds", type=int, default=21, help="%(default)s")
    parser.add_argument("--steps", type=int, default=50, help="of a round (%(default)s)")
    args = parser.parse_args()
    on_one_core()
    for molecules in args.molecules:
        measure(molecules, args.rounds, args.steps)


if __name__ == "__main__":
    main()
