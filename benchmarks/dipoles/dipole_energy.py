"""Energy conservation with Ewald sums of dipoles, on a mesh and direct, scheme by scheme, and its drift.

A Stockmayer liquid (density 0.822, kT = 1.15, mu² = 3, moments of inertia 0.2) from several equilibrated starts. Both
sums have the cutoff and the tolerance that rb.Ewald() chooses for the mesh, so that they are the same model. Written
are the standard deviation of the total energy of a dipole within the first 1.2 ps, while two trajectories from one
start still are close to each other, within the first 20 ps, and within the whole run, the slope
of a line through it with its standard error from blocks, and by how much the total momentum changes, as a part of the
root mean square momentum of a dipole. Some runs on the mesh, of the first start, are longer. What the file has is not
run again.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.device.dipole_devices import DENSITY, KB, KT, MU2, REFERENCE

LONG = ("S2_2", "S6_10")
STEPS = {"S2_2": 0.004, "S6_10": 0.01, "SRKN6_14a": 0.015}  # ps
EARLY = 1.2  # ps
SAMPLE = 0.06  # ps between two energies, a multiple of all steps


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("-n", type=int, default=1000, help="number of dipoles (%(default)s)")
    add("--starts", type=int, default=3, help="%(default)s")
    add("--duration", type=float, default=20.0, help="ps (%(default)s)")
    add("--long", type=float, default=100.0, help="ps, on the mesh from the first start (%(default)s)")
    add("--csv", type=Path, default=Path("docs/dipole_energy.csv"), help="%(default)s")
    arguments = parser.parse_args()
    edge = (arguments.n / DENSITY) ** (1.0 / 3.0)
    chosen = rb.Ewald().getParameters(arguments.n, 3 * [edge])
    same = {"cutoff": chosen.cutoff, "switch": chosen.switch}
    rows = []
    if arguments.csv.exists():
        with arguments.csv.open() as file:
            rows = list(csv.DictReader(file))
    done = {(row["start"], row["sum"], row["scheme"]) for row in rows}
    for start in range(arguments.starts):
        state = equilibrated(arguments.n, start)
        for method in ("mesh", "direct"):
            for scheme, step in STEPS.items():
                if (str(start), method, scheme) in done:
                    continue
                duration = arguments.long if (method, start) == ("mesh", 0) and scheme in LONG else arguments.duration
                boundary = rb.Ewald(method=method, **same)
                row = {"n": arguments.n, "start": start, "sum": method, "scheme": scheme, "step_ps": step}
                rows.append(row | run(arguments, boundary, scheme, step, state, duration))
                print(*rows[-1].values(), sep="  ", flush=True)
                with arguments.csv.open("w", newline="") as file:  # each time: the runs are long
                    table = csv.DictWriter(file, list(rows[0]))
                    table.writeheader()
                    table.writerows(rows)


def fluid(n, seed, integrator, boundary):
    """Return a Context of the liquid on its lattice."""
    _, system, positions = rb.dipole_fluid(
        n,
        seed,
        dipole=(0.0, 0.0, MU2**0.5),
        inertia=(0.2, 0.2, 0.2),
        attraction=1.0,
        density=DENSITY,
        boundary=boundary,
    )
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    return context


def equilibrated(n, seed):
    """Return positions and velocities of the liquid after 10 ps in contact with a heat bath."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(KT / KB, 1.0, 0.01, "BAOA")
    integrator.setRandomNumberSeed(seed + 1)
    context = fluid(n, seed, integrator, rb.Ewald(tolerance=1e-3))
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    integrator.setVelocitiesToTemperature(KT / KB, seed)
    integrator.step(1000)
    return context.getState(positions=True, velocities=True)


def run(arguments, boundary, scheme, step, state, duration):
    """Return what the energy and the total momentum do in a run."""
    integrator = rb.ExactRigidBodyIntegrator(step, scheme)
    context = fluid(arguments.n, 0, integrator, boundary)
    context.setPositions(state.getPositions())
    context.setVelocities(state.getVelocities())
    masses = np.array(
        [context.getSystem().getParticleMass(i)._value for i in range(context.getSystem().getNumParticles())]
    )

    def momenta():
        velocities = context.getState(velocities=True).getVelocities(asNumpy=True)._value
        return (masses[:, None] * velocities).reshape(arguments.n, -1, 3).sum(axis=1)

    begun, energies = momenta(), [integrator.totalEnergy()._value / arguments.n]
    for _ in range(round(duration / SAMPLE)):
        integrator.step(round(SAMPLE / step))
        energies.append(integrator.totalEnergy()._value / arguments.n)
    first = energies[: round(arguments.duration / SAMPLE) + 1]
    slope, error = drift(np.array(energies))
    moved = np.linalg.norm(momenta().sum(axis=0) - begun.sum(axis=0)) / np.sqrt((begun**2).sum(axis=1).mean())
    return {
        "std_early": f"{np.std(energies[: round(EARLY / SAMPLE) + 1]):.3e}",
        "std": f"{np.std(first):.3e}",
        "ps": round(duration),
        "std_all": f"{np.std(energies):.3e}",
        "drift_a_ps": f"{slope:.1e}",
        "drift_error": f"{error:.1e}",
        "momentum": f"{moved:.1e}",
    }


def drift(energies, blocks=5):
    """Return the slope of energies in time, 1/ps, and its standard error if the means of blocks are independent."""
    times = SAMPLE * np.arange(len(energies))
    parts = np.array_split(np.arange(len(energies)), blocks)
    t, E = (np.array([values[part].mean() for part in parts]) for values in (times, energies))
    (slope, _), residuals, *_ = np.polyfit(t, E, 1, full=True)
    return slope, np.sqrt(residuals[0] / (blocks - 2) / ((t - t.mean()) ** 2).sum())


if __name__ == "__main__":
    main()
