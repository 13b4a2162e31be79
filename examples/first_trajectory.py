"""
The shortest script
===================

This script simulates 27 soft dipoles and writes their trajectory, their energies and a picture, within seconds.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb

topology, system, positions = rb.dipole_fluid(n=27, trap=0.5)
integrator = rb.ExactRigidBodyIntegrator(0.02, scheme="SRKN4_6b")  # a whole step in ps, or with a unit
simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
simulation.context.setPositions(positions)
integrator.setVelocitiesToTemperature(12.0, 1)  # kelvin, seed

out = Path("out/first")
out.mkdir(parents=True, exist_ok=True)
with (out / "topology.pdb").open("w") as file:
    app.PDBFile.writeFile(topology, positions, file)
simulation.reporters.append(app.DCDReporter(str(out / "trajectory.dcd"), 10))
simulation.reporters.append(rb.EnergyReporter(out / "energies.csv", 10))
simulation.step(500)

energies = np.loadtxt(out / "energies.csv", delimiter=",", skiprows=1)
time, total = energies[:, 1], energies[:, -1]
print(f"{len(time)} frames in {out}; the total energy went from {total[0]:.6f} to {total[-1]:.6f} kJ/mol")

# %%
# Kinetic and potential energy are exchanged; their sum is constant.

plt.style.use("tableau-colorblind10")
figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
for column, label, style in ((2, "translation", "-"), (3, "rotation", "--"), (5, "potential", "-."), (6, "total", ":")):
    axes.plot(time, energies[:, column], style, label=label)
axes.set_xlabel("time (ps)")
axes.set_ylabel("energy (kJ/mol)")
axes.set_title("27 soft dipoles")
figure.legend(loc="outside right center")
figure.savefig(out / "energies.png", dpi=150)
