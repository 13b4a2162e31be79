"""What a switch and a tight Ewald tolerance cost, and what they let an integrator bring.

A box of TIP3P with PME (CPU platform, one thread): the standard deviation of the total energy of Verlet and W4_4
at the same time between force evaluations, without and with `switchDistance`, at OpenMM's default `ewaldErrorTolerance`
and a tight one; and the processor time of a force evaluation over that with the defaults, the least of rounds in which
the settings take turns. Each run is one job of an ensemble: what has finished is not run again.

    python benchmarks/water/energy_floor.py
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb import ensemble

VERLET, INTERVAL, SAMPLED, TEMPERATURE = "Verlet", 0.002, 0.1, 300.0  # ps, ps, K
SETTINGS = {
    "defaults": {},
    "a switch": {"switchDistance": 0.75},
    "tolerance 1e-5": {"ewaldErrorTolerance": 1e-5},
    "both": {"switchDistance": 0.75, "ewaldErrorTolerance": 1e-5},
}


def context_of(molecules: int, setting: str, integrator: openmm.Integrator) -> tuple[openmm.Context, list]:
    """Return a Context that gives the same numbers at every run, and positions."""
    options = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.85} | SETTINGS[setting]
    _, system, positions = rb.rigid_water(molecules, **options)
    threads = {"Threads": "1", "DeterministicForces": "true"}
    return openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"), threads), positions


def start_of(molecules: int, seed: int) -> openmm.State:
    """Return water that has forgotten its lattice."""
    integrator = openmm.LangevinMiddleIntegrator(TEMPERATURE, 5.0, 0.002)
    integrator.setRandomNumberSeed(seed)
    context, positions = context_of(molecules, "both", integrator)
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    context.setVelocitiesToTemperature(TEMPERATURE, seed)
    integrator.step(2_500)
    return context.getState(positions=True, velocities=True)


def deviation(setting: str, method: str, molecules: int, picoseconds: float, seed: int) -> float:
    """Run water and return the standard deviation of its total energy in kJ/mol."""
    if method == VERLET:
        integrator = openmm.VerletIntegrator(INTERVAL)
        integrator.setConstraintTolerance(1e-8)
    else:
        integrator = rb.ExactRigidBodyIntegrator(forceInterval=INTERVAL, scheme=method)
    start = start_of(molecules, seed)
    context, _ = context_of(molecules, setting, integrator)
    context.setPeriodicBoxVectors(*start.getPeriodicBoxVectors())
    context.setPositions(start.getPositions())
    context.setVelocities(start.getVelocities())
    if method == VERLET:
        context.applyVelocityConstraints(1e-8)
    every, energies = max(1, round(SAMPLED / integrator.getStepSize()._value)), []
    for _ in range(round(picoseconds / SAMPLED)):
        integrator.step(every)
        state = context.getState(energy=True)  # of Verlet with the kinetic energy at the time of the positions
        energies.append((state.getPotentialEnergy() + state.getKineticEnergy())._value)
    return float(np.std(energies))


def costs(molecules: int, rounds: int) -> dict[str, float]:
    """Return the processor time of a force evaluation over that with the defaults."""
    contexts = {}
    for setting in SETTINGS:
        contexts[setting], positions = context_of(molecules, setting, openmm.VerletIntegrator(INTERVAL))
        contexts[setting].setPositions(positions)
        openmm.LocalEnergyMinimizer.minimize(contexts[setting], 100.0)
    times: dict[str, list[float]] = {setting: [] for setting in SETTINGS}
    for _ in range(rounds):
        for setting, context in contexts.items():
            begun = time.process_time()
            context.getIntegrator().step(50)
            times[setting].append(time.process_time() - begun)
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
