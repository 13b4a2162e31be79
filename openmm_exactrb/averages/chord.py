"""The step-size error of drifts that move particles in straight lines and then back onto their constraints.

In each drift, LangevinMiddleIntegrator moves the particles along a chord: first as if there were no constraints, and
then back onto the constraints along their gradients at the start of the drift. With a heat exchange halfway through
such a drift, the conserved quantity next to the exchange has the additional term

    h² T,        T = a·M a/24,

where a is the acceleration of the free motion with these constraints. Half of the noise along the gradients of the
constraints enters the velocities, but changes no average to second order in the step. Let r_c be the vector between the
two ends of constraint c, u_c its rate of change, and E the matrix that computes the differences between ends. Then

    a·M a = q·Z⁻¹q,        q_c = |u_c|²,        Z_cd = L_cd r_c·r_d,        L = E M⁻¹Eᵀ.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.support.types import Array, Indices

# Eigenvalues of Z below this fraction of the largest one belong to redundant constraints. For a flat pyramid of
# constraints, the fraction is the square of its slope. The fraction must be far above h²ω² for a rotation with the
# angular velocity ω.
_INDEPENDENT = 1e-4
# The largest number of constraints in a cluster, whose matrices are dense here.
_LARGEST = 100


class _Held(NamedTuple):
    """Clusters with the same graph: the ends (N, m, 2) of constraints, and the matrix L (m, m) in 1/Da."""

    ends: Indices
    inverse_mass: Array


class Chords:
    """The conserved term h² T of drifts along chords, for the constrained particles of a System.

    Parameters
    ----------
    bodies : RigidBodies
    pairs : (m, 2) array
        The particles of all constraints of the System.
    x : (n_particles, 3) array
        Positions in nm that satisfy the constraints of nonrigid clusters.

    Raises
    ------
    ValueError
        If the constraints of a rigid body do not fix its shape to first order, or a cluster has too many constraints.
    """

    def __init__(self, bodies: RigidBodies, pairs: Indices, x: Array) -> None:
        self._flexible, self._rigid, lost = [], 0.0, 0
        for particles, masses, own, sites in _clusters(bodies, pairs):
            if len(own) > _LARGEST:
                raise ValueError(
                    f"averages of LangevinMiddleIntegrator cannot be corrected, because {len(own)} constraints join "
                    f"the particles of one molecule, but at most {_LARGEST} are supported: create the System with "
                    "constraints=HBonds, or use ExactRigidBodyLangevinIntegrator"
                )
            differences = np.eye(len(masses))[own[:, 0]] - np.eye(len(masses))[own[:, 1]]
            held = _Held(particles[:, own], differences / masses @ differences.T)
            # The shape of a rigid body is used instead of its positions, because initial positions may be inaccurate.
            r = _vectors(held, x) if sites is None else sites[:, own[:, 0]] - sites[:, own[:, 1]]
            ranks = np.linalg.matrix_rank(_matrix(held, r), rtol=_INDEPENDENT, hermitian=True)
            alike = len(particles) // len(r)
            lost += alike * int(ranks.sum())
            if sites is None:
                self._flexible.append(held)
            else:
                self._rigid += alike * _mean(held, r)
        particles_with_mass = sum(kind.particles.size for kind in bodies.kinds)
        if 3 * particles_with_mass - lost != bodies.translational_freedom + bodies.rotational_freedom:
            raise ValueError(
                "averages of LangevinMiddleIntegrator cannot be corrected for linear molecules with more than two "
                "constrained atoms, or nearly planar ones with more than three: use ExactRigidBodyLangevinIntegrator"
            )

    def mean(self, x: Array, kT: float) -> float:
        """Return the mean of T over canonical velocities at positions (n_particles, 3), in kJ/mol/ps²."""
        return kT**2 * (self._rigid + sum(_mean(held, _vectors(held, x)) for held in self._flexible))


def _clusters(bodies: RigidBodies, pairs: Indices) -> Iterator[tuple[Indices, Array, Indices, Array | None]]:
    """Yield particles (N, n), masses (n,), members of constraints (m, 2), and the sites of rigid clusters.

    Sites, in nm, are (1, n, 3) for clusters of one shape, (N, n, 3) for other rigid ones, None for nonrigid ones.
    """
    for kind in bodies.kinds:
        if kind.turns:
            number = np.full(bodies.n_particles, -1)
            number[kind.particles[0]] = np.arange(len(kind.masses))
            own = number[pairs]
            yield kind.particles, kind.masses, own[(own >= 0).all(axis=1)], kind.sites
    for cluster in bodies.clusters.kinds:
        yield cluster.particles, cluster.masses, cluster.pairs, None


def _vectors(held: _Held, x: Array) -> Array:
    """Return the vectors r (N, m, 3) of constraints in nm."""
    return np.asarray(x[held.ends[:, :, 0]] - x[held.ends[:, :, 1]])


def _matrix(held: _Held, r: Array) -> Array:
    """Return the matrices Z (N, m, m) in nm²/Da."""
    return np.asarray(held.inverse_mass * (r @ r.transpose(0, 2, 1)))


def _mean(held: _Held, r: Array) -> float:
    """Return the mean of T, summed over clusters and divided by the square of kT, in mol/(kJ ps²).

    The rates u have the covariance C = W - W Rᵀ Z⁻¹ R W, where W = L ⊗ 1 and R contains the vectors r. The mean of q_c
    q_d is the product of the traces of C_cc and C_dd plus twice the sum of the squares of the entries of C_cd.
    """
    inverse = np.linalg.pinv(_matrix(held, r), rcond=_INDEPENDENT, hermitian=True)
    forced = held.inverse_mass[:, None, :] * r.transpose(0, 2, 1)[:, None]  # W Rᵀ, (N, m, 3, m)
    rates = np.einsum("cd,ab->cadb", held.inverse_mass, np.eye(3)) - np.einsum(
        "ncap,npq,ndbq->ncadb", forced, inverse, forced, optimize=True
    )
    traces = np.einsum("ncaca->nc", rates)
    products = traces[:, :, None] * traces[:, None, :] + 2.0 * (rates**2).sum(axis=(2, 4))
    return float((inverse * products).sum()) / 24.0
