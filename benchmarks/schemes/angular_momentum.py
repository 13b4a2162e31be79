"""The error of each scheme in the total angular momentum of a droplet on which no external forces act.

Drifts and kicks conserve the angular momentum to roundoff. This includes kicks by forces at displaced positions, whose
torques are computed at the original positions. The output of a processed scheme uses forces at other positions and has
an error in the angular momentum, which does not accumulate.

The droplet consists of 16 TIP3P molecules on the Reference platform. The script records the largest relative change of
the total angular momentum in three runs from different starts, with the times given by `--interval` and
`--picoseconds`. The table is written to records/angular_momentum.csv, where rows of other schemes are preserved.

    python benchmarks/schemes/angular_momentum.py
    python benchmarks/schemes/angular_momentum.py --schemes W2_5 W2_4g
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import openmm_exactrb as rb
from benchmarks.common import droplets
from benchmarks.common.records import RECORDS, read, write
from benchmarks.common.starts import context_of
from openmm_exactrb import ensemble
from openmm_exactrb.mathematics.quaternions import matrix

TABLE = RECORDS / "angular_momentum.csv"
COLUMNS = ("scheme", "force_interval_ps", "picoseconds", "starts", "change")
MOLECULES, MODEL = 16, "tip3p"


def angular_momentum(integrator: rb.ExactRigidBodyIntegrator) -> np.ndarray:
    """Return the total angular momentum, (3,)."""
    _, state = integrator.bodyState()
    spin = np.einsum("ijn,jn->i", matrix(state.q), state.m)
    return np.cross(state.R, state.P, axis=0).sum(axis=1) + spin


def change(scheme: str, interval: float, picoseconds: float, seed: int) -> float:
    """Return the largest change of the angular momentum in a run over its size; nan of a run that diverged."""
    _, system, positions = rb.rigid_water(MOLECULES, model=MODEL)
    integrator = rb.ExactRigidBodyIntegrator(forceInterval=interval, scheme=scheme, engine="host")
    _context = context_of(system, integrator, positions, "Reference")
    integrator.setBodyState(droplets.start(MOLECULES, MODEL, seed))
    start, steps, largest = angular_momentum(integrator), round(picoseconds / 10 / integrator.getStepSize()._value), 0.0
    try:
        for _ in range(10):
            integrator.step(steps)
            largest = max(largest, float(np.linalg.norm(angular_momentum(integrator) - start)))
    except rb.IntegrationError:
        return float("nan")
    return largest / float(np.linalg.norm(start))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--interval", type=float, default=0.001, metavar="PS", help="between forces (%(default)s)")
    add("--picoseconds", type=float, default=30.0, help="length of a run (%(default)s)")
    add("--schemes", nargs="+", choices=rb.SCHEMES, default=[*rb.SCHEMES], metavar="NAME")
    add("--starts", type=int, default=3)
    add("--workers", type=int, default=None)
    add("--out", type=Path, default=Path("out/angular_momentum"), metavar="FOLDER")
    args = parser.parse_args()
    seeds = range(11, 11 + args.starts)
    settings = {"interval": args.interval, "picoseconds": args.picoseconds}
    jobs = {name: [ensemble.Job(change, scheme=name, seed=seed, **settings) for seed in seeds] for name in args.schemes}
    results = ensemble.run([job for some in jobs.values() for job in some], args.out, workers=args.workers)
    values = {result.job.key: result.value for result in results}
    lines = {row["scheme"]: row for row in read(TABLE)}
    for name, some in jobs.items():
        worst = np.max([values[job.key] for job in some])  # nan if one diverged
        line = (name, args.interval, args.picoseconds, args.starts, f"{worst:.1e}")
        lines[name] = dict(zip(COLUMNS, line, strict=True))
        print(f"{name:16} {worst:.1e}")
    write(TABLE, COLUMNS, (lines[name] for name in rb.SCHEMES if name in lines))


if __name__ == "__main__":
    main()
