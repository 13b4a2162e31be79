"""The cost of a switch and a tight Ewald tolerance, and the energy error of integrators with and without them.

For a box of TIP3P with PME (CPU platform, one thread), the script measures the standard deviation of the total energy
of Verlet and W4_4 at the same time between force evaluations, without and with `switchDistance`, at OpenMM's default
`ewaldErrorTolerance` and a tight one. It also measures the processor time of a force evaluation relative to that with
the defaults, the smallest over rounds in which the settings alternate. Each run is a job of an ensemble; finished runs
are not repeated.

    python benchmarks/water/energy_floor.py
"""

from __future__ import annotations

import argparse
import itertools
from functools import partial
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common import starts
from benchmarks.common.clocks import in_turns
from benchmarks.common.energies import along
from openmm_exactrb import ensemble

VERLET, INTERVAL, SAMPLED = "Verlet", 0.002, 0.1  # ps
SETTINGS = {
    "defaults": {},
    "a switch": {"switchDistance": 0.75},
    "tolerance 1e-5": {"ewaldErrorTolerance": 1e-5},
    "both": {"switchDistance": 0.75, "ewaldErrorTolerance": 1e-5},
}


def context_of(molecules: int, setting: str, integrator: openmm.Integrator) -> openmm.Context:
    """Return water on a lattice."""
    options = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.85} | SETTINGS[setting]
    _, system, positions = rb.rigid_water(molecules, **options)
    return starts.context_of(system, integrator, positions)


def deviation(setting: str, method: str, molecules: int, picoseconds: float, seed: int) -> float:
    """Run water and return the standard deviation of its total energy in kJ/mol."""
    if method == VERLET:
        integrator = openmm.VerletIntegrator(INTERVAL)
        integrator.setConstraintTolerance(1e-8)
    else:
        integrator = rb.ExactRigidBodyIntegrator(forceInterval=INTERVAL, scheme=method)
    (start,) = starts.canonical(context_of(molecules, "both", starts.thermostat(seed=seed)), 2_500, seed=seed)
    context = context_of(molecules, setting, integrator)
    starts.put(context, start)
    if method == VERLET:  # whose States have the kinetic energy at the time of the positions
        context.applyVelocityConstraints(1e-8)
    return float(np.std(along(context, picoseconds, SAMPLED)[0]))


def costs(molecules: int, rounds: int) -> dict[str, float]:
    """Return the processor time of a force evaluation over that with the defaults."""
    contexts = {setting: context_of(molecules, setting, openmm.VerletIntegrator(INTERVAL)) for setting in SETTINGS}
    for context in contexts.values():
        openmm.LocalEnergyMinimizer.minimize(context, 100.0)
    runs = {setting: partial(context.getIntegrator().step, 50) for setting, context in contexts.items()}
    times = in_turns(runs, rounds)
    return {setting: min(some) / min(times["defaults"]) for setting, some in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--molecules", type=int, default=216)
    add("--picoseconds", type=float, default=10.0, help="length of a run (%(default)s)")
    add("--seeds", type=int, nargs="+", default=[1])
    add("--rounds", type=int, default=7, help="of timing (%(default)s)")
    add("--workers", type=int, default=None)
    add("--out", type=Path, default=Path("out/energy_floor"), metavar="FOLDER")
    args = parser.parse_args()
    jobs = {}
    for setting, method, seed in itertools.product(SETTINGS, (VERLET, "W4_4"), args.seeds):
        some = {"molecules": args.molecules, "picoseconds": args.picoseconds, "seed": seed}
        jobs[setting, method, seed] = ensemble.Job(deviation, setting=setting, method=method, **some)
    results = ensemble.run(list(jobs.values()), args.out, workers=args.workers)
    values = {result.job.key: result.value for result in results}
    cost = costs(args.molecules, args.rounds)
    print(f"{args.molecules} TIP3P, {args.picoseconds:g} ps, {len(args.seeds)} starts: kJ/mol, and time of a force")
    for setting in SETTINGS:
        methods = {method: [values[jobs[setting, method, seed].key] for seed in args.seeds] for _, method, _ in jobs}
        means = (f"{method} {np.sqrt(np.mean(np.square(some))):.2g}" for method, some in methods.items())
        print(f"{setting:16}", *means, f"time {cost[setting]:.2f}")


if __name__ == "__main__":
    main()
