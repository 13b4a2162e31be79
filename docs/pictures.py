"""Draw the pictures of the gallery into the working directory: python docs/pictures.py [name ...].

Colours are those of Okabe and Ito, which colour-blind readers tell apart; where it matters, line styles differ too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
import openmm
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.problems import HeavyTop, Satellite, energy, integrate
from openmm_exactrb.quaternions import matrix, rotation_matrix

BLUE, ORANGE, GREEN, RED, BLACK = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#000000"
INERTIA = np.array([1.0, 1.88, 2.88])


def momentum_sphere() -> Figure:
    """Draw momenta of one body, of norm 1: every curve is one orbit of Euler's equations."""
    figure = plt.figure(figsize=(7.0, 6.6), layout="constrained")
    axes = _sphere(figure.add_subplot(projection="3d", computed_zorder=False), azimuth=40.0, elevation=22.0, zoom=1.1)
    I1, I2, I3 = INERTIA
    q = [1.0, 0.0, 0.0, 0.0]
    # The separatrix passes the middle axis in the planes rho m1² = sigma m3².
    slope = np.sqrt(I3 * (I2 - I1) / (I1 * (I3 - I2)))
    angles = np.arctan(slope) * np.array([0.2, 0.45, 0.7, 0.88])
    others = np.pi / 2 - (np.pi / 2 - np.arctan(slope)) * np.array([0.2, 0.45, 0.7, 0.88])
    for family, colour, label in ((angles, BLUE, "round axis 1"), (others, ORANGE, "round axis 3")):
        for angle in family:
            for sign in (1.0, -1.0):
                start = sign * np.array([np.cos(angle), 0.0, np.sin(angle)])
                _curve(axes, _orbit(q, start, 60.0), colour, label, 1.4)
                label = None
    label = "separatrix"
    for first in (1.0, -1.0):
        for third in (1.0, -1.0):
            start = np.array([first, 0.0, third * slope]) / np.hypot(1.0, slope)
            _curve(axes, _orbit(q, start, 60.0), BLACK, label, 2.0, "--")
            label = None
    for axis in range(3):
        tip = 1.4 * np.eye(3)[axis]
        axes.plot(*np.outer(tip, [0.72, 0.92]), color="0.3", lw=1.2, zorder=5)
        axes.text(*tip, f"axis {axis + 1}", ha="center", fontsize=11)
    axes.legend(loc="lower left", fontsize=10, title="momentum goes")
    axes.set_title("Angular momentum of a free body, seen from the body\nmoments of inertia 1, 1.88, 2.88")
    return figure


def _orbit(q: list[float], start: np.ndarray, duration: float) -> np.ndarray:
    """Return one orbit (n, 3), every point by one call of the exact flow from the start; back in time too."""
    t = np.linspace(-duration / 2, duration / 2, 2401)
    return rb.free_rotor(INERTIA, q, np.tile(start, (len(t), 1)), t)[1]


def _sphere(axes: Axes3D, azimuth: float, elevation: float, zoom: float) -> Axes3D:
    u, v = np.mgrid[0 : 2 * np.pi : 61j, 0 : np.pi : 31j]
    axes.plot_surface(
        np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v), color="0.93", alpha=0.8, lw=0, shade=False, zorder=-10
    )
    axes.set_box_aspect((1, 1, 1), zoom=zoom)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
    axes.view_init(elev=elevation, azim=azimuth)
    axes.set_axis_off()
    return axes


def _eye(axes: Axes3D) -> np.ndarray:
    """Return the direction to the observer."""
    azimuth, elevation = np.radians([axes.azim, axes.elev])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def _curve(
    axes: Axes3D, points: np.ndarray, colour: str, label: str | None = None, width: float = 1.4, style: str = "-"
) -> None:
    """Draw a curve on the sphere: what is behind, faintly."""
    front = points @ _eye(axes) > 0.0
    seen, hidden = (np.where(where[:, None], points, np.nan) for where in (front, ~front))
    axes.plot(*(1.004 * seen.T), color=colour, lw=width, ls=style, label=label)
    axes.plot(*hidden.T, color=colour, lw=0.5 * width, alpha=0.25)


def dzhanibekov() -> Figure:
    """Draw a wing nut in space: exact steps against those of McLachlan and Reich."""
    h, n = 1.6, 75
    start = np.array([1e-3, 1.0, 1e-3])
    start *= INERTIA[1] / np.linalg.norm(start)  # it turns once in 2 pi
    q0 = np.array([1.0, 0.0, 0.0, 0.0])
    fine = np.linspace(0.0, n * h, 6001)
    truth = rb.free_rotor(INERTIA, q0, np.tile(start, (len(fine), 1)), fine)
    runs = {}
    for method in ("exact", "mclachlan_reich"):
        q, m = q0, start
        path = [m]
        for _ in range(n):
            q, m = rb.free_rotor(INERTIA, q, m, h, method=method)
            path.append(m)
        runs[method] = np.array(path)
    figure = plt.figure(figsize=(9.0, 6.0), layout="constrained")
    top, bottom = figure.subplots(2, 1, height_ratios=(1.0, 1.5))
    _nuts(top, n * h)
    G, times = np.linalg.norm(start), h * np.arange(n + 1)
    bottom.plot(fine, truth[1][:, 1] / G, color="0.6", lw=1.0, label="exact, at all times")
    bottom.plot(times, runs["exact"][:, 1] / G, "o", color=BLUE, ms=4, label=f"exact, {n} steps of {h}")
    style = {"color": RED, "ms": 3.5, "lw": 0.8, "ls": ":"}
    bottom.plot(times, runs["mclachlan_reich"][:, 1] / G, "s", label=f"McLachlan-Reich, the same {n} steps", **style)
    bottom.set_xlabel("time (reduced units: 1 / angular velocity)")
    bottom.set_ylabel("momentum along axis 2, part of all")
    for axes in (top, bottom):
        axes.set_xlim(-3.0, n * h + 3.0)
    bottom.grid(True, alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize=10)
    figure.suptitle(f"The Dzhanibekov flip: turning about the middle axis, {h:.1f} rad a step")
    return figure


def _nuts(axes: plt.Axes, duration: float) -> None:
    """Draw the body at equal times, seen from the side: its spindle is axis 2."""
    start = np.array([1e-3, 1.0, 1e-3])
    start *= INERTIA[1] / np.linalg.norm(start)
    times = np.linspace(0.0, duration, 26)
    q, _ = rb.free_rotor(INERTIA, [1.0, 0.0, 0.0, 0.0], np.tile(start, (len(times), 1)), times)
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


def satellite() -> Figure:
    """Draw the path of the vertical in a satellite on its orbit, and the error of its energy at large steps."""
    body = Satellite(np.array([[1.7e4], [3.7e4], [5.4e4]]))
    q, m = np.array([[1.0], [0.0], [0.0], [0.0]]), body.inertia * np.array([[15.0], [-15.0], [15.0]])
    figure = plt.figure(figsize=(11.0, 5.4), layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=(1.2, 1.0))
    left = figure.add_subplot(grid[0], projection="3d", computed_zorder=False)
    right = figure.add_subplot(grid[1])
    _sphere(left, azimuth=-60.0, elevation=35.0, zoom=1.5)
    h, n = 0.004, 2000
    state, path = (q, m), [matrix(q)[2, :, 0]]
    for _ in range(n):
        state = integrate(body, state, h, 1, rb.SCHEMES["S4_6"])
        path.append(matrix(state[0])[2, :, 0])
    points = np.array(path)
    front = points @ _eye(left) > 0.0
    lines = np.stack([points[:-1], points[1:]], axis=1)
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 1.0, n))
    for where, width, opacity in ((~front[1:], 0.6, 0.35), (front[1:], 1.5, 1.0)):
        left.add_collection3d(Line3DCollection(lines[where], colors=colours[where], lw=width, alpha=opacity))
    mappable = mpl.cm.ScalarMappable(plt.Normalize(0.0, n * h), "viridis")
    figure.colorbar(mappable, ax=left, label="time", shrink=0.7, location="left")
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
    right.set_xlabel("time (the body turns by 26 rad a unit)")
    right.set_ylabel("largest relative error of the energy until then")
    right.set_ylim(1e-11, 1e-6)
    right.legend()
    right.grid(True, alpha=0.3)
    return figure


def dipoles() -> Figure:
    """Draw a cold droplet of 125 dipoles as arrows."""
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
    figure = plt.figure(figsize=(8.8, 7.4), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    norm = plt.Normalize(field.min(), field.max())
    colours = plt.get_cmap("viridis")(norm(field))
    axes.scatter(*centres.T, s=30, color=colours, depthshade=False, edgecolors="0.3", linewidths=0.4)
    for centre, direction, colour in zip(centres, directions, colours, strict=True):
        axes.quiver(*(centre - 0.5 * direction), *direction, color=colour, lw=2.2, arrow_length_ratio=0.4)
    axes.set_box_aspect(np.ptp(centres, axis=0), zoom=1.1)
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
    return figure


def schemes() -> Figure:
    """Draw the energy error of every scheme over torque evaluations, on heavy tops; each against all others."""
    tops, start = HeavyTop.random(np.random.default_rng(1), epsilon=1.0, T0=1.0, n=20)
    first = energy(tops, start)
    T, names = 20.0, list(rb.SCHEMES)
    evaluations = np.array([5.0, 10.0, 20.0, 40.0, 80.0])
    curves = {}
    for name in names:
        scheme, errors = rb.SCHEMES[name], []
        for per_time in evaluations:
            n = max(1, round(T * per_time / scheme.stages))
            pause, state, largest = max(1, n // 40), start, np.zeros(len(first))
            for _ in range(max(1, n // pause)):
                state = integrate(tops, state, T / n, pause, scheme)
                largest = np.maximum(largest, np.abs(energy(tops, state) - first))
            errors.append(np.median(largest))
        curves[name] = np.array(errors)
    rows = -(-len(names) // 5)
    figure, grid = plt.subplots(rows, 5, figsize=(11.0, 2.1 * rows), sharex=True, sharey=True, layout="constrained")
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    for axes, name in zip(grid.flat, names, strict=False):
        for other in names:
            axes.loglog(evaluations, curves[other], color="0.85", lw=0.8)
        axes.loglog(evaluations, curves[name], "o-", color=BLUE, lw=2.0, ms=4)
        scheme = rb.SCHEMES[name]
        orders = scheme.generalised or (scheme.order,)
        axes.set_title(f"{name}, order {', '.join(map(str, orders))}", fontsize=10)
        axes.grid(True, alpha=0.25)
        axes.set_ylim(1e-14, 1e1)
        axes.set_xticks([5, 10, 20, 40, 80], ["5", "10", "20", "40", "80"])
        axes.xaxis.set_minor_locator(mpl.ticker.NullLocator())
    figure.supxlabel("torque evaluations a unit of time")
    figure.supylabel("largest error of the energy (median of 20 tops)")
    figure.suptitle("All schemes on heavy tops with epsilon = T0 = 1 over 20 units of time; grey: all others")
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    f.__name__: f for f in (momentum_sphere, dzhanibekov, satellite, dipoles, schemes)
}


def main() -> None:
    """Draw those that are named, or all."""
    for name in sys.argv[1:] or PICTURES:
        figure = PICTURES[name]()
        figure.savefig(f"{name}.png", dpi=110)
        plt.close(figure)


if __name__ == "__main__":
    main()
