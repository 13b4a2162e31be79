"""Rigid bodies in numpy: the reference of the compiled kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mathematics.compensated import add
from openmm_exactrb.mathematics.quaternions import matrix, turned

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def place(R: Array, q: Array, particles: Indices, sites: Array, first: int, x: Array) -> None:
    """Write the positions R + Q b of the particles (n, k) of bodies `first` to `first` + n into rows of x (., 3).

    R is (3, N) and q (4, K); sites (1, k, 3) or (n, k, 3) are the positions b in the bodies, of all or of each.
    """
    bodies = slice(first, first + len(particles))
    x[particles] = R.T[bodies, None] + turned(matrix(q[:, bodies]).transpose(2, 0, 1), sites)


def move(V: Array, omega: Array, q: Array, particles: Indices, sites: Array, first: int, v: Array) -> None:
    """Write the velocities V + Q (omega x b) of the particles of bodies `first` to `first` + n into rows of v (., 3).

    V is (3, N) in space, omega (3, K) in the bodies; other arguments are those of `place`.
    """
    bodies = slice(first, first + len(particles))
    relative = np.cross(omega.T[bodies, None], sites)
    v[particles] = V.T[bodies, None] + np.einsum("ijn,nsj->nsi", matrix(q[:, bodies]), relative)


def collect(q: Array, particles: Indices, sites: Array, first: int, forces: Array, total: Array, torque: Array) -> None:
    """Sum the forces (., 3) on the particles to the forces (3, N) and body-frame torques (3, K) of some bodies."""
    bodies = slice(first, first + len(particles))
    F = forces[particles]
    n, k, _ = F.shape
    by_site = np.ascontiguousarray(F.transpose(1, 2, 0))
    total[:, bodies] = by_site.sum(axis=0)
    # Moment D = sum over sites of b F^T, space components second; the torque is sum_c D_c x (Q^T e_c).
    if len(sites) == 1:
        D = (sites[0].T @ by_site.reshape(k, 3 * n)).reshape(3, 3, n)
    else:
        D = np.einsum("nsa,sin->ain", sites, by_site)
    E = matrix(q[:, bodies]).swapaxes(0, 1)
    torque[0, bodies] = (D[1] * E[2] - D[2] * E[1]).sum(axis=0)
    torque[1, bodies] = (D[2] * E[0] - D[0] * E[2]).sum(axis=0)
    torque[2, bodies] = (D[0] * E[1] - D[1] * E[0]).sum(axis=0)


def advance(x: Array, rate: Array, t: float, total: Array) -> None:
    """Write x + t rate of double-doubles x (2, k, N) and rates (k, N) into `total`."""
    total[...] = add(x, t * rate)
