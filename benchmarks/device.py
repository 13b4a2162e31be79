"""What a step costs on a device: integrators of OpenMM, the engine on the host and the engine on the device.

Rigid water (TIP3P, and TIP4P-Ew with its virtual sites) with PME, and soft dipoles, beside OpenMM's Verlet integrator.
A protein in water ("peptide", "dhfr" of openmmtools, or a solvated PDB file) with PME and constraints=HBonds, beside
Verlet, LangevinMiddle and MTS integrators too, at --rates evaluations of the nonbonded forces per ps; both engines make
S2_3 with inner steps for bonded forces, MTSIntegrator has four of them.

The integrators take turns in rounds, and the median round counts, since a machine is seldom alone. Printed for each:
milliseconds a (nonbonded) force evaluation, that over Verlet's, the standard deviation of the total energy over the run
(not where there is a thermostat), and the seconds that the first step took, in which kernels are compiled; of a protein
ns a day too. --platform names the platform, --sizes and --systems choose, --quick is small. --clock cpu takes the time
of all threads of the process instead: for OpenCL on a processor that others use too. Launches are counted by
tests/device/test_launches.py.

    python benchmarks/device.py --platform CUDA
"""

from __future__ import annotations

import argparse
import copy
import statistics
import time
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

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


def protein(name):
    """Return System, with bonded forces in group 1, and positions of a protein in water at rest."""
    if name == "dhfr":
        from openmmtools import testsystems

        test = testsystems.DHFRExplicit()
        system, positions = test.system, test.positions
    else:
        field = app.ForceField("amber14-all.xml", "amber14/tip3p.xml")
        pdb = app.PDBFile(str(PEPTIDE) if name == "peptide" else name)
        model = app.Modeller(pdb.topology, pdb.positions)
        if name == "peptide":
            model.addSolvent(field, boxSize=openmm.Vec3(2.1, 2.1, 2.1) * unit.nanometer)
        cutoff = {
            "nonbondedMethod": app.PME,
            "nonbondedCutoff": 0.85,
            "switchDistance": 0.75,
            "ewaldErrorTolerance": 1e-5,
        }
        system = field.createSystem(model.topology, constraints=app.HBonds, removeCMMotion=False, **cutoff)
        positions = model.positions
    rb.separate_bonded(system)
    context = openmm.Context(copy.deepcopy(system), openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("CPU"))
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 200)
    return system, context.getState(positions=True).getPositions(asNumpy=True)


PEPTIDE = Path(__file__).parents[1] / "examples" / "data" / "alanine_dipeptide.pdb"
PROTEIN_KINDS = ("verlet", "langevin", "mts", "host", "device")
INTEGRATORS = {
    "verlet": openmm.VerletIntegrator,
    "langevin": lambda h: openmm.LangevinMiddleIntegrator(300.0, 1.0, h),
    "mts": lambda h: openmm.MTSIntegrator(h, [(0, 1), (1, 4)]),
}
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


class Runner:
    """One integrator in its Context; h (ps) is the time between two evaluations of the (nonbonded) forces."""

    def __init__(self, kind, system, positions, h, platform, properties, options, kelvin=100.0):
        self.clock = CLOCKS[options.clock]
        if kind in INTEGRATORS:
            self.integrator, self.forces = INTEGRATORS[kind](h), 1
            self.integrator.setConstraintTolerance(1e-8)
        else:
            fast = (1,) if kelvin > 100.0 else None
            scheme = rb.SCHEMES["S2_3" if fast else options.scheme]
            step = h * scheme.forces if fast else h
            self.integrator = rb.ExactRigidBodyIntegrator(step, scheme=scheme, engine=kind, fast=fast)
            self.forces = self.integrator.forceEvaluationsPerStep
        self.thermal = kind == "langevin"
        self.context = openmm.Context(copy.deepcopy(system), self.integrator, platform, properties)
        self.context.setPositions(positions)
        self.context.computeVirtualSites()
        start = self.clock()
        self.context.setVelocitiesToTemperature(kelvin, 1)
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


def in_turns(kinds, options, *arguments, **keywords):
    """Return runners that took turns."""
    runners = [Runner(kind, *arguments, options, **keywords) for kind in kinds]
    for _ in range(options.rounds):
        for runner in runners:
            runner.round(options.evaluations)
    return runners


def measure(name, n, options, platform, properties):
    """Print a line of the table of rigid bodies."""
    system, positions, h = system_of(name, n)
    verlet, host, device = in_turns(("verlet", "host", "device"), options, system, positions, h, platform, properties)
    print(
        f"{name:8} {n:7d} {verlet.cost:9.3f} {host.cost:9.3f} {device.cost:9.3f} {host.cost / verlet.cost:7.2f} "
        f"{device.cost / verlet.cost:7.2f} {np.std(host.energies):10.2e} {np.std(device.energies):10.2e} "
        f"{host.first:7.2f} {device.first:7.2f}",
        flush=True,
    )


def measure_protein(name, options, platform, properties):
    """Print the lines of a protein."""
    system, positions = protein(name)
    for rate in options.rates:
        arguments = system, positions, 1.0 / rate, platform, properties
        runners = in_turns(PROTEIN_KINDS, options, *arguments, kelvin=300.0)
        for kind, runner in zip(PROTEIN_KINDS, runners, strict=True):
            energy = "-" if runner.thermal else f"{np.std(runner.energies):.2e}"
            print(
                f"{Path(name).stem:8} {rate:7.0f} {kind:9} {runner.cost:9.3f} {runner.cost / runners[0].cost:7.2f} "
                f"{86400.0 / rate / runner.cost:9.1f} {energy:>10} {runner.first:7.2f}",
                flush=True,
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument("--precision", default="mixed", choices=("mixed", "double"))
    parser.add_argument("--scheme", default="S2_2", choices=tuple(rb.SCHEMES))
    parser.add_argument("--systems", nargs="+", default=[*SIZES, "peptide"], help="tip3p, tip4pew, dipoles; proteins")
    parser.add_argument("--rates", nargs="+", type=float, default=[250.0, 125.0], help="of a protein, per ps")
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
        print(f"{'system':8} {'per ps':>7} {'':9} {'ms':>9} {'/Verlet':>7} {'ns a day':>9} {'dE':>10} {'first':>7}")
    for name in proteins:
        measure_protein(name, options, platform, properties)


def heading_of_bodies():
    print(
        f"{'system':8} {'n':>7} {'Verlet':>9} {'host':>9} {'device':>9} {'host/V':>7} {'dev./V':>7} "
        f"{'dE host':>10} {'dE device':>10} {'first h':>7} {'first d':>7}"
    )


if __name__ == "__main__":
    main()
