"""Conserved quantities at constant temperature: the total energy at the end of a step, and the energy balance.

A droplet of 27 rigid TIP3P molecules runs for 0.4 ps from one state at 300 K, weakly coupled to the thermostat, at
three step sizes. The script writes to records/energy_balance.csv the standard deviations, in kJ/mol, of the sum of
kinetic and potential energy and of the energy balance, which is `effectiveEnergy`.

    python benchmarks/water/energy_balance.py
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app, unit

import openmm_exactrb as rb
from benchmarks.common.records import RECORDS, Record

Array = NDArray[np.float64]

KELVIN, WEAK = 300.0, 1e-9
MOLECULES, DURATION, EVERY = 27, 0.4, 0.004
STEPS = 0.002, 0.001, 0.0005
RECORD = Record(RECORDS / "energy_balance.csv", ("integrator", "fs"), ("sum", "balance"))
CASES = {
    "Langevin, BAOA": lambda h: rb.ExactRigidBodyLangevinIntegrator(KELVIN, WEAK, h),
    "Langevin, S2_2": lambda h: rb.ExactRigidBodyLangevinIntegrator(KELVIN, WEAK, 2.0 * h, "S2_2"),
    "Nosé-Hoover, BAOAB": lambda h: rb.ExactRigidBodyNoseHooverIntegrator(KELVIN, 1e-3, h),
    "Nosé-Hoover, BAOA": lambda h: rb.ExactRigidBodyNoseHooverIntegrator(KELVIN, 1e-3, h, "BAOA"),
}


def moving(integrator: openmm.Integrator, system: openmm.System, positions: Any) -> openmm.Context:
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    return context


def relaxed(system: openmm.System, positions: Any) -> Array:
    """Return positions (nm) of the droplet at 300 K."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(KELVIN, 20.0, 0.001)
    integrator.setRandomNumberSeed(1)
    context = moving(integrator, system, positions)
    integrator.minimizeEnergy(maxIterations=100)
    integrator.setVelocitiesToTemperature(KELVIN, 1)
    integrator.step(1000)
    return context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)


def spreads(integrator: Any, system: openmm.System, start: Array) -> Array:
    """Return the standard deviations of the sum of the energies and of the balance."""
    context = moving(integrator, system, start)
    integrator.setVelocitiesToTemperature(KELVIN, 1)
    balance = integrator.effectiveEnergy
    per_sample = round(EVERY / integrator.getStepSize().value_in_unit(unit.picosecond))
    energies = []
    for _ in range(round(DURATION / EVERY)):
        integrator.step(per_sample)
        energies.append((integrator.totalEnergy()._value, balance()._value))
    del context
    return np.asarray(np.std(energies, axis=0))


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    _, system, positions = rb.rigid_water(MOLECULES, nonbondedMethod=app.NoCutoff)
    start = relaxed(system, positions)
    for name, make in CASES.items():
        for h in STEPS:
            found = spreads(make(h), system, start)
            row = {key: f"{value:.4g}" for key, value in zip(("sum", "balance"), found, strict=True)}
            RECORD.add({"integrator": name, "fs": f"{1000.0 * h:g}"} | row)


if __name__ == "__main__":
    main()
