"""
Dipoles in chains
=================

A cold droplet as arrows, coloured by the energy of each dipole in the field of the others.
"""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb

n = 125
topology, system, positions = rb.dipole_fluid(n=n, seed=0, trap=0.5)
integrator = rb.ExactRigidBodyIntegrator(0.02, scheme="SRKN4_6b")
simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
simulation.context.setPositions(positions)
for seed in range(80):  # momenta drawn anew every 0.5 ps cool the droplet
    integrator.setVelocitiesToTemperature(6.0, seed)
    simulation.step(25)
x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value
bonds = np.array([[a.index, b.index] for a, b in topology.bonds()])
centres, tips = x[bonds[:, 0]], x[bonds[:, 1]]
directions = tips - centres
directions /= np.linalg.norm(directions, axis=1, keepdims=True)
# Energy of each dipole in the field of the others, in kJ/mol; mu² = 2.
r = centres[:, None] - centres
d = np.linalg.norm(r, axis=2) + np.eye(n)
pair = 2.0 * np.einsum("ik,jk->ij", directions, directions) / d**3
pair -= 6.0 * np.einsum("ik,ijk->ij", directions, r) * np.einsum("jk,ijk->ij", directions, r) / d**5
field = (pair * (1.0 - np.eye(n))).sum(axis=1)

# %%
# Each dipole as an arrow through its centre.

figure = plt.figure(figsize=(8.8, 7.4), layout="constrained")
axes = figure.add_subplot(projection="3d")
norm = plt.Normalize(field.min(), field.max())
colours = plt.get_cmap("viridis")(norm(field))
axes.scatter(*centres.T, s=30, color=colours, depthshade=False, edgecolors="0.3", linewidths=0.4)
for centre, direction, colour in zip(centres, directions, colours, strict=True):
    axes.quiver(*(centre - 0.5 * direction), *direction, color=colour, lw=2.2, arrow_length_ratio=0.4)
axes.set_box_aspect(np.ptp(centres, axis=0), zoom=1.25)
for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
    axis.pane.set_alpha(0.0)
    axis.line.set_color("0.6")
axes.grid(False)
axes.set_xlabel("x (nm)")
axes.set_ylabel("y (nm)")
axes.set_zlabel("z (nm)")
axes.view_init(elev=18.0, azim=-55.0)
mappable = mpl.cm.ScalarMappable(norm, "viridis")
figure.colorbar(mappable, ax=axes, shrink=0.7, label="dipole energy in the field of the others (kJ/mol)")
axes.set_title(f"{n} soft dipoles in a weak trap, cooled for 40 ps with momenta drawn at 6 K: chains")
plt.show()
