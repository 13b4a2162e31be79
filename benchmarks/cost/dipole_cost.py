"""The time of a force evaluation and of a stage of S6_10 for N soft dipoles: OpenMM's formula, our kernel, LAMMPS.

The candidates are measured alternately within one run. The smallest time over the rounds is used, because other
processes can only increase the times. OpenMM's formula is omitted from N = 4000 on, where an evaluation takes seconds,
and the eight million bonds take gigabytes. If LAMMPS is installed, it runs on one core with pair_style
lj/cut/dipole/cut 60, open boundaries and fix nve/sphere update dipole; each of its steps is one force evaluation. Raw
data are written to out/benchmarks/dipole_cost.json.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from functools import partial
from importlib.metadata import version

import numba
import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common import lammps_peer
from benchmarks.common.clocks import in_turns
from benchmarks.common.records import keep
from benchmarks.common.stockmayer import arrows
from openmm_exactrb.potentials.compiled import pairs

STAGES = rb.SCHEMES["S6_10"].stages
# Force evaluations a round and rounds.
SIZES = {125: (300, 15), 250: (200, 10), 500: (100, 10), 1000: (50, 10), 2000: (20, 5), 4000: (10, 5)}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, nargs="*", choices=SIZES, default=[125, 1000, 4000], help="numbers of dipoles")
    rounds = {n: measure(n, *SIZES[n]) for n in parser.parse_args().n}
    machine = {
        "processor": platform.processor() or platform.machine(),
        "vectors": str(numba.config.CPU_NAME or numba.core.codegen.ll.get_host_cpu_name()),
        "threads": numba.config.NUMBA_NUM_THREADS,
        "cores": os.cpu_count(),
        **{name: version(name) for name in ("numba", "openmm", "lammps") if name != "lammps" or lammps_peer.INSTALLED},
    }
    keep("dipole_cost.json", {"machine": machine, "rounds_s": rounds})
    report(rounds)


def measure(n, evaluations, rounds):
    """Return the seconds of one evaluation of every contender, round by round."""
    contenders = {"pair kernel, all cores": kernel(n), "pair kernel, one core": kernel(n, threads=1)}
    for name in ("openmm", "compiled")[n >= 4000 :]:
        context, integrator = simulation(n, name)
        contenders[f"{name}: force"] = bare_force(context)
        contenders[f"{name}: stage"] = stage(integrator)
    if lammps_peer.INSTALLED:
        contenders["LAMMPS: step"] = lammps_step(n)
    return seconds_of(contenders, evaluations, rounds)


def seconds_of(contenders, evaluations, rounds):
    """Return the seconds of one evaluation, round by round; the formula on the processor gets fewer."""
    counts = {
        name: STAGES * max(1, evaluations // (10 * STAGES)) if name.startswith("openmm") else evaluations
        for name in contenders
    }
    times = in_turns({name: partial(run, counts[name]) for name, run in contenders.items()}, rounds, time.perf_counter)
    return {name: [seconds / counts[name] for seconds in some] for name, some in times.items()}


def simulation(n, kernel):
    """Return the Context and the integrator of a droplet."""
    topology, system, positions = rb.dipole_fluid(n, trap=0.5, kernel=kernel)
    integrator = rb.ExactRigidBodyIntegrator(0.01, scheme="S6_10", engine="host")
    run = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    run.context.setPositions(positions)
    run.context.setVelocitiesToTemperature(12.0, 1)
    run.step(1)
    return run.context, integrator


def bare_force(context):
    x = context.getState(positions=True).getPositions(asNumpy=True)._value.copy()

    def run(evaluations):
        for _ in range(evaluations):
            context.setPositions(x)
            context.getState(forces=True).getForces(asNumpy=True)

    return run


def stage(integrator):
    return lambda evaluations: integrator.step(evaluations // STAGES)


def places(n):
    """Return centres and unit dipoles of a droplet."""
    _, _, positions = rb.dipole_fluid(n, kernel="compiled")
    return arrows(positions._value, n)


def kernel(n, threads=None):
    """Return the pair sum alone."""
    centres, dipoles = places(n)
    x = np.stack([centres, centres + 0.5 * dipoles], axis=1).reshape(-1, 3)

    def run(evaluations):
        for _ in range(evaluations):
            pairs.soft_dipoles(x, 4.0, 8.0, threads=threads)

    run(1)
    return run


def lammps_step(n):
    """Return LAMMPS's step for the same start; its potential has the attraction -(sigma/r)^6 too, at the same cost."""
    centres, directions = places(n)
    lmp = lammps_peer.dipoles(
        centres,
        2.0**0.5 * directions,
        """
        pair_style lj/cut/dipole/cut 60
        pair_coeff * * 1.0 1.0
        """,
    )
    lmp.commands_string(
        """
        velocity all create 0.1 1
        fix motion all nve/sphere update dipole
        timestep 0.005
        run 10
        """
    )
    return lambda evaluations: lmp.command(f"run {evaluations} pre no post no")


def report(rounds):
    """Print the table: least times in ms, and what they are beside LAMMPS."""
    for n, rows in rounds.items():
        best = {name: min(times) for name, times in rows.items()}
        print(f"\nN = {n:<6}{'ms':>22}{'of a LAMMPS step':>20}")
        for name, seconds in best.items():
            ratio = f"{seconds / best['LAMMPS: step']:20.3f}" if "LAMMPS: step" in best else ""
            print(f"  {name:<26}{1e3 * seconds:>6.3f}{ratio}")
        print(f"  {1e9 * best['pair kernel, one core'] / n**2:.2f} ns an evaluation of a pair on one core")


if __name__ == "__main__":
    main()
