"""The acceptance rate of hybrid Monte Carlo for rigid water in a PME box, for several schemes and steps.

A box of TIP3P at 300 K runs on the CPU platform, with proposals of one step of the scheme and a friction of 5/ps. The
record, records/acceptance.csv, contains the fraction of accepted proposals with its error, and the force evaluations
per proposal. --quick prints these numbers for 216 molecules and few proposals.
"""

from __future__ import annotations

import argparse

import numpy as np
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import canonical, context_of, thermostat

SETTINGS = (("V2", 3.0), ("S2_2", 3.0), ("S2_2", 4.0), ("S2_2", 6.0), ("W2_4", 4.0), ("W4_5", 2.0))  # fs per force
RECORD = Record(
    RECORDS / "acceptance.csv", ("molecules", "scheme", "fs"), ("proposals", "accepted", "error", "forces_per_proposal")
)


def main() -> None:
    parser = argparse.ArgumentParser(description="Acceptance of hybrid Monte Carlo for rigid water.")
    parser.add_argument("--quick", action="store_true", help="a smaller box, fewer proposals")
    parser.add_argument("--molecules", type=int, default=887, help="%(default)s")
    parser.add_argument("--proposals", type=int, default=2000, help="%(default)s")
    parser.add_argument("--equilibration", type=int, default=10_000, help="steps of 2 fs before (%(default)s)")
    args = parser.parse_args()
    n, proposals, steps = (216, 100, 1000) if args.quick else (args.molecules, args.proposals, args.equilibration)
    _, system, positions = rb.rigid_water(
        n, nonbondedMethod=app.PME, nonbondedCutoff=0.8, switchDistance=0.7, ewaldErrorTolerance=1e-5
    )
    (start,) = canonical(context_of(system, thermostat(), positions), steps)
    print(f"{n} TIP3P, {proposals} proposals each")
    for scheme, interval in SETTINGS:
        row: dict[str, object] = {"molecules": n, "scheme": scheme, "fs": interval}
        if not args.quick and row in RECORD:
            continue
        h = 0.001 * interval * rb.SCHEMES[scheme].stages
        integrator = rb.ExactRigidBodyHybridIntegrator(300.0, 5.0, h, scheme=scheme)
        integrator.setRandomNumberSeed(1)
        _context = context_of(system, integrator, start)
        integrator.step(proposals)
        rate = integrator.acceptanceRate()
        error = np.sqrt(rate * (1.0 - rate) / proposals)
        forces = f"{integrator.timings.evaluations / proposals:.2f}"
        row |= {
            "proposals": proposals,
            "accepted": f"{rate:.3f}",
            "error": f"{error:.3f}",
            "forces_per_proposal": forces,
        }
        if args.quick:
            print(*row.values(), sep="  ", flush=True)
        else:
            RECORD.add(row)


if __name__ == "__main__":
    main()
