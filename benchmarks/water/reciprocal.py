"""The reciprocal part of PME in the outer steps only, with all other forces in inner steps.

OpenMM can assign the reciprocal part of an Ewald sum to a separate force group, and `fast=` can integrate the other
groups in inner steps. For rigid TIP3P in a periodic box on the Reference platform, the script measures the standard
deviation of the total energy within runs, and compares it with that of the plain scheme with as many evaluations of all
forces. The cost of each method per ps is computed from the times of an evaluation of the direct part and of the
reciprocal part. Rows are written to records/reciprocal.csv, errors in kJ/mol per molecule.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.energies import noise
from benchmarks.common.provenance import OF_RUN, PROVENANCE, of_run, provenance
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import context_of
from benchmarks.water.droplet import equilibrated

RECIPROCAL = 1
#: Name, outer scheme and reciprocal evaluations per ps, inner scheme and direct evaluations per ps.
METHODS = (
    ("W2_4", "W2_4", 300, None, 300),
    ("W2_4", "W2_4", 400, None, 400),
    ("W2_4", "W2_4", 600, None, 600),
    ("W2_4 in W2_4", "W2_4", 150, "W2_4", 750),
    ("S2_2 in S2_2", "S2_2", 150, "S2_2", 500),
    ("S2_2 in S2_2", "S2_2", 300, "S2_2", 1000),
)
FOUND = "molecules", "starts", "direct_per_ps", "std", "s_per_ps"
RECORD = Record(RECORDS / "reciprocal.csv", ("method", "reciprocal_per_ps"), (*FOUND, *OF_RUN, PROVENANCE[-1]))


def box(molecules):
    """Return System, with the reciprocal part in a group of its own, and positions (nm)."""
    _, system, positions = rb.rigid_water(
        molecules, nonbondedMethod=app.PME, nonbondedCutoff=0.7, switchDistance=0.6, ewaldErrorTolerance=1e-5
    )
    (nonbonded,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    nonbonded.setReciprocalSpaceForceGroup(RECIPROCAL)
    return system, np.array(positions.value_in_unit(unit.nanometer))


def integrator_of(outer, reciprocal, inner, direct):
    """Return an integrator with so many evaluations of each part per ps."""
    scheme = rb.SCHEMES[outer]
    if inner is None:
        return rb.ExactRigidBodyIntegrator(scheme.forces / direct, scheme=outer)
    steps = round(direct / reciprocal * scheme.forces / rb.SCHEMES[inner].stages)
    return rb.ExactRigidBodyIntegrator(scheme.forces / reciprocal, outer, fast=(0,), inner=inner, innerSteps=steps)


def seconds(system, x, rounds=20):
    """Return the processor times of an evaluation of the direct and of the reciprocal part."""
    context = context_of(system, openmm.VerletIntegrator(0.001), x, "Reference")
    times = []
    for groups in ({0}, {RECIPROCAL}):
        context.getState(forces=True, groups=groups)
        begun = time.process_time()
        for _ in range(rounds):
            context.getState(forces=True, groups=groups)
        times.append((time.process_time() - begun) / rounds)
    return times


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--molecules", type=int, default=125, metavar="N", help="%(default)s")
    parser.add_argument("--starts", type=int, default=3, metavar="N", help="%(default)s")
    parser.add_argument("--duration", type=float, default=2.0, metavar="PS", help="of each run (%(default)s)")
    args = parser.parse_args()
    system, x = box(args.molecules)
    starts = equilibrated(system, x, 10.0, args.starts, "CPU")
    direct_cost, reciprocal_cost = seconds(system, starts[0][0])
    print(f"an evaluation takes {1e3 * direct_cost:.2g} ms (direct) and {1e3 * reciprocal_cost:.2g} ms (reciprocal)")
    for name, outer, reciprocal, inner, direct in METHODS:
        integrator = integrator_of(outer, reciprocal, inner, direct)
        context = context_of(system, integrator, platform="Reference")
        spread = noise(context, starts, args.duration)[-1] / args.molecules
        timings = integrator.timings
        made = reciprocal * timings.fast_evaluations / timings.evaluations if inner else direct
        cost = made * direct_cost + reciprocal * reciprocal_cost
        found = args.molecules, args.starts, f"{made:.0f}", f"{spread:.2g}", f"{cost:.3g}"
        row = {"method": name, "reciprocal_per_ps": reciprocal} | dict(zip(FOUND, found, strict=True))
        RECORD.add(row | provenance() | of_run(context))


if __name__ == "__main__":
    main()
