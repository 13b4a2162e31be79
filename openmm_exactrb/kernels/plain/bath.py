"""Momenta in a bath, in numpy: see `openmm_exactrb.motion.bath`."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.compensated import add
from openmm_exactrb.kernels.plain.noise import Array, normals


def relax(
    x: Array,
    width: Array,
    fade: float,
    spread: float,
    seed: int,
    step: int,
    stream: int,
    first: int,
    last: int,
    total: Array,
) -> None:
    """Write x + fade x + spread width xi of sums x (2, k, N), or x (1, k, N), into columns of `total`.

    Parameters
    ----------
    x, total : (2, k, N) or (1, k, N) arrays
    width : (k, N) array
    fade, spread : float
    seed, step, stream, first, last : int
        Those of the normals xi, and the columns [first, last) that are written: see `plain.noise.normals`.
    """
    xi = np.empty(x.shape[1:])
    normals(seed, step, stream, first, last, xi)
    here = np.s_[..., first:last]
    total[here] = add(x[here], fade * x[0][here] + spread * width[here] * xi[here])
