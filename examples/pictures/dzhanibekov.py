"""
The Dzhanibekov flip
====================

A wing nut that rotates about its middle axis flips, rotates steadily for a while, and flips again, as a cosmonaut
observed. Each time, its momentum passes close to the separatrix, where small errors of the momentum determine the time
of the next flip. The points of the exact flow are on the true curve although the steps are 1.6 rad long, because the
error of this flow does not depend on the step. The McLachlan-Reich rotation, of order 2, flips at the wrong times.
"""

import matplotlib.pyplot as plt
import numpy as np
from sphere import BLUE, RED

import openmm_exactrb as rb
from openmm_exactrb.mathematics.quaternions import rotation_matrix

inertia = np.array([1.0, 1.88, 2.88])
h, n = 1.6, 75
start = np.array([1e-3, 1.0, 1e-3])
start *= inertia[1] / np.linalg.norm(start)  # the period of rotation is 2 pi
q0 = np.array([1.0, 0.0, 0.0, 0.0])
fine = np.linspace(0.0, n * h, 6001)
truth = rb.free_rotor(inertia, q0, np.tile(start, (len(fine), 1)), fine)
runs = {}
for method in ("exact", "mclachlan_reich"):
    q, m = q0, start
    path = [m]
    for _ in range(n):
        q, m = rb.free_rotor(inertia, q, m, h, method=method)
        path.append(m)
    runs[method] = np.array(path)


# %%
# Top: the body at equal time intervals. Bottom: its momentum.


def draw_nuts(axes, duration):
    """Draw the body at equal time intervals, seen from the side; its spindle is axis 2."""
    times = np.linspace(0.0, duration, 26)
    q, _ = rb.free_rotor(inertia, q0, np.tile(start, (len(times), 1)), times)
    for t, Q in zip(times, rotation_matrix(q), strict=True):
        spindle, bar = Q[:, 1], Q[:, 0]
        x, y = 2.0 * np.array([spindle[0], bar[0]]), np.array([spindle[1], bar[1]])
        axes.plot([t, t + x[0]], [0.0, y[0]], color=BLUE, lw=2.5, solid_capstyle="round")
        axes.plot([t - x[1], t + x[1]], [-y[1], y[1]], color="0.25", lw=4.0, solid_capstyle="round")
        axes.plot(t + x[0], y[0], "o", color=BLUE, ms=5)
    axes.set_ylim(-1.25, 1.25)
    axes.set_yticks([])
    axes.tick_params(labelbottom=False)
    axes.set_ylabel("the body,\nspindle blue")


figure = plt.figure(figsize=(9.0, 6.0), layout="constrained")
top, bottom = figure.subplots(2, 1, height_ratios=(1.0, 1.5))
draw_nuts(top, n * h)
G, times = np.linalg.norm(start), h * np.arange(n + 1)
bottom.plot(fine, truth[1][:, 1] / G, color="0.6", lw=1.0, label="exact, at all times")
bottom.plot(times, runs["exact"][:, 1] / G, "o", color=BLUE, ms=4, label=f"exact, {n} steps of {h}")
style = {"color": RED, "ms": 3.5, "lw": 0.8, "ls": ":"}
bottom.plot(times, runs["mclachlan_reich"][:, 1] / G, "s", label=f"McLachlan-Reich, the same {n} steps", **style)
bottom.set_xlabel("time (reduced units: 1 / angular velocity)")
bottom.set_ylabel("momentum along axis 2, over its norm")
for axes in (top, bottom):
    axes.set_xlim(-3.0, n * h + 3.0)
bottom.grid(True, alpha=0.3)
figure.legend(loc="outside lower center", ncols=3, fontsize=10)
figure.suptitle(f"The Dzhanibekov flip: turning about the middle axis, {h:.1f} rad a step")
plt.show()
