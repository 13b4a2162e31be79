"""
The path of a satellite
=======================

A satellite on a circular orbit is subject to the torque of the gravity gradient. The left panel shows the direction of
the earth in the frame of the satellite, and the right panel the energy error of the same motion at two step sizes.
"""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from sphere import BLUE, ORANGE, draw_sphere, eye

import openmm_exactrb as rb
from benchmarks.paper.problems import Satellite, energy, integrate
from openmm_exactrb.mathematics.quaternions import matrix

body = Satellite(np.array([[1.7e4], [3.7e4], [5.4e4]]))
q, m = np.array([[1.0], [0.0], [0.0], [0.0]]), body.inertia * np.array([[15.0], [-15.0], [15.0]])
figure = plt.figure(figsize=(11.0, 5.4), layout="constrained")
grid = figure.add_gridspec(1, 2, width_ratios=(1.2, 1.0))
left = figure.add_subplot(grid[0], projection="3d", computed_zorder=False)
right = figure.add_subplot(grid[1])
draw_sphere(left, azimuth=-60.0, elevation=35.0, zoom=1.5)
h, n = 0.004, 2000
state, path = (q, m), [matrix(q)[2, :, 0]]
for _ in range(n):
    state = integrate(body, state, h, 1, rb.SCHEMES["S4_6"])
    path.append(matrix(state[0])[2, :, 0])
points = np.array(path)
front = points @ eye(left) > 0.0
lines = np.stack([points[:-1], points[1:]], axis=1)
colours = plt.get_cmap("viridis")(np.linspace(0.0, 1.0, n))
for where, width, opacity in ((~front[1:], 0.6, 0.35), (front[1:], 1.5, 1.0)):
    left.add_collection3d(Line3DCollection(lines[where], colors=colours[where], lw=width, alpha=opacity))
mappable = mpl.cm.ScalarMappable(plt.Normalize(0.0, n * h), "viridis")
figure.colorbar(mappable, ax=left, label="time (the body turns by 26 rad a unit)", shrink=0.7, location="left")
left.set_title("the direction of the earth's centre,\nseen from the satellite")
for h, colour, style in ((0.1, ORANGE, "--"), (0.05, BLUE, "-")):
    state, times, errors = (q, m), [], []
    E0 = energy(body, state)[0]
    for k in range(1, round(60.0 / h) + 1):
        state = integrate(body, state, h, 1, rb.SCHEMES["SRKN6_14a"])
        times.append(k * h)
        errors.append(abs(energy(body, state)[0] / E0 - 1.0))
    largest = np.maximum.accumulate(errors)
    right.semilogy(times, largest, color=colour, ls=style, lw=1.8, label=f"SRKN6_14a + exact, step {h}")
right.set_title("the energy at large steps")
right.set_xlabel("time (the body turns by 26 rad a unit)")
right.set_ylabel("largest relative error of the energy until then")
right.set_ylim(1e-11, 1e-6)
right.legend()
right.grid(True, alpha=0.3)
plt.show()
