"""
The momentum sphere
===================

Every curve is a solution of Euler's equations: the angular momentum of one free body, in the frame of the body. One
family of curves encloses the axis of the smallest moment of inertia, the other family the axis of the largest. The
separatrix between them passes through the middle axis, and the motion on it takes infinitely long. Each point was
computed from the start of its curve in a single step.
"""

import matplotlib.pyplot as plt
import numpy as np
from sphere import BLACK, BLUE, ORANGE, draw_sphere, eye

import openmm_exactrb as rb

inertia = np.array([1.0, 1.88, 2.88])


def orbit(start, duration):
    """Return one orbit (n, 3), forwards and backwards in time; each point is one step from the start."""
    t = np.linspace(-duration / 2, duration / 2, 2401)
    return rb.free_rotor(inertia, [1.0, 0.0, 0.0, 0.0], np.tile(start, (len(t), 1)), t)[1]


def draw_curve(axes, points, colour, label=None, width=1.4, style="-"):
    """Draw a curve on the sphere, with the hidden part fainter."""
    front = points @ eye(axes) > 0.0
    seen, hidden = (np.where(where[:, None], points, np.nan) for where in (front, ~front))
    axes.plot(*(1.004 * seen.T), color=colour, lw=width, ls=style, label=label)
    axes.plot(*hidden.T, color=colour, lw=0.5 * width, alpha=0.25)


# %%
# The picture shows the two families of curves, and the separatrix between them.

figure = plt.figure(figsize=(7.0, 6.6), layout="constrained")
axes = draw_sphere(figure.add_subplot(projection="3d", computed_zorder=False), azimuth=40.0, elevation=22.0, zoom=1.1)
I1, I2, I3 = inertia
# The separatrix passes through the middle axis in the planes rho m1² = sigma m3².
slope = np.sqrt(I3 * (I2 - I1) / (I1 * (I3 - I2)))
angles = np.arctan(slope) * np.array([0.2, 0.45, 0.7, 0.88])
others = np.pi / 2 - (np.pi / 2 - np.arctan(slope)) * np.array([0.2, 0.45, 0.7, 0.88])
for family, colour, label in ((angles, BLUE, "round axis 1"), (others, ORANGE, "round axis 3")):
    for angle in family:
        for sign in (1.0, -1.0):
            start = sign * np.array([np.cos(angle), 0.0, np.sin(angle)])
            draw_curve(axes, orbit(start, 60.0), colour, label, 1.4)
            label = None
label = "separatrix"
for first in (1.0, -1.0):
    for third in (1.0, -1.0):
        start = np.array([first, 0.0, third * slope]) / np.hypot(1.0, slope)
        draw_curve(axes, orbit(start, 60.0), BLACK, label, 2.0, "--")
        label = None
for axis in range(3):
    tip = 1.4 * np.eye(3)[axis]
    axes.plot(*np.outer(tip, [0.72, 0.92]), color="0.3", lw=1.2, zorder=5)
    axes.text(*(1.1 * tip), f"axis {axis + 1}", ha="center", fontsize=11)
axes.legend(loc="lower left", fontsize=10, title="momentum goes")
axes.set_title("Angular momentum of a free body, seen from the body\nmoments of inertia 1, 1.88, 2.88")
plt.show()
