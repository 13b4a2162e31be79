"""How many proposals of hybrid Monte Carlo are taken: rigid water in a PME box, over schemes and steps.

A box of TIP3P at 300 K on the CPU platform, one step of the scheme a proposal and a friction of 5/ps. Printed are the
time a force evaluation, the part of the proposals that were taken with its error, and the force evaluations that a
proposal cost. --quick takes 216 molecules and few proposals.
"""

from __future__ import annotations

import argparse

import numpy as np
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.starts import canonical, context_of, thermostat

SETTINGS = (("V2", 3.0), ("S2_2", 3.0), ("S2_2", 4.0), ("S2_2", 6.0), ("W2_4", 4.0), ("W4_5", 2.0))  # fs per force


def main() -> None:
    parser = argparse.ArgumentParser(description="Acceptance of hybrid Monte Carlo for rigid water.")
    parser.add_argument("--quick", action="store_true", help="a smaller box, fewer proposals")
    parser.add_argument("--proposals", type=int, default=2000, help="%(default)s")
    parser.add_argument("--equilibration", type=int, default=10_000, help="steps of 2 fs before (%(default)s)")
    args = parser.parse_args()
    n, proposals, steps = (216, 100, 1000) if args.quick else (887, args.proposals, args.equilibration)
    _, system, positions = rb.rigid_water(
        n, nonbondedMethod=app.PME, nonbondedCutoff=0.8, switchDistance=0.7, ewaldErrorTolerance=1e-5
    )
    (start,) = canonical(context_of(system, thermostat(), positions), steps)
    print(f"{n} TIP3P, {proposals} proposals each")
    for scheme, interval in SETTINGS:
        h = 0.001 * interval * rb.SCHEMES[scheme].stages
        integrator = rb.ExactRigidBodyHybridIntegrator(300.0, 5.0, h, scheme=scheme)
        integrator.setRandomNumberSeed(1)
        _context = context_of(system, integrator, start)
        integrator.step(proposals)
        rate = integrator.acceptanceRate()
        error = np.sqrt(rate * (1.0 - rate) / proposals)
        cost = integrator.timings.evaluations / proposals
        print(
            f"{scheme:5} {interval:g} fs per force: {rate:.3f} +- {error:.3f}, {cost:.2f} forces a proposal", flush=True
        )


if __name__ == "__main__":
    main()
