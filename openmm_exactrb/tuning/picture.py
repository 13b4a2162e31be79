"""A picture of energy error over cost."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from openmm_exactrb.tuning.movers import VERLET
from openmm_exactrb.tuning.record import Record

# Of Okabe and Ito, and of Tol: told apart by colour-blind readers, with markers beside.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#999999", "#882255")
_MARKERS = "so^vDPX*"


def draw(record: Record, file: str | os.PathLike[str]) -> None:
    """Draw energy error over cost; see `Tuning.draw`."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            "the picture needs matplotlib: python -m pip install matplotlib", name="matplotlib"
        ) from None
    figure = Figure(figsize=(8.5, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _curves(axes, record)
    _marks(axes, record)
    _frame(axes, record)
    figure.savefig(file, dpi=150)


def _curves(axes: Any, record: Record) -> None:
    ours = 0
    for method in record.seconds:
        curve = record.curve(method)
        style = {"color": "black", "ls": "--", "marker": "o"}
        if method != VERLET:
            style = {
                "color": _COLOURS[ours % len(_COLOURS)],
                "ls": ("-", ":")[ours // len(_COLOURS) % 2],
                "marker": _MARKERS[ours % len(_MARKERS)],
            }
            ours += 1
        if curve:
            values = np.array([(p.cost, p.error) for p in curve])
            axes.loglog(*values.T, label=method, ms=5, mec="black", mew=0.4, lw=1.2, **style)


def _marks(axes: Any, record: Record) -> None:
    """Draw the target, the floor and the choice."""
    if record.target is not None:
        axes.axhline(record.target, color="0.4", lw=0.8, ls=(0, (6, 3)), label="target", zorder=0)
    if record.floor is not None:
        floor = record.floor
        axes.axhspan(1e-3 * floor, floor, color="0.85", label="below the floor of the forces", zorder=0)
    if record.chosen is not None:
        at = record.chosen.cost, record.chosen.error
        label = f"chosen: {record.chosen.method}, {1e3 * record.chosen.step:.3g} fs"
        axes.loglog(*at, "o", ms=14, mfc="none", mec="black", mew=1.5, ls="", label=label)


def _frame(axes: Any, record: Record) -> None:
    from matplotlib.ticker import LogLocator

    errors = [p.error for name in record.seconds for p in record.curve(name)]
    axes.set_ylim(bottom=0.4 * min([*errors, record.target or math.inf], default=1.0))
    axes.set_xlabel("wall time (s per ps)")
    axes.set_ylabel(f"std of total energy over {record.horizon:.3g} ps (kJ/mol per body)")
    axes.set_title(f"{record.n_bodies} bodies, {record.platform} platform")
    axes.grid(True, which="both", alpha=0.2)
    for kind in ("major", "minor"):
        getattr(axes.xaxis, f"set_{kind}_formatter")("{x:.3g}")
    axes.figure.legend(loc="outside right upper", fontsize=8)
    axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
