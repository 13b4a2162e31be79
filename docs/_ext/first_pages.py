"""Draw the pictures of the first pages: a protein with what it costs, the tree of decisions, and a step.

Run ``python docs/_ext/first_pages.py``. Speeds are those of benchmarks/records, and the step is that of the scheme. The
droplet on the first page, dipoles.png, is the picture that ``make run`` draws.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from openmm import app, unit

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.common.markdown import rows
from benchmarks.common.records import PICTURES
from openmm_exactrb.command.description import PROTEIN, PROTEIN_AND_WATER
from openmm_exactrb.schemes import splitting
from openmm_exactrb.steps.substeps import DRIFT

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

OURS, THEIRS, GREY = "#0072B2", "#E69F00", "#666666"
COLOURS = {"C": "#555555", "N": "#0072B2", "O": "#D55E00", "S": "#E69F00"}
plt.rcParams.update({"font.size": 11, "axes.spines.top": False, "axes.spines.right": False})


# -- a protein, and simulated time per day --------------------------------------------------------------------------


class Bar(NamedTuple):
    """The simulated time per day of an integrator, relative to OpenMM's at 4 fs; None if it was not measured."""

    label: str
    relative: float | None
    note: str
    colour: str


NAMES = {
    "LangevinMiddle": ("OpenMM, 4 fs", THEIRS),
    "AllBonds": ("OpenMM, 8 fs, AllBonds", THEIRS),
    "ours": ("this package, 8 fs", OURS),
}


def on_a_processor() -> list[Bar]:
    """Return the bars of villin on one core, from one_line.csv: medians of time per force evaluation."""
    found = {
        row["run"]: 2.0 / float(row["median"])
        for row in rows("one_line")
        if row["system"].startswith("villin") and row["threads"] == "1" and "4 fs" in row["relative_to"]
    }
    of_run = {
        "LangevinMiddle": 1.0,
        "AllBonds": found["LangevinMiddleIntegrator, 8 fs, AllBonds"],
        "ours": found[f"{PROTEIN}, 8 fs"],
    }
    return [Bar(NAMES[key][0], value, f"{value:.1f}", NAMES[key][1]) for key, value in of_run.items()]


def on_a_gpu() -> list[Bar]:
    """Return the bars of DHFR on an NVIDIA H200, from device_costs.csv."""
    found = {r["integrator"]: float(r["ns/day"]) for r in rows("device_costs") if r["system"].startswith("5dfr")}
    theirs, ours = found["LangevinMiddle"], found[f"{PROTEIN_AND_WATER} native"]
    return [
        Bar(NAMES["LangevinMiddle"][0], 1.0, f"{theirs:.0f} ns/day", THEIRS),
        Bar(NAMES["AllBonds"][0], None, "not timed", THEIRS),
        Bar(f"this package, 8 fs, {PROTEIN_AND_WATER}", ours / theirs, f"{ours:.0f} ns/day", OURS),
    ]


def protein() -> Figure:
    """Return villin in water, and the simulated time per day on a processor and on a GPU."""
    figure = plt.figure(figsize=(5.8, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 2.0))
    villin(left)
    groups = (("processor: villin, one core", on_a_processor()), ("NVIDIA H200: DHFR", on_a_gpu()))
    y = 0.0
    for title, bars in groups:
        right.text(0.0, y - 0.1, title, weight="bold", va="bottom")
        for bar in bars:
            y += 1.0
            right.barh(y - 0.42, bar.relative or 0.0, height=0.8, color=bar.colour)
            inside = bar.relative is not None
            right.text(
                0.04, y - 0.42, bar.label, va="center", size=10.5, color="white" if bar.colour == OURS else "black"
            )
            at = max(bar.relative or 0.0, 1.35 if not inside else 0.0) + 0.04
            right.text(at, y - 0.42, bar.note, va="center", size=10.5, weight="bold" if inside else "normal")
        y += 1.1
    right.set_ylim(y - 1.0, -0.7)
    right.set_xlim(0.0, 2.55)
    right.set_title("simulated time per day, OpenMM at 4 fs = 1", size=10.5, loc="left")
    right.axis("off")
    return figure


def villin(axes: Axes) -> None:
    """Draw the protein in water that comes with OpenMM, as spheres, the nearest on top."""
    pdb = app.PDBFile(str(Path(app.__file__).parent / "data" / "test.pdb"))
    x = np.array(pdb.positions.value_in_unit(unit.nanometer))
    atoms = [a for a in pdb.topology.atoms() if a.element is not None and a.element.symbol != "H"]
    of_protein = np.array([a.index for a in atoms if a.residue.name not in ("HOH", "Cl", "CL")])
    centre = x[of_protein].mean(axis=0)
    water = np.array([a.index for a in atoms if a.residue.name == "HOH"])
    water = water[np.abs(x[water] - centre)[:, 2] < 0.6]
    axes.scatter(*x[water, :2].T, s=9, color="#9ecae1", alpha=0.6, lw=0)
    order = of_protein[np.argsort(x[of_protein, 2])]
    symbols = {a.index: a.element.symbol for a in atoms}
    depth = np.linspace(0.55, 0.0, len(order))[:, None]  # distant atoms are paler
    colours = (1.0 - depth) * mpl.colors.to_rgba_array([COLOURS[symbols[i]] for i in order])[:, :3] + depth
    axes.scatter(*x[order, :2].T, s=70, c=colours, edgecolors="white", lw=0.4)
    for direction, middle in zip((axes.set_xlim, axes.set_ylim), centre, strict=False):
        direction(middle - 1.75, middle + 1.75)
    axes.set_aspect("equal")
    axes.axis("off")


# -- the tree of decisions -------------------------------------------------------------------------------------------

#: Each leaf: what is simulated, and what to use, with its colour.
LEAVES = (
    (
        "a protein in water",
        (("8 fs, heavy hydrogens: within 1 K", OURS), ("OpenMM at 8 fs: as fast, peptide 4 K too hot", THEIRS)),
    ),
    ("water", (("constant T or p: OpenMM at 4 fs", THEIRS), ("constant energy: W4_4 at 2 fs", OURS))),
    ("dipoles, rigid bodies", (("W4_4; bodies= for your own bodies", OURS),)),
    ("exact averages", (("OpenMM at 2 to 4 fs, corrected", THEIRS), ("or hybrid Monte Carlo", OURS))),
    ("new methods", (("40 schemes, 16 rotors, or your own", OURS),)),
)


def tree() -> Figure:
    """Return the tree whose leaves are the sections of the deciding page."""
    figure, axes = plt.subplots(figsize=(5.2, 5.4), layout="constrained")
    axes.text(0.0, 0.0, "What do you simulate?", size=14, weight="bold", va="center")
    y, middles = -0.75, []
    for title, uses in LEAVES:
        height = 0.62 * (1 + len(uses)) + 0.16
        middle = y - 0.5 * height
        axes.add_patch(plt.Rectangle((0.5, y - height), 6.0, height, fc="#f4f6f8", ec=GREY, lw=1.0))
        axes.text(0.68, y - 0.4, title, size=13, weight="bold", va="center")
        for k, (text, colour) in enumerate(uses):
            line = y - 0.4 - 0.62 * (k + 1)
            axes.add_patch(plt.Rectangle((0.7, line - 0.16), 0.22, 0.32, fc=colour, ec="none"))
            axes.text(1.06, line, text, size=12.5, va="center")
        middles.append(middle)
        y -= height + 0.25
    axes.plot([0.15, 0.15], [-0.3, middles[-1]], color=GREY, lw=1.5)
    for middle in middles:
        axes.plot([0.15, 0.5], [middle, middle], color=GREY, lw=1.5)
    for x, name, colour in ((0.5, "this package", OURS), (3.0, "stay with OpenMM", THEIRS)):
        axes.add_patch(plt.Rectangle((x, y - 0.3), 0.22, 0.32, fc=colour, ec="none"))
        axes.text(x + 0.36, y - 0.14, name, size=12, va="center")
    axes.set_xlim(-0.05, 6.6)
    axes.set_ylim(y - 0.4, 0.4)
    axes.axis("off")
    return figure


# -- a step ----------------------------------------------------------------------------------------------------------

INTERVAL = 8.0


def kicks(name: str) -> tuple[float, list[float]]:
    """Return the length of a step of a scheme, and the times of its force evaluations, in fs."""
    scheme, at, found = splitting(name), 0.0, []
    step = INTERVAL * scheme.forces
    for substep, part in scheme.sequence:
        at += part * step if substep == DRIFT else 0.0
        found += [at] if substep.kicks else []
    return step, found


def evaluations(number: int) -> str:
    """Return a number of force evaluations as text."""
    return "one force evaluation" if number == 1 else f"{number} force evaluations"


def steps() -> Figure:
    """Return two time lines, of OpenMM's integrator and of this package, with forces, frames and barostat."""
    end, lines = 48.0, [("LangevinMiddleIntegrator at 4 fs", THEIRS, 4.0, [0.0])]
    lines += [(f"{name} at {INTERVAL:g} fs", OURS, *kicks(name)) for name in (PROTEIN, PROTEIN_AND_WATER)]
    figure, axes = plt.subplots(figsize=(5.8, 4.6), layout="constrained")
    for y, (name, colour, length, within) in zip((4.0, 2.0, 0.0), lines, strict=True):
        axes.text(0.0, y + 0.72, f"{name}: a step is {evaluations(len(within))}", size=11, weight="bold")
        for number in range(round(end / length)):
            start = number * length
            axes.add_patch(plt.Rectangle((start, y - 0.3), length, 0.6, fc=colour, alpha=0.3, ec="none"))
            axes.add_patch(plt.Rectangle((start, y - 0.3), length, 0.6, fc="none", ec="black", lw=1.0))
            axes.text(start + 0.5 * length, y - 0.05, f"{number + 1}", ha="center", va="center", size=10)
            axes.vlines([start + t for t in within], y - 0.3, y + 0.42, color=colour, lw=3.5)
            axes.plot(start + length, y - 0.52, marker="^", color="black", ms=7)
        axes.text(end + 1.2, y - 0.05, "step", size=10, va="center")
    axes.annotate("", (end + 3.0, -1.15), (0.0, -1.15), arrowprops={"arrowstyle": "->"})
    for t in range(0, 49, 8):
        axes.plot([t, t], [-1.2, -1.1], color="black", lw=1.0)
        axes.text(t, -1.45, f"{t}", ha="center", va="center", size=10)
    axes.text(end + 3.4, -1.45, "fs", va="center", size=10)
    axes.vlines(1.0, 5.4, 5.8, color=GREY, lw=3.0)
    axes.text(2.2, 5.6, "forces are evaluated", va="center", size=10)
    axes.plot(22.0, 5.6, marker="^", color="black", ms=8)
    axes.text(23.5, 5.6, "a barostat may act, a frame is written", va="center", size=10)
    axes.set_xlim(-1.0, end + 5.5)
    axes.set_ylim(-1.7, 5.9)
    axes.axis("off")
    return figure


#: The pictures by name.
DRAWN = {"protein": protein, "tree": tree, "steps": steps}


def main() -> None:
    """Draw all pictures into docs/pictures."""
    for name, draw in DRAWN.items():
        figure = draw()
        figure.savefig(PICTURES / f"{name}.png", dpi=160)
        plt.close(figure)


if __name__ == "__main__":
    main()
