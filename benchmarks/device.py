"""What a step costs on a device: OpenMM's Verlet integrator, the engine on the host and the engine on the device.

Rigid water (TIP3P, and TIP4P-Ew with its virtual sites) with PME, and soft dipoles. The three integrators take turns in
rounds, and the median round counts, since a machine is seldom alone. Printed for each system: milliseconds a force
evaluation; of both engines, the standard deviation of the total energy over the run; the seconds that the first step
took, in which kernels are compiled. --platform names the platform, --sizes and --systems choose, --quick is small.
--clock cpu takes the time of all threads of the process instead: for OpenCL on a processor that others use too.

    python benchmarks/device.py --platform CUDA
"""

from __future__ import annotations

import argparse
import copy
import statistics
import time

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb

WATER = (64, 512, 4096, 32768, 100_000)
DIPOLES = (125, 250, 500, 1000, 2000, 4000)
SIZES = {"tip3p": WATER, "tip4pew": WATER, "dipoles": DIPOLES}


def system_of(name, n):
    """Return System, positions and step of n molecules."""
    if name == "dipoles":
        _, system, positions = rb.dipole_fluid(n, kernel="openmm")
        return system, positions, 0.005
    cutoff = min(0.9, 0.45 * 0.3104 * np.ceil(n ** (1 / 3)))
    _, system, positions = rb.rigid_water(n, model=name, nonbondedMethod=app.PME, nonbondedCutoff=cutoff)
    return system, positions, 0.001


CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


class Runner:
    """One integrator in its Context."""

    def __init__(self, kind, name, n, scheme, platform, properties, clock):
        system, positions, h = system_of(name, n)
        self.clock = clock
        if kind == "verlet":
            self.integrator = openmm.VerletIntegrator(h)
            self.forces = 1
        else:
            self.integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, engine=kind)
            self.forces = self.integrator.forceEvaluationsPerStep
        self.context = openmm.Context(copy.deepcopy(system), self.integrator, platform, properties)
        self.context.setPositions(positions)
        self.context.computeVirtualSites()
        start = self.clock()
        self.context.setVelocitiesToTemperature(100.0, 1)
        self.integrator.step(1)
        self.wait()
        self.first = self.clock() - start
        self.times, self.energies = [], []

    def wait(self):
        """Have the device finish, and note the energy."""
        state = self.context.getState(energy=True)
        return state.getPotentialEnergy()._value + state.getKineticEnergy()._value

    def round(self, evaluations):
        """Time steps with about so many force evaluations."""
        steps = max(1, evaluations // self.forces)
        start = self.clock()
        self.integrator.step(steps)
        self.energies.append(self.wait())
        self.times.append((self.clock() - start) / (steps * self.forces))

    @property
    def cost(self):
        """The median time a force evaluation in ms."""
        return 1e3 * statistics.median(self.times)


def measure(name, n, options, platform, properties):
    """Print a line of the table."""
    kinds = ("verlet", "host", "device")
    runners = {
        kind: Runner(kind, name, n, options.scheme, platform, properties, CLOCKS[options.clock]) for kind in kinds
    }
    for _ in range(options.rounds):
        for kind in kinds:
            runners[kind].round(options.evaluations)
    verlet, host, device = (runners[kind] for kind in kinds)
    print(
        f"{name:8} {n:7d} {verlet.cost:9.3f} {host.cost:9.3f} {device.cost:9.3f} {host.cost / verlet.cost:7.2f} "
        f"{device.cost / verlet.cost:7.2f} {np.std(host.energies):10.2e} {np.std(device.energies):10.2e} "
        f"{host.first:7.2f} {device.first:7.2f}",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument("--precision", default="mixed", choices=("mixed", "double"))
    parser.add_argument("--scheme", default="S2_2", choices=tuple(rb.SCHEMES))
    parser.add_argument("--systems", nargs="+", default=list(SIZES), choices=tuple(SIZES))
    parser.add_argument("--sizes", nargs="+", type=int, help="molecules; else those of each system")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--evaluations", type=int, default=100, help="force evaluations a round")
    parser.add_argument("--clock", default="wall", choices=tuple(CLOCKS))
    parser.add_argument("--quick", action="store_true", help="64 molecules, three short rounds")
    options = parser.parse_args()
    if options.quick:
        options.sizes, options.rounds, options.evaluations = [64], 3, 8
    platform = openmm.Platform.getPlatform(options.platform)
    properties = {"Precision": options.precision}
    print(
        f"{options.platform}, {options.precision}, {options.scheme}; {options.clock} ms a force evaluation, first in s"
    )
    print(
        f"{'system':8} {'n':>7} {'Verlet':>9} {'host':>9} {'device':>9} {'host/V':>7} {'dev./V':>7} "
        f"{'dE host':>10} {'dE device':>10} {'first h':>7} {'first d':>7}"
    )
    for name in options.systems:
        for n in options.sizes or SIZES[name]:
            measure(name, n, options, platform, properties)


if __name__ == "__main__":
    main()
