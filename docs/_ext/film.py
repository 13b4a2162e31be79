"""Three free water molecules by Verlet and by the exact rotation, a moving picture: ``python docs/_ext/film.py``."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from PIL import Image

import openmm_exactrb as rb
from openmm_exactrb.mathematics.quaternions import rotation_matrix

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path("docs/pictures/tumbling.gif")
STEP = 0.008  # ps
EVERY, FRAMES = 5, 25  # steps from one picture to the next, and pictures of a scene
SCENES = (0.0, 20.0, 100.0)  # ps
TEMPERATURE, SEED = 300.0, 3
RADIUS = {"O": 0.042, "H": 0.028}  # nm
COLOUR = {"O": "#D7301F", "H": "0.95"}
PLACES = np.array([[0.0, 0.24, 0.0], [0.0, 0.0, 0.0], [0.0, -0.24, 0.0]])
NAMES = {"VerletIntegrator": "VerletIntegrator", "exact": "ExactRigidBodyIntegrator"}


def molecules() -> tuple[list[str], openmm.System, np.ndarray, np.ndarray]:
    """Return elements, three molecules without forces, their sites (3, 3) about the centre of mass, and masses."""
    topology, water, positions = rb.rigid_water(3)
    elements = [atom.element.symbol for atom in topology.atoms()]
    system = openmm.System()
    for i in range(water.getNumParticles()):
        system.addParticle(water.getParticleMass(i))
    for i in range(water.getNumConstraints()):
        system.addConstraint(*water.getConstraintParameters(i))
    masses = np.array([water.getParticleMass(i)._value for i in range(3)])
    x = positions._value[:3]
    return elements, system, x - masses @ x / masses.sum(), masses


class Tumbling:
    """The true motion of the three molecules, in closed form at any time."""

    def __init__(self, sites: np.ndarray, masses: np.ndarray) -> None:
        tensor = np.einsum("i,ij,ik->jk", masses, sites, sites)
        self.inertia, axes = np.linalg.eigh(np.trace(tensor) * np.eye(3) - tensor)
        self.sites = sites @ axes
        rng = np.random.default_rng(SEED)
        q = rng.standard_normal((3, 4))
        self.q = q / np.linalg.norm(q, axis=1)[:, None]
        self.m = rng.standard_normal((3, 3)) * np.sqrt(0.0083144626 * TEMPERATURE * self.inertia)

    def __call__(self, t: float) -> np.ndarray:
        """Return the positions of all atoms at a time in ps, (9, 3) in nm."""
        q, _ = rb.free_rotor(self.inertia, self.q, self.m, t)
        return (np.einsum("nij,kj->nki", rotation_matrix(q), self.sites) + PLACES[:, None]).reshape(-1, 3)


def simulated(system: openmm.System, truth: Tumbling, integrator: openmm.Integrator) -> Iterator[np.ndarray]:
    """Yield positions (9, 3) after every step of an integrator that starts with the true motion."""
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(truth(0.0))
    leapfrog = isinstance(integrator, openmm.VerletIntegrator)
    # Verlet's velocities are those of half a step before, by which it comes from the positions of a step before.
    tiny = STEP if leapfrog else 1e-6
    past, future = truth(-tiny), truth(0.0 if leapfrog else tiny)
    context.setVelocities((future - past) / (tiny if leapfrog else 2.0 * tiny))
    while True:
        yield context.getState(positions=True).getPositions(asNumpy=True)._value
        integrator.step(1)


def angles(x: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return by what angle in degrees each molecule of (9, 3) is turned away from the truth."""
    found = []
    for a, b in zip(x.reshape(3, 3, 3), true.reshape(3, 3, 3), strict=True):
        u, _, v = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
        turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
        found.append(np.degrees(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))))
    return np.array(found)


def draw(axes: plt.Axes, elements: list[str], x: np.ndarray, ghost: bool) -> None:
    """Draw molecules from the side, the near atoms last: as grey outlines, or solid."""
    for i in np.argsort(x[:, 2]):
        centre = i - i % 3
        depth = x[i, 2] - (2.0 if ghost else 0.0)
        line = {"color": "0.82" if ghost else "0.45", "lw": 9.0 if ghost else 4.0, "zorder": depth}
        axes.plot(*x[[centre, i], :2].T, solid_capstyle="round", **line)
        radius = RADIUS[elements[i]] + (0.012 if ghost else 0.0)
        style = {"fc": "0.82", "ec": "0.82"} if ghost else {"fc": COLOUR[elements[i]], "ec": "0.25", "lw": 0.8}
        axes.add_patch(plt.Circle(x[i, :2], radius, zorder=depth + 0.5, **style))


def picture(elements: list[str], runs: dict[str, np.ndarray], true: np.ndarray, t: float) -> Image.Image:
    """Draw both runs next to each other over the true motion."""
    figure, panels = plt.subplots(1, 2, figsize=(4.8, 4.0), dpi=100)
    figure.subplots_adjust(0.0, 0.11, 1.0, 0.93, 0.0)
    for axes, (name, x) in zip(panels, runs.items(), strict=True):
        axes.set(xlim=(-0.24, 0.24), ylim=(-0.37, 0.37), aspect="equal")
        axes.set_axis_off()
        draw(axes, elements, true, ghost=True)
        draw(axes, elements, x, ghost=False)
        axes.set_title(NAMES[name], fontsize=10.5, pad=4)
        for place, angle in zip(PLACES, angles(x, true), strict=True):
            axes.text(0.235, place[1] - 0.1, f"{angle:.0f}°", ha="right", va="center", fontsize=10, color="0.2")
    figure.text(0.5, 0.072, f"after {t:.2f} ps in steps of {1000 * STEP:.0f} fs", ha="center", va="center", fontsize=10)
    words = "grey: the true motion; numbers: the error of the orientation"
    figure.text(0.5, 0.028, words, ha="center", va="center", fontsize=8.5, color="0.3")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    plt.close(figure)
    return Image.open(buffer).convert("RGB")


def main() -> None:
    """Draw it."""
    elements, system, sites, masses = molecules()
    truth = Tumbling(sites, masses)
    integrators = {
        "VerletIntegrator": openmm.VerletIntegrator(STEP),
        "exact": rb.ExactRigidBodyIntegrator(STEP, scheme="V2"),
    }
    integrators["VerletIntegrator"].setConstraintTolerance(1e-12)
    runs = zip(*(simulated(system, truth, integrator) for integrator in integrators.values()), strict=True)
    film, errors = [], {}
    shown = {round(start / STEP) + EVERY * k for start in SCENES for k in range(FRAMES)}
    for k, x in zip(range(max(shown) + 1), runs, strict=False):
        if k in shown:
            true = truth(k * STEP)
            film.append(picture(elements, dict(zip(integrators, x, strict=True)), true, k * STEP))
            errors = {name: angles(last, true).round(3).tolist() for name, last in zip(integrators, x, strict=True)}
    palette = film[-1].quantize(64, kmeans=1)
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in film]
    times = ([80] * (FRAMES - 1) + [900]) * len(SCENES)
    frames[0].save(OUT, save_all=True, append_images=frames[1:], duration=times, loop=0)
    print(f"{OUT}: {len(frames)} pictures, {OUT.stat().st_size / 1e6:.1f} MB; errors at the end in degrees: {errors}")


if __name__ == "__main__":
    main()
