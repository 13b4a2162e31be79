"""The time of a whole step on the host compared with that of its force evaluations alone, measured alternately.

The loop of force evaluations calls setPositions and getState(forces). Raw data are written to
out/benchmarks/step_cost.csv.
"""

from __future__ import annotations

import time

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.records import OUT, write


def main():
    rows = []
    print("    scheme             rotor     N  bare force (ms)  stage (ms)   ratio   rotor    rest")
    for n in (27, 125):
        for scheme in ("V2", "SRKN4_6b", "S6_10"):
            for rotor in ("exact", "rotation", "dmv10", "mclachlan_reich"):
                rows.append((scheme, rotor, n, *measure(n, scheme, rotor)))
                bare, stage, turning = rows[-1][3:]
                print(
                    f"{scheme:>10}{rotor:>18}{n:>6}{1e3 * bare:>17.3f}{1e3 * stage:>12.3f}{stage / bare:>8.3f}"
                    f"{turning / bare:>8.3f}{(stage - bare - turning) / bare:>8.3f}"
                )
    write(OUT / "step_cost.csv", ("scheme", "rotor", "N", "bare_force_s", "stage_s", "rotor_s"), rows)


def measure(n, scheme, rotor):
    """Return seconds of a bare force evaluation, of a stage, and of its rotor: medians over alternating series."""
    topology, system, positions = rb.dipole_fluid(n, trap=0.5)
    integrator = rb.ExactRigidBodyIntegrator(0.02, scheme=scheme, rotor=rotor, engine="host")
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    context = simulation.context
    context.setPositions(positions)
    context.setVelocitiesToTemperature(60.0, 1)
    simulation.step(2)
    stages = rb.SCHEMES[scheme].stages
    steps = max(1, 60 // stages)
    series = []
    for _ in range(11):
        x = context.getState(positions=True).getPositions(asNumpy=True)._value.copy()
        start = time.perf_counter()
        for _ in range(steps * stages):
            context.setPositions(x)
            context.getState(forces=True).getForces(asNumpy=True)
        middle = time.perf_counter()
        integrator.timings.reset()
        integrator.step(steps)
        end = time.perf_counter()
        series.append(np.array([middle - start, end - middle, integrator.timings.rotor]) / (steps * stages))
    return np.median(series, axis=0)


if __name__ == "__main__":
    main()
