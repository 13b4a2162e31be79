"""The picture of energy error against cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from openmm_exactrb.tuning.candidates import VERLET
from openmm_exactrb.tuning.measurements import Point

# From the palettes of Okabe and Ito, and of Tol, for colour-blind readers; each colour has its own marker.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#332288", "#882255")
_MARKERS = "sD^vpPX*"


def new_figure(**settings: Any) -> tuple[Any, Any]:
    """Return an empty figure, and its axes with settings; ModuleNotFoundError without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            "the picture needs matplotlib: python -m pip install matplotlib", name="matplotlib"
        ) from None
    figure = Figure(figsize=(8.5, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(xscale="log", yscale="log", **settings)
    axes.grid(True, alpha=0.3)
    axes.xaxis.set_major_formatter("{x:.3g}")
    axes.xaxis.set_minor_formatter("{x:.3g}")
    axes.xaxis.get_minor_locator().set_params(subs=(2.0, 5.0))
    return figure, axes


def draw_curves(axes: Any, curves: Mapping[str, Sequence[Point]]) -> None:
    """Draw the schemes that are the best at some cost in colours, other schemes in grey and the baseline in black."""
    lines = {method: np.array([(p.cost, p.error) for p in curve]).T for method, curve in curves.items() if curve}
    points = [(p.cost, p.error, method) for method, curve in curves.items() if method != VERLET for p in curve]
    best = {name for cost, error, name in points if not any(c < cost and e < error for c, e, _ in points)}
    shown = [method for method in lines if method in best][: len(_COLOURS)]
    for method in lines.keys() - {*shown, VERLET}:
        axes.plot(*lines[method], color="0.8", lw=1.0, zorder=1)
    if len(curves) > len(shown) + 1:
        axes.plot([], [], color="0.8", lw=1.0, label="other schemes")
    for method, colour, marker in zip(shown, _COLOURS, _MARKERS, strict=False):
        axes.plot(*lines[method], color=colour, marker=marker, label=method, ms=6, mec="white", mew=0.5, lw=1.8)
    if VERLET in lines:
        axes.plot(*lines[VERLET], color="black", ls="--", marker="o", label=VERLET, ms=5, mew=0.5, lw=1.5)
