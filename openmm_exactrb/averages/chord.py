"""The step-size error of drifts that move particles straight on and then back onto their constraints.

LangevinMiddleIntegrator drifts along a chord: it goes as far as it would without constraints, and is brought back along
their gradients at the start. With the heat exchange halfway, such a drift conserves in addition, next to the exchange,

    h² T,        T = a·M a/24,

where a is the acceleration of a free motion with these constraints; the noise along the gradients, which enters the
velocities by half, changes no average to second order. Let r_c be the vector between the two ends of a constraint, u_c
its rate, and E the matrix of the differences of ends. Then

    a·M a = q·Z⁻¹q,        q_c = |u_c|²,        Z_cd = L_cd r_c·r_d,        L = E M⁻¹Eᵀ.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Constraints less independent than this, relative to the others of a cluster, follow from them.
_INDEPENDENT = 1e-8
# Constraints of a cluster, whose matrices are dense here.
_LARGEST = 100


class _Held(NamedTuple):
    """Clusters of one graph: the ends (N, m, 2) of their constraints, and the matrix L (m, m)."""

    ends: Indices
    inverse_mass: Array


class Chords:
    """What the drifts of the constrained particles of a System conserve.

    Parameters
    ----------
    bodies : RigidBodies
    pairs : (m, 2) array
        The particles of all constraints.
    x : (n_particles, 3) array
        Positions in nm.

    Raises
    ------
    ValueError
        If constraints do not hold a rigid body at first order, or a cluster has too many.
    """

    def __init__(self, bodies: RigidBodies, pairs: Indices, x: Array) -> None:
        self._flexible, self._rigid, lost = [], 0.0, 0
        for particles, masses, own, rigid in _clusters(bodies, pairs):
            if len(own) > _LARGEST:
                raise ValueError(
                    f"averages of LangevinMiddleIntegrator cannot be corrected with {len(own)} constraints in one "
                    "cluster: constrain bonds with hydrogens only (HBonds), or use ExactRigidBodyLangevinIntegrator"
                )
            differences = np.zeros((len(own), len(masses)))
            differences[np.arange(len(own)), own[:, 0]], differences[np.arange(len(own)), own[:, 1]] = 1.0, -1.0
            held = _Held(particles[:, own], differences / masses @ differences.T)
            lost += int(np.linalg.matrix_rank(_matrix(held, x)[1], rtol=_INDEPENDENT, hermitian=True).sum())
            if rigid:
                self._rigid += _mean(held, x)
            else:
                self._flexible.append(held)
        particles_with_mass = sum(kind.particles.size for kind in bodies.kinds)
        if 3 * particles_with_mass - lost != bodies.translational_freedom + bodies.rotational_freedom:
            raise ValueError(
                "averages of LangevinMiddleIntegrator cannot be corrected for linear molecules of more than two "
                "constrained atoms or planar ones of more than three: use ExactRigidBodyLangevinIntegrator"
            )

    def mean(self, x: Array, kT: float) -> float:
        """Return the mean of T over canonical velocities at positions (n_particles, 3), in kJ/mol/ps²."""
        return kT**2 * (self._rigid + sum(_mean(held, x) for held in self._flexible))


def _clusters(bodies: RigidBodies, pairs: Indices) -> Iterator[tuple[Indices, Array, Indices, bool]]:
    """Yield particles (N, n), masses (n,) and members of constraints (m, 2) of clusters, and whether they are rigid."""
    for kind in bodies.kinds:
        if kind.turns:
            number = np.full(bodies.n_particles, -1)
            number[kind.particles[0]] = np.arange(len(kind.masses))
            own = number[pairs]
            yield kind.particles, kind.masses, own[(own >= 0).all(axis=1)], True
    for cluster in bodies.clusters.kinds:
        yield cluster.particles, cluster.masses, cluster.pairs, False


def _matrix(held: _Held, x: Array) -> tuple[Array, Array]:
    """Return the vectors r (N, m, 3) of constraints, and the matrices Z (N, m, m)."""
    r = x[held.ends[:, :, 0]] - x[held.ends[:, :, 1]]
    return r, held.inverse_mass * (r @ r.transpose(0, 2, 1))


def _mean(held: _Held, x: Array) -> float:
    """Return the mean of T, summed over clusters, at kT = 1.

    The rates u have the covariance C = W - W Rᵀ Z⁻¹ R W, where W = L ⊗ 1 and R has the vectors r; the mean of q_c q_d
    is the product of the traces of C_cc and C_dd and twice the square of C_cd.
    """
    r, z = _matrix(held, x)
    inverse = np.linalg.pinv(z, rcond=_INDEPENDENT, hermitian=True)
    forced = held.inverse_mass[:, None, :] * r.transpose(0, 2, 1)[:, None]  # W Rᵀ, (N, m, 3, m)
    rates = np.einsum("cd,ab->cadb", held.inverse_mass, np.eye(3)) - np.einsum(
        "ncap,npq,ndbq->ncadb", forced, inverse, forced, optimize=True
    )
    traces = np.einsum("ncaca->nc", rates)
    products = traces[:, :, None] * traces[:, None, :] + 2.0 * (rates**2).sum(axis=(2, 4))
    return float((inverse * products).sum()) / 24.0
