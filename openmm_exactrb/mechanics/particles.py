"""Rigid bodies: positions and velocities of particles, and sums of forces and torques, in numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from openmm_exactrb.mathematics.compensated import add
from openmm_exactrb.mathematics.quaternions import matrix
from openmm_exactrb.support.types import Array, Indices


class Particles(NamedTuple):
    """The particles of bodies, ordered by body; every body has at least one."""

    starts: Indices  #: the first particle of each body (N + 1,)
    rows: Indices  #: row of each particle in arrays of all particles of a System (n,)
    sites: Array  #: the position of each particle in its body (n, 3), used for bodies that rotate


def place(R: Array, q: Array, particles: Particles, x: Array) -> None:
    """Write the positions R + Q b of particles into rows of x (., 3); bodies that do not turn have no q."""
    owner, Q = _attitudes(q, particles)
    x[particles.rows] = R.T[owner] + np.einsum("nij,nj->ni", Q, particles.sites)


def move(V: Array, omega: Array, q: Array, particles: Particles, v: Array) -> None:
    """Write the velocities V + Q (omega x b); V is (3, N) in space, omega (3, K) in the bodies."""
    owner, Q = _attitudes(q, particles)
    spin = np.zeros(V.shape)
    spin[:, : omega.shape[1]] = omega
    v[particles.rows] = V.T[owner] + np.einsum("nij,nj->ni", Q, np.cross(spin.T[owner], particles.sites))


def collect(q: Array, particles: Particles, forces: Array, total: Array, torque: Array) -> None:
    """Sum the forces (., 3) on the particles to the forces (3, N) and body-frame torques (3, K)."""
    owner, Q = _attitudes(q, particles)
    F, turning = forces[particles.rows], owner < q.shape[1]
    about = np.cross(particles.sites, np.einsum("nji,nj->ni", Q, F))
    total[:], torque[:] = 0.0, 0.0
    np.add.at(total.T, owner, F)
    np.add.at(torque.T, owner[turning], about[turning])


def advance(x: Array, rate: Array, t: float, total: Array) -> None:
    """Write x + t rate of double-doubles x (2, k, N) and rates (k, N) into `total`."""
    total[...] = add(x, t * rate)


def _attitudes(q: Array, particles: Particles) -> tuple[Indices, Array]:
    """Return the body of each particle, and its rotation matrix (n, 3, 3), which is zero where it does not turn."""
    owner = np.repeat(np.arange(len(particles.starts) - 1), np.diff(particles.starts))
    Q = np.zeros((len(particles.starts) - 1, 3, 3))
    Q[: q.shape[1]] = matrix(q).transpose(2, 0, 1)
    return owner, Q[owner]
