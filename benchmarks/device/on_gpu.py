"""Measure the device engine on a GPU: water and dipoles beside OpenMM's integrators, in alternating rounds.

    python benchmarks/device/on_gpu.py --platform CUDA --minutes 9

It needs the wheels of openmm, openmm-cuda-12 (or openmm-hip-6) and this package, and a C++ compiler or a wheel of it
with the library of the device engine. Rows are written to the CSV file as they are measured, so that a run that is cut
off keeps what it has. Times are milliseconds of a force evaluation, medians of the rounds so far; the ratio is
to VerletIntegrator, for schemes with a thermostat to LangevinMiddleIntegrator. At the begin it compares twenty steps
with those of the host.
"""

import argparse
import csv
import statistics
import time
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb

# Label: how an integrator of steps of so many forces is made, and which of OpenMM's it is compared with.
_STEP = 0.001
KINDS = {
    "Verlet": (lambda: openmm.VerletIntegrator(_STEP), 1, "Verlet"),
    "LangevinMiddle": (lambda: openmm.LangevinMiddleIntegrator(300, 1.0, _STEP), 1, "LangevinMiddle"),
    "S2_2": (lambda: rb.ExactRigidBodyIntegrator(2 * _STEP, "S2_2", engine="device"), 2, "Verlet"),
    "W2_1": (lambda: rb.ExactRigidBodyIntegrator(_STEP, "W2_1", engine="device"), 1, "Verlet"),
    "S6_10": (lambda: rb.ExactRigidBodyIntegrator(10 * _STEP, "S6_10", engine="device"), 10, "Verlet"),
    "BAOA": (
        lambda: rb.ExactRigidBodyLangevinIntegrator(300, 1.0, _STEP, "BAOA", engine="device"),
        1,
        "LangevinMiddle",
    ),
}
_COLUMNS = ("system", "molecules", "integrator", "ms a force", "ratio", "rounds", "first call s", "platform", "device")


def water(n):
    """Return a System of TIP3P and positions."""
    cutoff = min(0.9, 0.45 * 0.3104 * np.ceil(n ** (1 / 3)))
    _, system, positions = rb.rigid_water(n, nonbondedMethod=app.PME, nonbondedCutoff=cutoff)
    return system, positions


def dipoles(n):
    """Return a System of soft dipoles whose forces stay on the device, and positions."""
    _, system, positions = rb.dipole_fluid(n, density=0.4, kernel="openmm")
    return system, positions


def compared(platform, precision):
    """Return how far (nm) twenty steps of the device are from those of the host."""
    found = []
    for engine in ("host", "device"):
        system, positions = water(64)
        integrator = rb.ExactRigidBodyIntegrator(_STEP, "W2_1", engine=engine)
        context = openmm.Context(system, integrator, platform, {"Precision": precision})
        context.setPositions(positions)
        integrator.step(20)
        found.append(context.getState(positions=True).getPositions(asNumpy=True)._value)
    return np.abs(found[0] - found[1]).max()


class Entry:
    """An integrator in its Context, and the times of its rounds."""

    def __init__(self, label, system, positions, platform, precision):
        make, self.forces, self.beside = KINDS[label]
        self.integrator = make()
        self.context = openmm.Context(
            openmm.XmlSerializer.clone(system), self.integrator, platform, {"Precision": precision}
        )
        self.context.setPositions(positions)
        self.context.setVelocitiesToTemperature(300, 1)
        start = time.perf_counter()
        self.integrator.step(2)
        self.context.getState(positions=True)
        self.first, self.times = time.perf_counter() - start, []

    def measure(self, forces, clock):
        """Time about so many force evaluations, and wait for the device."""
        steps = max(forces // self.forces, 1)
        start = clock()
        self.integrator.step(steps)
        self.context.getState(positions=True)
        self.times.append((clock() - start) / (steps * self.forces))

    @property
    def median(self):
        """The median of the rounds, in seconds."""
        return statistics.median(self.times)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument("--precision", default="mixed")
    parser.add_argument("--minutes", type=float, default=9.0)
    parser.add_argument("--water", type=int, nargs="*", default=[64, 512, 4096, 32768, 100_000])
    parser.add_argument("--dipoles", type=int, nargs="*", default=[64, 512])
    parser.add_argument("--integrators", nargs="*", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--forces", type=int, default=400, help="force evaluations of a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall")
    parser.add_argument("--csv", type=Path, default=Path("on_gpu.csv"))
    args = parser.parse_args()
    end, clock = (
        time.perf_counter() + 60 * args.minutes,
        time.process_time if args.clock == "cpu" else time.perf_counter,
    )
    platform = openmm.Platform.getPlatform(args.platform)
    print(f"W2_1, 20 steps, double: {compared(platform, 'double'):.2g} nm from the host", flush=True)
    with args.csv.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(_COLUMNS)
        for build, sizes in ((water, args.water), (dipoles, args.dipoles)):
            for n in sizes:
                if time.perf_counter() < end:
                    measure(build, n, platform, args, clock, end, rows)
                    file.flush()


def measure(build, n, platform, args, clock, end, rows):
    """Measure a system in rounds until the time is over, and write its rows."""
    system, positions = build(n)
    entries = {label: Entry(label, system, positions, platform, args.precision) for label in args.integrators}
    for _ in range(args.rounds):
        if time.perf_counter() > end:
            break
        for entry in entries.values():
            entry.measure(args.forces, clock)
    device = next(iter(entries.values())).context
    name = platform.getPropertyValue(device, "DeviceName")
    for label, entry in entries.items():
        if not entry.times:
            continue
        other = entries.get(entry.beside)
        ratio = f"{entry.median / other.median:.3f}" if other else ""
        first = f"{entry.first:.2f}"
        row = (
            build.__name__,
            n,
            label,
            f"{1e3 * entry.median:.4f}",
            ratio,
            len(entry.times),
            first,
            args.platform,
            name,
        )
        rows.writerow(row)
        print(*row, flush=True)


if __name__ == "__main__":
    main()
