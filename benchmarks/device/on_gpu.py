"""Test and measure the native engine on a GPU, for water, proteins, a membrane and dipoles, with OpenMM for comparison.

The script runs in a checkout and needs a C++ compiler for the library of the native engine:

    pip install -e ".[test]" "openmm-cuda-12>=8.6,<8.7" openmmtools     (or openmm-cuda-13, openmm-hip-6)
    python benchmarks/device/on_gpu.py --platform CUDA --minutes 9

The script first runs tests of the native engine on the platform. It then measures each system in rounds in which the
integrators alternate. Integrators of this package use the native engine, or both engines with --engines native host.
Rows are written to the CSV file after each system, so that an interrupted run keeps its results. "ms" is the median
time of a force evaluation. "ratio" is relative to VerletIntegrator, or to LangevinMiddleIntegrator for integrators with
a thermostat. "ns/day" assumes 1 fs between force evaluations of water, and 5 fs for dipoles. Proteins have hydrogens of
3 amu, and 4 fs with LangevinMiddleIntegrator and BAOA, 8 fs with W2_3m. "first s" is the time of the first steps in
seconds.

Villin is OpenMM's test.pdb, DHFR that of openmmtools (omitted if openmmtools is not installed). The membrane is the
patch of 128 POPC in water that Modeller.addMembrane replicates, with charmm36. --proteins also accepts PDB files, which
are solvated (DHFR is in OpenMM's repository, examples/benchmarks). A name with counts, such as dhfr:2x2x1, means that
many copies of the box along each axis: 94 000 atoms, as many as ApoA1 has, or a million with dhfr:2x3x7.
"""

from __future__ import annotations

import argparse
import csv
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.proteins import FORCE_FIELD, PEPTIDE, solvated, system_of, tiled, tiled_positions
from benchmarks.common.records import ROOT
from openmm_exactrb.openmm_access.platforms import no_gpu
from openmm_exactrb.schemes import scheme_for_thermostat

COLUMNS = "system", "molecules", "precision", "integrator", "ms", "ratio", "ns/day", "rounds", "first s", "device"
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
OPENMM_DATA = Path(app.__file__).parent / "data"
CHARMM = "charmm36.xml", "charmm36/water.xml"
# What is tested first: schemes, bodies, noise and flexible molecules are those of the host.
FOLDERS = [f"tests/{name}" for name in ("rigid", "flexible", "thermostats", "checkpoints", "changes")]
TESTED = "moves_water or every_kind or noise_of_the_host or single_precision or peptide or checkpoint"


@dataclass
class Kind:
    """An integrator: how it is made, its forces a step, the time (ps) between two, and what it is compared with."""

    make: Callable[[], Any]
    forces: int
    interval: float
    beside: str


def of_bodies(h, engines):
    """Return integrators of rigid bodies with a force evaluation every h (ps), ours on each of the engines."""
    kinds = {
        "Verlet": Kind(lambda: openmm.VerletIntegrator(h), 1, h, "Verlet"),
        "LangevinMiddle": Kind(lambda: openmm.LangevinMiddleIntegrator(300.0, 1.0, h), 1, h, "LangevinMiddle"),
    }
    for (name, forces), engine in product({"S2_2": 2, "W2_1": 1, "S6_10": 10}.items(), engines):
        make = partial(rb.ExactRigidBodyIntegrator, forces * h, name, engine=engine)
        kinds[f"{name} {engine}"] = Kind(make, forces, h, "Verlet")
    for engine in engines:
        make = partial(rb.ExactRigidBodyLangevinIntegrator, 300.0, 1.0, h, "BAOA", engine=engine)
        kinds[f"BAOA {engine}"] = Kind(make, 1, h, "LangevinMiddle")
    return kinds


def of_proteins(engines):
    """Return integrators of a protein with heavy hydrogens, ours on each of the engines."""
    theirs = lambda: openmm.LangevinMiddleIntegrator(300.0, 1.0, 0.004)  # noqa: E731
    kinds = {"LangevinMiddle": Kind(theirs, 1, 0.004, "LangevinMiddle")}
    for (name, interval), engine in product({"BAOA": 0.004, "W2_3m": 0.008}.items(), engines):
        forces = scheme_for_thermostat(name).forces
        inner = {"engine": engine, "fast": "bonded"}
        make = partial(rb.ExactRigidBodyLangevinIntegrator, 300.0, 5.0, interval * forces, name, **inner)
        kinds[f"{name} {engine}"] = Kind(make, forces, interval, "LangevinMiddle")
    return kinds


def water(n):
    """Return a System of TIP3P and positions."""
    cutoff = min(0.9, 0.45 * 0.3104 * np.ceil(n ** (1 / 3)))
    return rb.rigid_water(n, nonbondedMethod=app.PME, nonbondedCutoff=cutoff)[1:]


def free(n):
    """Return a System of TIP3P without forces, which shows the price of the integrators alone, and positions."""
    system, positions = rb.rigid_water(n)[1:]
    while system.getNumForces():
        system.removeForce(0)
    return system, positions


def dipoles(n):
    """Return a System of soft dipoles whose forces stay on the device, and positions."""
    return rb.dipole_fluid(n, density=0.4, boundary=rb.ReactionField(cutoff=1.5), kernel="openmm")[1:]


def of_file(name):
    """Return the PDB file of a system."""
    return {"peptide": PEPTIDE, "villin": OPENMM_DATA / "test.pdb", "membrane": OPENMM_DATA / "POPC.pdb"}.get(
        name, Path(name)
    )


@cache
def protein(name):
    """Return System, with bonded forces in group 1, and positions of a protein or membrane; hydrogens are heavy."""
    if name == "dhfr":
        from openmmtools import testsystems

        test = testsystems.DHFRExplicit()
        topology, system, positions = test.topology, test.system, test.positions
    else:
        topology, positions = solvated(of_file(name))
        force_field = CHARMM if name == "membrane" else FORCE_FIELD
        system = system_of(topology, force_field, ewaldErrorTolerance=1e-5)
    rb.heavy_hydrogens(system, topology, 3.0, water=True)
    rb.separate_bonded(system)
    return system, positions


def start_of(name, platform, precision):
    """Return System and a State of a protein at 300 K, or positions of copies of it, such as "villin:2x1x1"."""
    name, _, counts = name.partition(":")
    system, positions = protein(name)
    state = equilibrated(system, positions, platform, precision)
    if not counts:
        return system, state
    counts = tuple(int(count) for count in counts.split("x"))
    places, box = state.getPositions(asNumpy=True)._value, state.getPeriodicBoxVectors(asNumpy=True)._value
    return tiled(system, counts), tiled_positions(places, box, counts)


def equilibrated(system, positions, platform, precision):
    """Return a State of a System at 300 K; OpenMM's minimiser may crash on OpenCL of a CPU."""
    integrator = openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.001)
    context = openmm.Context(system, integrator, platform, {"Precision": precision})
    context.setPositions(positions)
    if no_gpu(context):
        del context
        integrator = openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.001)
        context = openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"))
        context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, maxIterations=200)
    context.setVelocitiesToTemperature(300.0, 1)
    integrator.step(500)
    return context.getState(positions=True, velocities=True)


@dataclass
class Entry:
    """An integrator in its Context, and the times of its rounds (s a force)."""

    kind: Kind
    context: Any
    first: float = 0.0
    times: list[float] = field(default_factory=list)

    def run(self, forces, clock):
        """Return the time of about so many force evaluations, each, with waiting for the device."""
        steps = max(round(forces / self.kind.forces), 1)
        start = clock()
        self.context.getIntegrator().step(steps)
        self.context.getState(positions=True)
        return (clock() - start) / (steps * self.kind.forces)

    @property
    def median(self):
        """The median of the rounds."""
        return statistics.median(self.times)


class Measurement:
    """Measures systems on a platform and writes their rows until the time is over."""

    def __init__(self, options, file):
        self.options, self._file, self._rows = options, file, csv.writer(file)
        self.platform = openmm.Platform.getPlatform(options.platform)
        self._clock, self._end = CLOCKS[options.clock], time.perf_counter() + 60.0 * options.minutes
        self._write(*COLUMNS)

    @property
    def left(self):
        """The seconds that are left."""
        return self._end - time.perf_counter()

    def _write(self, *row):
        self._rows.writerow(row)
        self._file.flush()
        print(*row, flush=True)

    def test(self):
        """Run tests of the native engine on the platform, for a third of the time at most."""
        command = [sys.executable, "-m", "pytest", "-q", "-x", *FOLDERS, "-m", "opencl", "-k", TESTED]
        environment = os.environ | {"OPENMM_DEFAULT_PLATFORM": self.options.platform}
        begin = time.perf_counter()
        try:
            done = subprocess.run(
                command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=self.left / 3
            )
            result = (done.stdout.splitlines() or ["nothing was printed"])[-1]
        except subprocess.TimeoutExpired:
            result = "not finished"
        self._write(
            "tests", "", "", result, "", "", "", "", f"{time.perf_counter() - begin:.1f}", self.options.platform
        )

    def measure(self, name, n, system, start, kinds, precision, seconds):
        """Measure a System from a State, or from positions, for about so many seconds."""
        begin = time.perf_counter()
        entries = {}
        for label, kind in kinds.items():
            if self.left > 0.0:
                entries[label] = self._entry(kind, system, start, precision)
        if not entries:
            return
        slowest = max(entry.run(10, self._clock) for entry in entries.values())
        forces = min(self.options.forces, max(10, int(seconds / (4.0 * slowest * len(entries)))))
        for rounds in range(self.options.rounds):
            if rounds > 1 and time.perf_counter() - begin > seconds:
                break
            for entry in entries.values():
                if self.left > 0.0 or not entry.times:
                    entry.times.append(entry.run(forces, self._clock))
        for label, entry in entries.items():
            ratio = entry.median / entries[entry.kind.beside].median
            day = 86.4 * entry.kind.interval / entry.median
            device = self.platform.getPropertyValue(entry.context, "DeviceName")
            row = (
                f"{1e3 * entry.median:.4f}",
                f"{ratio:.3f}",
                f"{day:.1f}",
                len(entry.times),
                f"{entry.first:.2f}",
                device,
            )
            self._write(name, n, precision, label, *row)

    def _entry(self, kind, system, start, precision):
        entry = Entry(kind, openmm.Context(system, kind.make(), self.platform, {"Precision": precision}))
        if isinstance(start, openmm.State):
            entry.context.setState(start)
        else:
            entry.context.setPositions(start)
            entry.context.setVelocitiesToTemperature(300.0, 1)
        begin = self._clock()
        entry.run(2 * kind.forces, self._clock)
        entry.first = self._clock() - begin
        return entry


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument(
        "--precisions", nargs="+", default=["mixed", "single"], help="all systems in the first one first"
    )
    parser.add_argument("--minutes", type=float, default=9.0)
    parser.add_argument("--water", type=int, nargs="*", default=[64, 512, 4096, 32768, 100_000])
    parser.add_argument("--free", type=int, nargs="*", default=[32768], help="TIP3P without forces")
    dhfr = ["dhfr", "dhfr:2x2x1", "dhfr:2x3x7"] if find_spec("openmmtools") else []
    proteins = ["peptide", "villin", *dhfr, "membrane"]
    help_ = "peptide, villin, dhfr, membrane, or PDB files, and copies of them"
    parser.add_argument("--proteins", nargs="*", default=proteins, help=help_)
    parser.add_argument("--dipoles", type=int, nargs="*", default=[64, 512, 4096])
    parser.add_argument("--engines", nargs="+", choices=("native", "host"), default=["native"], help="of ours")
    parser.add_argument("--forces", type=int, default=400, help="at most so many force evaluations a round")
    parser.add_argument("--rounds", type=int, default=7, help="at most so many")
    parser.add_argument("--clock", choices=tuple(CLOCKS), default="wall")
    parser.add_argument("--no-tests", action="store_true")
    parser.add_argument("--csv", type=Path, default=Path("on_gpu.csv"))
    options = parser.parse_args()
    systems = [(water, n) for n in options.water]
    systems += [(protein, name) for name in options.proteins if ":" not in name]
    systems += [(dipoles, n) for n in options.dipoles]
    systems += [(free, n) for n in options.free]
    systems += [(protein, name) for name in options.proteins if ":" in name]
    with options.csv.open("w", newline="", encoding="utf-8") as file:
        measurement = Measurement(options, file)
        if not options.no_tests:
            measurement.test()
        todo = [(build, n, precision) for precision in options.precisions for build, n in systems]
        for number, (build, n, precision) in enumerate(todo):
            if measurement.left < 0.0:
                break
            seconds = measurement.left / (len(todo) - number)
            if build is protein:
                system, start = start_of(n, measurement.platform, precision)
                kinds = of_proteins(options.engines)
            else:
                system, start = build(n)
                kinds = of_bodies(0.005 if build is dipoles else 0.001, options.engines)
            name, size = (Path(n.replace(".pdb", "")).name, "") if build is protein else (build.__name__, n)
            measurement.measure(name, size, system, start, kinds, precision, 0.7 * seconds)


if __name__ == "__main__":
    main()
