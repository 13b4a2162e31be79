"""The separate effects of the exact rotor and of the splitting: schemes with two rotors on water at several steps.

Each seed defines one start of a droplet of 27 TIP3P molecules, from which runs last 10 ps. Runs are jobs of
`openmm_exactrb.ensemble`, so that an interrupted command can be resumed. Errors of each start are written to
records/exactness.csv.
"""

from __future__ import annotations

import argparse

import numpy as np

import openmm_exactrb as rb
from benchmarks.common.energies import along
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import canonical, context_of, thermostat

RATES = (500, 1000, 2000)
SCHEMES = ("V2", "W2_1", "W4_4", "W4_5")
ROTORS = ("mclachlan_reich", "exact")
RECORD = Record(RECORDS / "exactness.csv", ("scheme", "rotor", "forces_per_ps", "ps", "seed"), ("std",))


def error(scheme, rotor, rate, seed, n=27, duration=2.0, platform="Reference"):
    """Return the standard deviation of the total energy in kJ/mol per molecule; a job.

    Parameters
    ----------
    scheme, rotor : str
    rate : float
        Forces per ps.
    seed : int
        Of the Langevin run that makes the start.
    n : int
        Molecules.
    duration : float
        In ps.
    platform : str
    """
    _, system, positions = rb.rigid_water(n)
    warm = context_of(system, thermostat(seed=seed), positions, platform)
    (state,) = canonical(warm, 2000, seed=seed)
    h = rb.SCHEMES[scheme].forces / rate
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, rotor=rotor)
    energies, _ = along(context_of(system, integrator, state, platform), duration, 0.1)
    deviation = float(np.std(energies)) / n if np.isfinite(energies).all() else np.inf
    return deviation if deviation < 1.0 else None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--schemes", nargs="+", default=SCHEMES)
    parser.add_argument("--rates", nargs="+", type=int, default=RATES, help="force evaluations per ps")
    parser.add_argument("--seeds", type=int, default=2, help="starts (%(default)s)")
    parser.add_argument("--picoseconds", type=float, default=10.0, help="length of a run (%(default)s)")
    parser.add_argument("--folder", default="out/exactness", help="where results are kept")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    axes = {"seed": range(args.seeds), "rate": args.rates, "scheme": args.schemes, "rotor": ROTORS}
    jobs = rb.ensemble.sweep(error, axes, duration=args.picoseconds)
    for result in rb.ensemble.as_completed(jobs, args.folder, workers=args.workers):
        of = result.job.arguments
        key = of["scheme"], of["rotor"], of["rate"], args.picoseconds, of["seed"]
        std = "unstable" if result.value is None else f"{result.value:.3g}"
        RECORD.add(dict(zip(RECORD.columns, (*key, std), strict=True)))


if __name__ == "__main__":
    main()
