"""Test and measure the native engine on a GPU, for water, proteins, a membrane and dipoles, with OpenMM for comparison.

The script runs in a checkout and needs a C++ compiler for the library of the native engine:

    pip install -e ".[test]" "openmm-cuda-12>=8.6,<8.7" openmmtools     (or openmm-cuda-13, openmm-hip-6)
    python benchmarks/device/on_gpu.py proteins --platform CUDA --minutes 9

The script consists of parts, ordered by their worth, each of which takes at most so many minutes:

    tests       tests of the native engine on the platform
    proteins    time and temperatures of four solutes at 8 fs, beside LangevinMiddle at 4 fs, and at 8 fs with AllBonds
    villin      10 ns of villin with the same integrators: ended, temperatures, RMSD, helix
    dhfr        10 ns of DHFR
    water       time, and the energy over 100 ps and 1 ns, of 512 and 4096 waters, in mixed and single precision
    averages    averages of villin on the platform and on the CPU platform
    single      DHFR, and copies of it with as many atoms as ApoA1, in single precision
    dipoles     dipoles in a reaction field with OpenMM's formula and with the compiled kernel, and as rods of charges
    bodies      times of further sizes and schemes

Long runs stop when the time is over, and continue with the same command. `--rehearse` makes tiny parts of all kinds.

Times are measured in rounds in which the integrators alternate. Integrators of this package use the native engine, or
both engines with --engines native host. Rows are written to the CSV file of a part after each system, so that an
interrupted run keeps its results. "ms" is the median time of a force evaluation. "ratio" is relative to
VerletIntegrator, or to LangevinMiddleIntegrator at 4 fs for proteins. "ns/day" assumes 1 fs between force evaluations
of water, and 5 fs for dipoles. Proteins have hydrogens of 3 amu. "first s" is the time of the first steps in seconds.

Villin is OpenMM's test.pdb, DHFR that of openmmtools (omitted if openmmtools is not installed). The membrane is the
patch of 128 POPC in water that Modeller.addMembrane replicates, with charmm36. --proteins also accepts PDB files, which
are solvated (DHFR is in OpenMM's repository, examples/benchmarks). A name with counts, such as dhfr:2x2x1, means that
many copies of the box along each axis: 94 000 atoms, as many as ApoA1 has.
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
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.proteins import FORCE_FIELD, PEPTIDE, solvated, system_of, tiled, tiled_positions
from benchmarks.common.records import ROOT
from benchmarks.device.device_drift import integrator_of
from benchmarks.device.gpu_runs import EnergySamples, ProteinSamples, Run, in_turn
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
    """An integrator: how it is made, its forces a step, the time (ps) between two, and what it is compared with.

    `all_bonds` is true if the bonds of a protein are constrained.
    """

    make: Callable[[], Any]
    forces: int
    interval: float
    beside: str
    all_bonds: bool = False


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
    theirs = {"LangevinMiddle": (0.004, False), "LangevinMiddle AllBonds": (0.008, True)}
    kinds = {
        name: Kind(partial(openmm.LangevinMiddleIntegrator, 300.0, 5.0, h), 1, h, "LangevinMiddle", all_bonds)
        for name, (h, all_bonds) in theirs.items()
    }
    for (name, interval), engine in product({"BAOA": 0.008, "W2_3m": 0.008}.items(), engines):
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


def dipoles(n, boundary=None, kernel="openmm"):
    """Return a System of soft dipoles, and positions."""
    return rb.dipole_fluid(n, density=0.4, boundary=boundary or rb.ReactionField(cutoff=1.5), kernel=kernel)[1:]


def of_file(name):
    """Return the PDB file of a system."""
    return {"peptide": PEPTIDE, "villin": OPENMM_DATA / "test.pdb", "membrane": OPENMM_DATA / "POPC.pdb"}.get(
        name, Path(name)
    )


@cache
def protein(name, constraints=app.HBonds):
    """Return topology, System with bonded forces in group 1, and positions of a solute; hydrogens are heavy."""
    if name == "dhfr":
        from openmmtools import testsystems

        test = testsystems.DHFRExplicit(constraints=constraints)
        topology, system, positions = test.topology, test.system, test.positions
    else:
        topology, positions = solvated(of_file(name))
        force_field = CHARMM if name == "membrane" else FORCE_FIELD
        system = system_of(topology, force_field, constraints, ewaldErrorTolerance=1e-5)
    rb.heavy_hydrogens(system, topology, 3.0, water=True)
    rb.separate_bonded(system)
    return topology, system, positions


def start_of(name, platform, precision):
    """Return System and a State of a protein at 300 K, or positions of copies of it, such as "villin:2x1x1"."""
    name, _, counts = name.partition(":")
    _, system, positions = protein(name)
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
        self.folder = options.csv.with_suffix("")
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

    def measure(self, name, n, system, start, kinds, precision, seconds, all_bonds=None):
        """Measure a System, and one with `all_bonds`, from a State, or from positions, for about so many seconds."""
        begin = time.perf_counter()
        entries = {}
        for label, kind in kinds.items():
            if self.left > 0.0:
                entries[label] = self._entry(kind, all_bonds if kind.all_bonds else system, start, precision)
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
            if kind.all_bonds:
                entry.context.applyConstraints(1e-6)
        else:
            entry.context.setPositions(start)
            entry.context.setVelocitiesToTemperature(300.0, 1)
        begin = self._clock()
        entry.run(2 * kind.forces, self._clock)
        entry.first = self._clock() - begin
        return entry


@dataclass(frozen=True)
class Sizes:
    """The sizes of the systems and the lengths (ps) of the runs."""

    proteins: tuple[str, ...] = ("peptide", "villin", "dhfr", "membrane")
    long: dict[str, str] = field(default_factory=lambda: {"villin": "villin", "dhfr": "dhfr"})
    water: tuple[int, ...] = (512, 4096)
    bodies: tuple[int, ...] = (64, 32768, 100_000)
    dipoles: tuple[int, ...] = (512, 4096)
    single: tuple[str, ...] = ("dhfr", "dhfr:2x2x1")
    short: float = 100.0
    nanosecond: float = 1000.0
    ten_nanoseconds: float = 10_000.0
    samples: int = 100


TINY = Sizes(
    proteins=("peptide",),
    long={"villin": "peptide", "dhfr": "peptide"},
    water=(64,),
    bodies=(64,),
    dipoles=(64,),
    single=("peptide", "peptide:2x1x1"),
    short=0.4,
    nanosecond=0.8,
    ten_nanoseconds=0.8,
    samples=10,
)


class Parts:
    """The parts: each method measures within the time of a Measurement."""

    def __init__(self, sizes, options):
        self.sizes, self._engines, self._precision = sizes, options.engines, options.precision

    def tests(self, to):
        """Run tests."""
        to.test()

    def proteins(self, to):
        """Measure proteins, and their temperatures."""
        for number, name in enumerate(self.sizes.proteins):
            seconds = to.left / (len(self.sizes.proteins) - number)
            self._times(to, name, self._precision, 0.4 * seconds)
            in_turn(self._runs(to, name, self.sizes.short), to.platform, self._precision, to.folder, 0.4 * seconds)

    def villin(self, to):
        """Run villin."""
        self._long(to, "villin")

    def dhfr(self, to):
        """Run DHFR."""
        self._long(to, "dhfr")

    def _long(self, to, name):
        runs = self._runs(to, self.sizes.long[name], self.sizes.ten_nanoseconds)
        in_turn(runs, to.platform, self._precision, to.folder, to.left)

    def averages(self, to):
        """Run villin on the platform and on the CPU platform."""
        runs = self._runs(to, self.sizes.long["villin"], self.sizes.nanosecond, "BAOA native")
        in_turn(runs, to.platform, self._precision, to.folder, to.left / 2)
        in_turn(runs, openmm.Platform.getPlatform("CPU"), "single", to.folder, to.left)

    def water(self, to):
        """Measure water, and the drift of its energy."""
        kinds = {"Verlet": ("openmm", "Verlet"), "W2_1": ("native", "W2_1"), "W4_4": ("native", "W4_4")}
        for n, precision in product(self.sizes.water, ("mixed", "single")):
            system, positions = water(n)
            seconds = to.left / (len(self.sizes.water) * 2)
            to.measure("water", n, system, positions, of_bodies(0.002, self._engines), precision, 0.2 * seconds)
        runs = []
        for ps, n in product((self.sizes.short, self.sizes.nanosecond), self.sizes.water):
            system, positions = water(n)
            start, samples = equilibrated(system, positions, to.platform, "mixed"), EnergySamples(system, to.platform)
            for label, (engine, name) in kinds.items():
                make = partial(integrator_of, name, engine, 0.002, {})
                every = ps / self.sizes.samples
                runs.append(
                    Run(f"{n} TIP3P, {ps} ps", label, system, start, make, 2.0, ps, every, samples, samples.summary)
                )
        todo = list(product(runs, ("mixed", "single")))
        for number, (run, precision) in enumerate(todo):
            in_turn([run], to.platform, precision, to.folder, to.left / (len(todo) - number))

    def single(self, to):
        """Measure DHFR in single precision."""
        for number, name in enumerate(self.sizes.single):
            self._times(to, name, "single", 0.7 * to.left / (len(self.sizes.single) - number))

    def dipoles(self, to):
        """Measure dipoles with the three kinds of forces."""
        kinds = {"openmm": {}, "compiled": {"kernel": "compiled"}, "rods": {"boundary": rb.Ewald(tolerance=1e-3)}}
        todo = list(product(self.sizes.dipoles, kinds.items()))
        for number, (n, (name, settings)) in enumerate(todo):
            of_ours = {
                k: kind for k, kind in of_bodies(0.005, self._engines).items() if k.startswith(("Verlet", "W2_1"))
            }
            system, positions = dipoles(n, **settings)
            seconds = 0.7 * to.left / (len(todo) - number)
            to.measure(f"dipoles {name}", n, system, positions, of_ours, self._precision, seconds)

    def bodies(self, to):
        """Measure water of further sizes, and the integrators alone."""
        todo = [(water, n) for n in self.sizes.bodies] + [(free, self.sizes.bodies[-1])]
        for number, (build, n) in enumerate(todo):
            seconds = 0.7 * to.left / (len(todo) - number)
            system, positions = build(n)
            to.measure(build.__name__, n, system, positions, of_bodies(0.001, self._engines), self._precision, seconds)

    def _times(self, to, name, precision, seconds):
        system, start = start_of(name, to.platform, precision)
        all_bonds, kinds = None, of_proteins(self._engines)
        if ":" in name:
            kinds = {label: kind for label, kind in kinds.items() if not kind.all_bonds}
        else:
            all_bonds = protein(name, app.AllBonds)[1]
        to.measure(Path(name.replace(".pdb", "")).name, "", system, start, kinds, precision, seconds, all_bonds)

    def _runs(self, to, name, ps, *chosen):
        """Return runs of a protein with all integrators, or with some."""
        topology, system, positions = protein(name)
        _, start = start_of(name, to.platform, self._precision)
        x, runs = np.array(positions.value_in_unit(openmm.unit.nanometer)), []
        for label, kind in of_proteins(self._engines).items():
            if chosen and label not in chosen:
                continue
            of_kind = protein(name, app.AllBonds)[1] if kind.all_bonds else system
            samples = ProteinSamples(topology, of_kind, x)
            fs, every = 1e3 * kind.interval, ps / self.sizes.samples
            runs.append(
                Run(f"{name}, {ps} ps", label, of_kind, start, kind.make, fs, ps, every, samples, samples.summary)
            )
        return runs


PARTS = ("tests", "proteins", "villin", "dhfr", "water", "averages", "single", "dipoles", "bodies")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=PARTS, metavar="part", help=" ".join(PARTS))
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument("--precision", default="mixed", help="of parts that do not name one")
    parser.add_argument("--minutes", type=float, default=9.0, help="of a part")
    parser.add_argument("--engines", nargs="+", choices=("native", "host"), default=["native"], help="of ours")
    parser.add_argument("--forces", type=int, default=400, help="at most so many force evaluations a round")
    parser.add_argument("--rounds", type=int, default=7, help="at most so many")
    parser.add_argument("--clock", choices=tuple(CLOCKS), default="wall")
    parser.add_argument("--rehearse", action="store_true", help="tiny systems and runs")
    parser.add_argument("--csv", type=Path, default=Path("on_gpu.csv"), help="the name of a part is added")
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}: choose from {', '.join(PARTS)}")
    parts, stem = Parts(TINY if options.rehearse else Sizes(), options), options.csv
    for name in options.parts:
        options.csv = stem.with_stem(f"{stem.stem}_{name}")
        begin = time.perf_counter()
        with options.csv.open("w", newline="", encoding="utf-8") as file:
            getattr(parts, name)(Measurement(options, file))
        print(f"{name}: {(time.perf_counter() - begin) / 60.0:.1f} minutes", flush=True)


if __name__ == "__main__":
    main()
