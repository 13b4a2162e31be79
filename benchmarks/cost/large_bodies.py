"""A large rigid body in water: the time of a step, and the effect of excluding the pairs within the body.

The body is a sphere of charged Lennard-Jones atoms, about as dense as a protein, in TIP3P. Forces within a body do not
move it, so exceptions for its pairs can remove them. The script measures force evaluations without and with these
exceptions, and steps of V2, which evaluates forces once, with the body passed as ``bodies=``. Times are medians of
alternating evaluations, in CPU time on the CPU platform with one thread. Rows are written to records/large_bodies.csv.
"""

from __future__ import annotations

import argparse
import itertools
import time
from functools import partial

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.clocks import timed
from benchmarks.common.records import RECORDS, write
from benchmarks.common.starts import ONE_THREAD, context_of

COLUMNS = (
    *("atoms", "water", "method", "forces_ms", "forces_with_exceptions_ms", "ratio"),
    *("setup_of_exceptions_s", "step_ms"),
)
SPACING, GAP = 0.2154, 0.25  # nm: 100 atoms a nm³, and the room between the sphere and the oxygens
METHODS = {"PME": openmm.NonbondedForce.PME, "reaction field": openmm.NonbondedForce.CutoffPeriodic}
BOXES = {200: 1000, 500: 1728, 1000: 2744, 2000: 4096}  # atoms, and molecules of a box without them


def sphere(atoms):
    """Return positions (atoms, 3) on a cubic lattice about the origin, and charges that add up to 0."""
    sites = np.argwhere(np.ones(3 * (24,))) - 11.5
    sites = sites[np.argsort(np.linalg.norm(sites, axis=1), kind="stable")[:atoms]]
    charges = 0.3 * (-1.0) ** np.floor(sites).sum(axis=1)
    return SPACING * sites, charges - charges.mean()


def solvated(atoms, molecules, method, *, exclude):
    """Return System, positions (nm), and the seconds that the exceptions took."""
    body, charges = sphere(atoms)
    _, water, x = rb.rigid_water(molecules, seed=1, nonbondedMethod=app.PME, nonbondedCutoff=0.9)
    edge = water.getDefaultPeriodicBoxVectors()[0][0]._value
    x = x._value.reshape(-1, 3, 3)
    x = x[np.linalg.norm(x[:, 0] - 0.5 * edge, axis=1) > np.linalg.norm(body, axis=1).max() + GAP]
    system, force = openmm.System(), openmm.NonbondedForce()
    system.setDefaultPeriodicBoxVectors(*(edge * np.eye(3)))
    force.setNonbondedMethod(method)
    force.setCutoffDistance(0.9)
    for charge in charges:
        system.addParticle(12.0)
        force.addParticle(charge, 0.2, 0.4)
    bonds = [b for b in map(water.getConstraintParameters, range(water.getNumConstraints())) if b[0] < 3]
    theirs = next(f for f in water.getForces() if isinstance(f, openmm.NonbondedForce))
    for first in range(atoms, atoms + 3 * len(x), 3):
        for k in range(3):
            system.addParticle(water.getParticleMass(k))
            force.addParticle(*theirs.getParticleParameters(k))
            i, j, length = bonds[k]
            system.addConstraint(first + i, first + j, length)
            force.addException(first + k, first + (k + 1) % 3, 0.0, 1.0, 0.0)
    begin = time.process_time()
    if exclude:
        for i, j in itertools.combinations(range(atoms), 2):
            force.addException(i, j, 0.0, 1.0, 0.0)
    seconds = time.process_time() - begin
    system.addForce(force)
    return system, np.concatenate([body + 0.5 * edge, x.reshape(-1, 3)]), seconds


def row(atoms, name, evaluations):
    """Return a row of the table."""
    contexts, seconds = [], []
    for exclude in (False, True):
        system, x, adding = solvated(atoms, BOXES[atoms], METHODS[name], exclude=exclude)
        begin = time.process_time()
        contexts.append(context_of(system, openmm.VerletIntegrator(0.001), x, properties=ONE_THREAD))
        seconds.append(adding + time.process_time() - begin)
        if not exclude:
            integrator = rb.ExactRigidBodyIntegrator(1e-4, "V2", bodies=[range(atoms)])
            _moving = context_of(system, integrator, x, properties=ONE_THREAD)
            integrator.step(2)
    times = [[], [], []]
    for _ in range(evaluations):
        for context, found in zip(contexts, times, strict=False):
            context.setPositions(x)
            found.append(1e3 * timed(partial(context.getState, forces=True)))
        times[2].append(100.0 * timed(partial(integrator.step, 10)))
    plain, excluded, step = map(np.median, times)
    numbers = plain, excluded, excluded / plain, seconds[1] - seconds[0], step
    return atoms, (len(x) - atoms) // 3, name, *(f"{x:.{n}f}" for x, n in zip(numbers, (1, 1, 2, 1, 1), strict=True))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluations", type=int, default=5, metavar="N", help="of each kind (%(default)s)")
    args = parser.parse_args()
    rows = []
    for atoms, name in itertools.product(BOXES, METHODS):
        rows.append(row(atoms, name, args.evaluations))
        print(*rows[-1], sep=",", flush=True)
    write(RECORDS / "large_bodies.csv", COLUMNS, rows)


if __name__ == "__main__":
    main()
