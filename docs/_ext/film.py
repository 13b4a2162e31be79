"""The droplet as a film, docs/droplet.gif: ``python docs/_ext/film.py``."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
from droplet import frames
from PIL import Image

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path("docs/droplet.gif")
DISTANCE = 4.0  # nm, of the eye
RADIUS = {"O": 0.085, "H": 0.055}  # nm
COLOUR = {"O": np.array([0.84, 0.37, 0.0]), "H": np.array([0.92, 0.92, 0.92])}


def picture(symbols: list[str], x: np.ndarray) -> Image.Image:
    """Draw molecules in perspective, the far ones first and paler."""
    figure = plt.figure(figsize=(3.2, 3.2), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), aspect="equal")
    axes.set_axis_off()
    nearness = DISTANCE / (DISTANCE - x[:, 2])
    flat = x[:, :2] * nearness[:, None]
    depth = np.clip((x[:, 2] + 1.0) / 2.0, 0.0, 1.0)
    for i in np.argsort(x[:, 2]):
        shade = 0.45 + 0.55 * depth[i]
        colour = 1.0 - shade * (1.0 - COLOUR[symbols[i]])
        place = i - i % 3
        if i != place:
            axes.plot(*flat[[place, i]].T, color="0.55", lw=4.0 * nearness[i] * shade, zorder=x[i, 2] - 0.01)
        axes.add_patch(
            plt.Circle(
                flat[i], RADIUS[symbols[i]] * nearness[i], fc=colour, ec=str(0.7 - 0.5 * shade), lw=0.6, zorder=x[i, 2]
            )
        )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    plt.close(figure)
    return Image.open(buffer).convert("P", palette=Image.Palette.ADAPTIVE, colors=24)


def main() -> None:
    """Draw it, there and back."""
    film = [picture(symbols, x - x.mean(axis=0)) for symbols, x in frames()]
    film += film[-2:0:-1]  # back to the start, without a jump
    film[0].save(OUT, save_all=True, append_images=film[1:], duration=50, loop=0, optimize=True)
    print(f"{OUT}: {len(film)} pictures, {OUT.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
