"""A sphere on which the other pictures draw."""

import numpy as np
from mpl_toolkits.mplot3d import Axes3D

BLUE, ORANGE, RED, BLACK = "#0072B2", "#E69F00", "#D55E00", "#000000"  # of Okabe and Ito


def draw_sphere(axes: Axes3D, azimuth: float, elevation: float, zoom: float) -> Axes3D:
    """Draw a grey sphere of radius 1 in orthographic projection."""
    u, v = np.mgrid[0 : 2 * np.pi : 61j, 0 : np.pi : 31j]
    axes.plot_surface(
        np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v), color="0.93", alpha=0.8, lw=0, shade=False, zorder=-10
    )
    axes.set_box_aspect((1, 1, 1), zoom=zoom)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
    axes.view_init(elev=elevation, azim=azimuth)
    axes.set_proj_type("ortho")
    axes.set_axis_off()
    return axes


def eye(axes: Axes3D) -> np.ndarray:
    """Return the unit vector to the observer."""
    azimuth, elevation = np.radians([axes.azim, axes.elev])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
