"""A picture of energy error over cost."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from openmm_exactrb.tuning.movers import VERLET
from openmm_exactrb.tuning.record import Record

# Of Okabe and Ito, and of Tol: told apart by colour-blind readers, each with a marker of its own.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#332288", "#882255")
_MARKERS = "sD^vpPX*"


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
    """Draw the schemes that are the best at some cost each in a colour, the others in grey."""
    curves = {method: record.curve(method) for method in record.seconds}
    points = [(p.cost, p.error, method) for method, curve in curves.items() if method != VERLET for p in curve]
    best = {name for cost, error, name in points if not any(c < cost and e < error for c, e, _ in points)}
    shown = [method for method in curves if method in best][: len(_COLOURS)]
    for method, curve in curves.items():
        if method not in (*shown, VERLET) and curve:
            axes.loglog(*_of(curve), color="0.8", lw=1.0, zorder=1)
    if len(curves) > len(shown) + 1:
        axes.plot([], [], color="0.8", lw=1.0, label="other schemes")
    for method, colour, marker in zip(shown, _COLOURS, _MARKERS, strict=False):
        axes.loglog(*_of(curves[method]), color=colour, marker=marker, label=method, ms=6, mec="white", mew=0.5, lw=1.8)
    if curves.get(VERLET):
        axes.loglog(*_of(curves[VERLET]), color="black", ls="--", marker="o", label=VERLET, ms=5, mew=0.5, lw=1.5)


def _of(curve: Any) -> Any:
    return np.array([(p.cost, p.error) for p in curve]).T


def _marks(axes: Any, record: Record) -> None:
    """Draw the target, the floor and the choice."""
    if record.target is not None:
        axes.axhline(record.target, color="0.4", lw=0.8, ls=(0, (6, 3)), label="target", zorder=0)
    if record.floor is not None:
        floor = record.floor
        axes.axhspan(1e-3 * floor, floor, color="0.85", label="below the floor", zorder=0)
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
    axes.grid(True, alpha=0.3)
    for kind in ("major", "minor"):
        getattr(axes.xaxis, f"set_{kind}_formatter")("{x:.3g}")
    axes.figure.legend(loc="outside right upper", fontsize=9)
    axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
