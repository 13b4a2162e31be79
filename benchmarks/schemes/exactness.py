"""What the exact rotor brings and what the splitting: schemes with either rotor on water at four rates of forces.

One start of a droplet of 27 TIP3P molecules for each seed, runs of 10 ps. Through `openmm_exactrb.ensemble`: a call
goes on where the last one stopped. Prints the table of docs/explanation/splittings.md.
"""

from __future__ import annotations

import argparse

import numpy as np

import openmm_exactrb as rb
from benchmarks.common.energies import along
from benchmarks.common.starts import canonical, context_of, thermostat

RATES = (250, 500, 1000, 2000)
SCHEMES = ("V2", "W2_1", "W2_5", "W4_4", "W4_5", "SRKN4_6b")
ROTORS = ("mclachlan_reich", "exact")


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
    parser.add_argument("--seeds", type=int, default=3, help="starts")
    parser.add_argument("--picoseconds", type=float, default=10.0, help="length of a run")
    parser.add_argument("--folder", default="out/exactness", help="where results are kept")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    axes = {"scheme": SCHEMES, "rotor": ROTORS, "rate": RATES, "seed": range(args.seeds)}
    results = rb.ensemble.run(
        rb.ensemble.sweep(error, axes, duration=args.picoseconds), args.folder, workers=args.workers
    )
    found = {}
    for result in results:
        scheme, rotor, rate, _ = (result.job.arguments[name] for name in axes)
        found.setdefault((scheme, rotor, rate), []).append(result.value)
    print("| scheme | rotor | " + " | ".join(f"{rate} per ps" for rate in RATES) + " |")
    print("| --- " * (2 + len(RATES)) + "|")
    for scheme in SCHEMES:
        for rotor in ROTORS:
            cells = [cell(found[scheme, rotor, rate]) for rate in RATES]
            print(f"| `{scheme}` | {rotor} | " + " | ".join(cells) + " |")


def cell(errors):
    """Return the root mean square of errors as text."""
    return "unstable" if None in errors else f"{np.sqrt(np.mean(np.square(errors))):.1e}"


if __name__ == "__main__":
    main()
