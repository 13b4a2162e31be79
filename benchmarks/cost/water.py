"""The time of a step of rigid water compared with that of force evaluations and Verlet, and the integrator's own time.

For 895 molecules with PME on the CPU platform, the script measures the wall time of a force evaluation within our step,
in a loop of setPositions and getState(forces), and in VerletIntegrator.step. Without any force, it measures the time
and memory per molecule of the integrator alone, for 100 to 20 000 molecules. Raw data are written to
out/benchmarks/water_*.csv; --quick makes a short run.
"""

from __future__ import annotations

import argparse
import itertools
import time
import tracemalloc

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common import records
from benchmarks.common.starts import canonical, context_of, thermostat


def box(quick):
    """Print the cost of our step beside bare force evaluations and VerletIntegrator.step."""
    _, system, positions = rb.rigid_water(895, nonbondedMethod=app.PME, nonbondedCutoff=0.9, switchDistance=0.8)
    warm = context_of(system, thermostat(step=0.001), positions, properties={})
    (start,) = canonical(warm, 400 if quick else 2200)
    rows = []
    for scheme in ("S2_2", "S2_3", "SRKN4_6b"):
        stages = rb.SCHEMES[scheme].stages
        ours = rb.ExactRigidBodyIntegrator(0.002 * stages, scheme=scheme)
        verlet = openmm.VerletIntegrator(0.002)
        context, beside = (context_of(system, integrator, start, properties={}) for integrator in (ours, verlet))
        for one in (context, beside):
            one.getIntegrator().step(2)
        steps = max(2, 24 // stages)
        series = []
        for _ in range(5 if quick else 15):
            path = stage_positions(context, ours, steps, stages)
            times = [time.perf_counter()]
            for x in path[:-1]:
                context.setPositions(x)
                context.getState(forces=True).getForces(asNumpy=True)
            times.append(time.perf_counter())
            context.setPositions(path[-1])
            before = ours.timings.evaluations
            ours.step(steps)
            evaluations = ours.timings.evaluations - before
            times.append(time.perf_counter())
            verlet.step(steps * stages)
            times.append(time.perf_counter())
            bare, mine, theirs = np.diff(times)
            series.append((bare / (steps * stages), mine / evaluations, theirs / (steps * stages)))
        bare, mine, theirs = np.median(series, axis=0)
        ratios = np.median([(s[1] / s[0], s[1] / s[2]) for s in series], axis=0)
        rows.append((scheme, bare, mine, theirs))
        print(
            f"{scheme:>9}, an evaluation: bare {1e3 * bare:.2f} ms, ours {1e3 * mine:.2f}, Verlet {1e3 * theirs:.2f}; "
            f"ours/bare {ratios[0]:.3f}, ours/Verlet {ratios[1]:.3f}"
        )
    records.write(records.OUT / "water_box.csv", ("scheme", "bare_force_s", "ours_s", "verlet_s"), rows)


def stage_positions(context, integrator, steps, stages):
    """Move the context and return positions as they change from stage to stage, so that neighbour lists age alike."""
    ends = []
    for step in range(steps + 1):
        integrator.step(min(step, 1))
        ends.append(context.getState(positions=True).getPositions(asNumpy=True)._value.copy())
    parts = np.arange(stages) / stages
    return [a + part * (b - a) for a, b in itertools.pairwise(ends) for part in parts] + [ends[-1]]


def scaling(quick):
    """Print the integrator's own cost a molecule, without any force."""
    rows = []
    for n in (100, 1000, 5000) if quick else (100, 1000, 5000, 20000):
        _, system, positions = rb.rigid_water(n)
        while system.getNumForces():
            system.removeForce(0)
        integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_2", engine="host")
        _context = context_of(system, integrator, positions, "Reference")
        tracemalloc.start()
        integrator.setVelocitiesToTemperature(300.0, 1)
        integrator.step(1)
        kept, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        steps = 20
        times = []
        for _ in range(5):
            integrator.timings.reset()
            integrator.step(steps)
            own = integrator.timings.total - integrator.timings.forces
            times.append(own / (steps * 2 * n))
        rows.append((n, min(times), kept / n, peak / n))
        memory = f"{kept / n:.0f} B kept, {peak / n:.0f} B at most"
        print(f"{n:6d} molecules: {1e6 * min(times):.2f} us a molecule and stage, {memory} a molecule")
    columns = "molecules", "own_s_a_molecule_and_stage", "kept_bytes", "peak_bytes"
    records.write(records.OUT / "water_scaling.csv", columns, rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="short runs")
    args = parser.parse_args()
    box(args.quick)
    scaling(args.quick)


if __name__ == "__main__":
    main()
