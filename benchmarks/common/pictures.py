"""Pictures that need no display, in colours that colour-blind readers can distinguish (Okabe and Ito)."""

from __future__ import annotations

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["STYLES", "plt"]

#: Colours with markers of their own.
STYLES = [
    ("#000000", "o"),
    ("#D55E00", "s"),
    ("#0072B2", "^"),
    ("#009E73", "v"),
    ("#CC79A7", "D"),
    ("#E69F00", "P"),
    ("#56B4E9", "X"),
    ("#999999", "x"),
]
