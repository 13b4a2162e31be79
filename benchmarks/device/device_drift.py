"""The drift of the energy on a device in mixed precision, and that of the same systems on the host.

Droplets of rigid water, or with --peptide alanine dipeptide in a box of water with inner steps for its bonded forces;
each start on both engines. Printed for each run: the slope of the total energy per molecule, of a straight line through
it, and how far the energy is from that line; at the end, of each engine, the mean slope of all starts with its standard
error. The kinetic energy is that of the bodies in float64, the potential energy that of the platform.

    python benchmarks/device/device_drift.py --platform CUDA
    python benchmarks/device/device_drift.py --platform CUDA --peptide --scheme S2_3 --step 0.012 \
        --steps 8400 --every 20
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.starts import R, context_of
from benchmarks.proteins import protein_steps


def start_of(options):
    """Return System, positions, molecules, temperature (K) and fast forces of what is run."""
    if not options.peptide:
        _, system, positions = rb.rigid_water(options.molecules)
        return system, positions, options.molecules, 100.0, None
    topology, system, _ = protein_steps.molecules(None, "plain", "HBonds")
    start = protein_steps.start_of(None)
    system.setDefaultPeriodicBoxVectors(*start.getPeriodicBoxVectors())
    molecules = 1 + sum(residue.name == "HOH" for residue in topology.residues())
    return system, start.getPositions(), molecules, 300.0, "bonded"


def energies(engine, seed, options):
    """Return times (ns) and total energies (kJ/mol) of a run."""
    system, positions, _, kelvin, fast = start_of(options)
    integrator = rb.ExactRigidBodyIntegrator(options.step, options.scheme, engine=engine, fast=fast)
    copied = openmm.XmlSerializer.clone(system)
    context = context_of(copied, integrator, positions, options.platform, {"Precision": "mixed"})
    integrator.setVelocitiesToTemperature(kelvin, seed)
    integrator.step(options.every)
    found = []
    for _ in range(options.steps // options.every):
        integrator.step(options.every)
        found.append((1e-3 * context.getTime()._value, integrator.totalEnergy()._value))
    return np.array(found).T


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="CUDA")
    parser.add_argument("--scheme", default="S2_2", choices=tuple(rb.SCHEMES))
    parser.add_argument("--molecules", type=int, default=8)
    parser.add_argument("--peptide", action="store_true", help="in 212 molecules of water, at 300 K")
    parser.add_argument("--step", type=float, default=0.0005, help="in ps")
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--every", type=int, default=100, help="steps between two energies")
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--first", type=int, default=1, help="seed of the first start; the next one has the next seed")
    options = parser.parse_args()
    _, _, molecules, kelvin, _ = start_of(options)
    what = f"{molecules} molecules at {kelvin:g} K"
    slopes = {"host": [], "device": []}
    print(f"{options.platform}, mixed, {options.scheme}, {what}, {1e3 * options.step:g} fs")
    print(f"{'start':>5} {'engine':7} {'kJ/mol/ns/molecule':>20} {'kJ/mol about the line':>22}")
    for seed, engine in itertools.product(range(options.first, options.first + options.starts), slopes):
        times, found = energies(engine, seed, options)
        line = np.polyfit(times, found, 1)
        slopes[engine].append(line[0] / molecules)
        rest = np.std(found - np.polyval(line, times))
        print(f"{seed:5d} {engine:7} {slopes[engine][-1]:20.2e} {rest:22.2e}", flush=True)
    for engine, found in slopes.items():
        error = np.std(found, ddof=1) / np.sqrt(len(found))
        print(f"{engine}: {np.mean(found):.2e} +- {error:.2e} kJ/mol/ns/molecule; RT is {R * kelvin:.2f} kJ/mol")


if __name__ == "__main__":
    main()
