"""The energy error of 125 dipoles with three schemes and with OpenMM, at about equal numbers of force evaluations.

The droplet and its initial states are those of examples/dipole_fluid.py, on the Reference platform. The error is the
standard deviation of the total energy over 20 ps, relative to its mean. The largest deviation, which short collisions
determine, would depend on the times at which energies are read. Results are written to records/dipole_droplet.csv.

    python benchmarks/dipoles/dipole_droplet.py
"""

from __future__ import annotations

import argparse
import itertools
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.energies import along
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, ROOT, Record
from benchmarks.common.starts import context_of

EXAMPLE = SimpleNamespace(**runpy.run_path(str(ROOT / "examples" / "dipole_fluid.py")))
DIPOLES, KT = 125, 0.1  # kJ/mol
DURATION, LOOK = 20.0, 0.08  # ps of a run, and between two looks, a whole number of steps of each scheme
#: Schemes and rotors; the last integrator is OpenMM's, which keeps dipoles rigid by constraints.
METHODS = (("W4_4", "exact"), ("SRKN4_6b", "exact"), ("V2", "mclachlan_reich"), ("VerletIntegrator", "constraints"))
INTERVAL = 0.02 / 6  # mean time between two force evaluations in ps
RUN, FOUND = ("seed", "scheme", "rotor", "step"), ("forces", "relative_std")


def row(seed: int, scheme: str, rotor: str) -> dict[str, str]:
    """Return a row of the record."""
    ours = scheme in rb.SCHEMES
    step = rb.SCHEMES[scheme].forces * INTERVAL if ours else INTERVAL
    _, system, positions = rb.dipole_fluid(DIPOLES, seed, trap=EXAMPLE.TRAP)
    integrator = rb.ExactRigidBodyIntegrator(step, **({"scheme": scheme, "rotor": rotor} if ours else {}))
    context = context_of(system, integrator, positions, "Reference")
    context.setVelocitiesToTemperature(KT / EXAMPLE.KB, seed + 1)
    if not ours:
        start = context.getState(positions=True, velocities=True)
        context = context_of(system, openmm.VerletIntegrator(step), start, "Reference")
    energies, _ = along(context, DURATION, LOOK)
    forces = integrator.timings.evaluations if ours else context.getStepCount()
    error = np.std(energies) / abs(np.mean(energies))
    found = f"{seed}", scheme, rotor, f"{step:.6g}", f"{forces}", f"{error:.2e}"
    return dict(zip((*RUN, *FOUND), found, strict=True)) | of_run(context)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--starts", type=int, default=3, help="%(default)s")
    add("--record", type=Path, default=RECORDS / "dipole_droplet.csv", metavar="CSV", help="%(default)s")
    args = parser.parse_args()
    record = Record(args.record, RUN, (*FOUND, *OF_RUN))
    for (scheme, rotor), seed in itertools.product(METHODS, range(args.starts)):
        record.add(row(seed, scheme, rotor))


if __name__ == "__main__":
    main()
