"""
Dipoles in chains
=================

Cooled soft dipoles align head to tail. Lines join bound neighbours, each of the six largest chains has its own colour,
and shorter chains are grey.
"""

import matplotlib.pyplot as plt
import numpy as np
import openmm
from openmm import app
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

import openmm_exactrb as rb

n = 125
topology, system, positions = rb.dipole_fluid(n=n, seed=0, trap=0.5)
integrator = rb.ExactRigidBodyIntegrator(0.02, scheme="SRKN4_6b")
simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
simulation.context.setPositions(positions)
for seed in range(80):  # new momenta every 0.5 ps cool the droplet
    integrator.setVelocitiesToTemperature(6.0, seed)
    simulation.step(25)
x = simulation.context.getState(positions=True).getPositions(asNumpy=True)._value
bonds = np.array([[a.index, b.index] for a, b in topology.bonds()])
centres, tips = x[bonds[:, 0]], x[bonds[:, 1]]
directions = tips - centres
directions /= np.linalg.norm(directions, axis=1, keepdims=True)
# The energy of each pair in kJ/mol; mu² = 2. The minimum for a pair head to tail is -2.6 kJ/mol.
r = centres[:, None] - centres
d = np.linalg.norm(r, axis=2) + np.eye(n)
pair = 2.0 * np.einsum("ik,jk->ij", directions, directions) / d**3 + 4.0 / d**12
pair -= 6.0 * np.einsum("ik,ijk->ij", directions, r) * np.einsum("jk,ijk->ij", directions, r) / d**5
bound = (pair < -1.0) & ~np.eye(n, dtype=bool)
count, chain = connected_components(csr_array(bound), directed=False)
sizes = np.bincount(chain)
largest = np.argsort(-sizes)[:6]

# %%
# Chains are drawn as lines from centre to centre, with an arrow for each dipole.

figure = plt.figure(figsize=(8.2, 7.4), layout="constrained")
axes = figure.add_subplot(projection="3d")
okabe_ito = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
colours = np.array(["#BBBBBB"] * count, dtype=object)
colours[largest] = okabe_ito[: len(largest)]
for i, j in np.argwhere(np.triu(bound)):
    axes.plot(*centres[[i, j]].T, color=colours[chain[i]], lw=3.0, alpha=0.7)
for centre, direction, colour in zip(centres, directions, colours[chain], strict=True):
    axes.quiver(*(centre - 0.4 * direction), *(0.8 * direction), color=colour, lw=1.6, arrow_length_ratio=0.5)
for k, colour in zip(largest, okabe_ito, strict=False):
    axes.plot([], [], color=colour, lw=3.0, label=f"{sizes[k]} dipoles")
axes.plot([], [], color="#BBBBBB", lw=3.0, label="shorter chains")
axes.set_box_aspect(np.ptp(centres, axis=0), zoom=1.2)
for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
    axis.pane.set_alpha(0.0)
    axis.line.set_color("0.6")
axes.grid(False)
axes.set_xlabel("x (nm)")
axes.set_ylabel("y (nm)")
axes.set_zlabel("z (nm)")
axes.view_init(elev=18.0, azim=-55.0)
axes.legend(loc="upper left", fontsize=9, title="bound by more than 1 kJ/mol")
axes.set_title(f"{n} soft dipoles in a weak trap, cooled for 40 ps with momenta drawn at 6 K", fontsize=11)
plt.show()
