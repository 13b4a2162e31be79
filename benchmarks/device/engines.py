"""What a step costs on a device: integrators of OpenMM, the engine on the host and the engine on the device.

Rigid water (TIP3P, and TIP4P-Ew with its virtual sites) with PME, TIP3P without forces ("free", which shows the price of
the integrators alone), and soft dipoles, beside OpenMM's Verlet integrator.
A protein in water ("peptide", "dhfr" of openmmtools, or a solvated PDB file) with PME and constraints=HBonds, beside
Verlet, LangevinMiddle and MTS integrators too, at --rates evaluations of the nonbonded forces per ps, with hydrogens of
3 amu where these are fewer than 200; both engines make the --nested schemes with inner steps for bonded forces, those
with a thermostat at 300 K and 5/ps, and MTSIntegrator has four of them.

The integrators take turns in rounds, and the median round counts, since a machine is seldom alone. Printed for each:
milliseconds a (nonbonded) force evaluation, that over Verlet's, and the seconds that the first step took, in which
kernels are compiled. Of rigid bodies also the standard deviation of the total energy over the run. Of a protein also ns
a day, the standard deviation of the total energy within 0.5 ps, mean square over --starts canonical starts, and the
ratios of Verlet's to it from each of them. --platform names the platform, --sizes and --systems choose, --quick is
small. --clock cpu takes the time of all threads of the process instead: for OpenCL on a processor that others use too.
Launches are counted by tests/engines/device/test_contexts.py.

    python benchmarks/device/engines.py --platform CUDA
    python benchmarks/device/engines.py --platform CUDA --systems dhfr --rates 250 125
    python benchmarks/device/engines.py --platform OpenCL --systems peptide --rates 250 --starts 6 \
        --nested S2_3 W2_4 W2_1
"""

from __future__ import annotations

import argparse
import copy
import itertools
import math
import statistics
import time
from functools import partial
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.energies import total
from benchmarks.common.proteins import FORCE_FIELD, PEPTIDE, solvated
from benchmarks.common.starts import canonical, context_of, put, thermostat
from openmm_exactrb.openmm_access.platforms import mixed
from openmm_exactrb.schemes import WITH_THERMOSTAT, scheme_for_thermostat

WATER = (64, 512, 4096, 32768, 100_000)
DIPOLES = (125, 250, 500, 1000, 2000, 4000)
SIZES = {"tip3p": WATER, "tip4pew": WATER, "dipoles": DIPOLES, "free": WATER}


def system_of(name, n):
    """Return System, positions and step of n molecules."""
    if name == "dipoles":
        _, system, positions = rb.dipole_fluid(n, kernel="openmm")
        return system, positions, 0.005
    if name == "free":
        _, system, positions = rb.rigid_water(n)
        while system.getNumForces():
            system.removeForce(0)
        return system, positions, 0.001
    cutoff = min(0.9, 0.45 * 0.3104 * np.ceil(n ** (1 / 3)))
    _, system, positions = rb.rigid_water(n, model=name, nonbondedMethod=app.PME, nonbondedCutoff=cutoff)
    return system, positions, 0.001


def protein(name, heavy):
    """Return System, with bonded forces in group 1, and positions of a protein in water; hydrogens may be heavy."""
    if name == "dhfr":
        from openmmtools import testsystems

        test = testsystems.DHFRExplicit()
        topology, system, positions = test.topology, test.system, test.positions
    else:
        topology, positions = solvated(PEPTIDE if name == "peptide" else Path(name))
        cutoff = {
            "nonbondedMethod": app.PME,
            "nonbondedCutoff": 0.85,
            "switchDistance": 0.75,
            "ewaldErrorTolerance": 1e-5,
        }
        field = app.ForceField(*FORCE_FIELD)
        system = field.createSystem(topology, constraints=app.HBonds, removeCMMotion=False, **cutoff)
    if heavy:
        rb.heavy_hydrogens(system, topology, 3.0, water=True)
    rb.separate_bonded(system)
    return system, positions


def states_of(system, positions, starts, platform):
    """Return States at 300 K, 0.5 ps apart, the first after 5 ps; OpenMM's minimiser may crash on OpenCL of a CPU."""
    platform = openmm.Platform.getPlatform("CPU") if platform.getName() == "OpenCL" else platform
    context = context_of(copy.deepcopy(system), thermostat(), positions, platform.getName(), mixed(platform))
    return canonical(context, 2500, *[250] * (starts - 1), iterations=200)


WINDOW = 0.5  # ps, within which the energy of a protein spreads
INTEGRATORS = {
    "verlet": openmm.VerletIntegrator,
    "langevin": lambda h: openmm.LangevinMiddleIntegrator(300.0, 1.0, h),
    "mts": lambda h: openmm.MTSIntegrator(h, [(0, 1), (1, 4)]),
}
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


def thermal(kind, nested=None):
    """Return whether an integrator has a thermostat."""
    return kind == "langevin" or nested in WITH_THERMOSTAT


def maker_of(scheme):
    """Return what makes an integrator of a scheme, with a thermostat if the scheme has one."""
    if thermal("", scheme.name):
        return partial(rb.ExactRigidBodyLangevinIntegrator, 300.0, 5.0)
    return rb.ExactRigidBodyIntegrator


class Runner:
    """One integrator in its Context; h (ps) is the time between two evaluations of the (nonbonded) forces.

    It starts from positions at 100 K, or from a State; `nested` is the scheme with inner steps for bonded forces.
    """

    def __init__(self, kind, system, start, h, platform, properties, options, nested=None):
        self.clock = CLOCKS[options.clock]
        if kind in INTEGRATORS:
            self.integrator, self.forces = INTEGRATORS[kind](h), 1
            self.integrator.setConstraintTolerance(1e-8)
        else:
            scheme = scheme_for_thermostat(nested or options.scheme)
            step, fast = (h * scheme.forces, (1,)) if nested else (h, None)
            self.integrator = maker_of(scheme)(step, scheme=scheme, engine=kind, fast=fast)
            self.forces = self.integrator.forceEvaluationsPerStep
        self.context = openmm.Context(copy.deepcopy(system), self.integrator, platform, properties)
        begin = self.clock()
        self.start(start)
        self.energy_after(1)
        self.first = self.clock() - begin
        self.times, self.energies = [], []

    def start(self, start):
        """Go to positions, at 100 K, or to a State."""
        put(self.context, start)
        if not isinstance(start, openmm.State):
            self.context.setVelocitiesToTemperature(100.0, 1)

    def spread(self, start):
        """Return the standard deviation (kJ/mol) of the total energy in WINDOW after a start; nan if it diverges."""
        self.start(start)
        steps = round(WINDOW / self.integrator.getStepSize()._value)
        return np.std([self.energy_after(1) for _ in range(steps)])

    def energy_after(self, steps):
        """Make steps, wait for the device, and return the total energy (kJ/mol); nan if they diverge."""
        try:
            self.integrator.step(steps)
            return total(self.context)
        except (openmm.OpenMMException, rb.IntegrationError):
            return math.nan

    def round(self, evaluations):
        """Time steps with about so many force evaluations."""
        steps = max(1, evaluations // self.forces)
        begin = self.clock()
        self.energies.append(self.energy_after(steps))
        self.times.append((self.clock() - begin) / (steps * self.forces))

    @property
    def cost(self):
        """The median time a force evaluation in ms; nan for a run that diverged."""
        return 1e3 * statistics.median(self.times) if np.isfinite(self.energies).all() else math.nan


def in_turns(kinds, options, *arguments):
    """Return runners that took turns, by kinds and their nested schemes."""
    runners = [Runner(kind, *arguments, options, *nested) for kind, *nested in kinds]
    for _ in range(options.rounds):
        for runner in runners:
            runner.round(options.evaluations)
    return runners


def measure(name, n, options, platform, properties):
    """Print a line of the table of rigid bodies."""
    system, positions, h = system_of(name, n)
    kinds = ("verlet",), ("host",), ("device",)
    verlet, host, device = in_turns(kinds, options, system, positions, h, platform, properties)
    print(
        f"{name:8} {n:7d} {verlet.cost:9.3f} {host.cost:9.3f} {device.cost:9.3f} {host.cost / verlet.cost:7.2f} "
        f"{device.cost / verlet.cost:7.2f} {np.std(host.energies):10.2e} {np.std(device.energies):10.2e} "
        f"{host.first:7.2f} {device.first:7.2f}",
        flush=True,
    )


def measure_protein(name, rate, options, platform, properties):
    """Print the lines of a protein with so many evaluations of the nonbonded forces per ps."""
    system, positions = protein(name, heavy=rate < 200.0)
    starts = states_of(system, positions, options.starts, platform)
    kinds = [(kind,) for kind in INTEGRATORS]
    kinds += [(engine, scheme) for scheme in options.nested for engine in options.engines]
    runners = in_turns(kinds, options, system, starts[0], 1.0 / rate, platform, properties)
    unknown = np.full(len(starts), math.nan)  # with a thermostat
    spreads = [
        unknown if thermal(*kind) else np.array([runner.spread(start) for start in starts])
        for kind, runner in zip(kinds, runners, strict=True)
    ]
    for kind, runner, own in zip(kinds, runners, spreads, strict=True):
        print(
            f"{Path(name).stem:8} {rate:7.0f} {' '.join(kind):12} {runner.cost:9.3f} "
            f"{runner.cost / runners[0].cost:7.2f} {86400.0 / rate / runner.cost:9.1f} {runner.first:7.2f} "
            f"{np.sqrt((own**2).mean()):9.2e}  {' '.join(f'{ratio:.1f}' for ratio in spreads[0] / own)}",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument("--precision", default="mixed", choices=("mixed", "double"))
    parser.add_argument("--scheme", default="S2_2", choices=tuple(rb.SCHEMES))
    parser.add_argument("--systems", nargs="+", default=[*SIZES, "peptide"], help=", ".join((*SIZES, "proteins")))
    parser.add_argument("--rates", nargs="+", type=float, default=[250.0, 125.0], help="of a protein, per ps")
    which = "schemes with inner steps for a protein"
    parser.add_argument("--nested", nargs="+", default=["S2_3", "W2_1", "W2_3m"], help=which)
    both = "host", "device"
    parser.add_argument("--engines", nargs="+", default=both, choices=both, help="of a protein")
    parser.add_argument("--starts", type=int, default=2, help="of a protein, for its energy error")
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
    bodies = [name for name in options.systems if name in SIZES]
    if bodies:
        heading_of_bodies()
    for name in bodies:
        for n in options.sizes or SIZES[name]:
            measure(name, n, options, platform, properties)
    proteins = [name for name in options.systems if name not in SIZES]
    if proteins:
        print(
            f"{'system':8} {'per ps':>7} {'':12} {'ms':>9} {'/Verlet':>7} {'ns a day':>9} {'first':>7} {'dE':>9}  "
            "Verlet's over it, from each start"
        )
    for name, rate in itertools.product(proteins, options.rates):
        measure_protein(name, rate, options, platform, properties)


def heading_of_bodies():
    print(
        f"{'system':8} {'n':>7} {'Verlet':>9} {'host':>9} {'device':>9} {'host/V':>7} {'dev./V':>7} "
        f"{'dE host':>10} {'dE device':>10} {'first h':>7} {'first d':>7}"
    )


if __name__ == "__main__":
    main()
