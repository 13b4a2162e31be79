"""The shortest script: 27 soft dipoles, their trajectory and their energies."""

from pathlib import Path

import openmm
from openmm import app

import openmm_exactrb as rb

topology, system, positions = rb.dipole_fluid(n=27, trap=0.5)
integrator = rb.ExactRigidBodyIntegrator(0.02, scheme="SRKN4_6b")  # a whole step in ps, or with a unit
simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
simulation.context.setPositions(positions)
integrator.setVelocitiesToTemperature(12.0, 1)  # kelvin, seed

with Path("first.pdb").open("w") as file:
    app.PDBFile.writeFile(topology, positions, file)
simulation.reporters.append(app.DCDReporter("first.dcd", 10))
simulation.reporters.append(rb.EnergyReporter("first.csv", 10))
simulation.step(500)

first, *_, last = (float(line.split(",")[-1]) for line in Path("first.csv").read_text().splitlines()[1:])
print(f"10 ps in first.dcd; the total energy went from {first:.9f} to {last:.9f} kJ/mol")
