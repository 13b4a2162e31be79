"""Energy fluctuation and drift of several schemes with an Ewald sum of dipoles, direct or on a mesh.

The system is a Stockmayer liquid (density 0.822, kT = 1.15, mu² = 3, moments of inertia 0.2), from several equilibrated
starts. Both sums have the cutoff and the tolerance that rb.Ewald() chooses for the mesh, so that they define the same
model. The script records the standard deviation of the total energy per dipole within the first 1.2 ps, during which
two trajectories from one start are close to each other, within the first 20 ps, and within the whole run. It also
records the slope of a line through the energy, with a standard error from blocks, and the change of the total momentum
relative to the root mean square momentum of a dipole. Some runs on the mesh from the first start are longer. Runs that
the file contains are not repeated.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import masses_of, put
from benchmarks.common.stockmayer import KELVIN, edge_of, fluid

RUN = ("n", "start", "sum", "scheme", "step_ps")
FOUND = ("std_early", "std", "ps", "std_all", "drift_a_ps", "drift_error", "momentum")

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
    add("--csv", type=Path, default=RECORDS / "dipole_energy.csv", help="%(default)s")
    arguments = parser.parse_args()
    chosen = rb.Ewald().getParameters(arguments.n, 3 * [edge_of(arguments.n)])
    same = {"cutoff": chosen.cutoff, "switch": chosen.switch}
    record = Record(arguments.csv, RUN, FOUND)
    for start in range(arguments.starts):
        state = equilibrated(arguments.n, start)
        for method, (scheme, step) in itertools.product(("mesh", "direct"), STEPS.items()):
            point = {"n": arguments.n, "start": start, "sum": method, "scheme": scheme, "step_ps": step}
            if point in record:
                continue
            duration = arguments.long if (method, start) == ("mesh", 0) and scheme in LONG else arguments.duration
            context = fluid(arguments.n, rb.ExactRigidBodyIntegrator(step, scheme), rb.Ewald(method=method, **same))
            put(context, state)
            record.add(point | run(context, arguments, duration))


def equilibrated(n, seed):
    """Return positions and velocities of the liquid after 10 ps in contact with a heat bath."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(KELVIN, 1.0, 0.01, "BAOA")
    integrator.setRandomNumberSeed(seed + 1)
    context = fluid(n, integrator, rb.Ewald(tolerance=1e-3), seed=seed)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    integrator.setVelocitiesToTemperature(KELVIN, seed)
    integrator.step(1000)
    return context.getState(positions=True, velocities=True)


def run(context, arguments, duration):
    """Return what the energy and the total momentum do in a run."""
    integrator, masses = context.getIntegrator(), masses_of(context.getSystem())
    step = integrator.getStepSize()._value

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
