"""Rigid bodies and single particles in one set of arrays, and the particles that form the bodies.

Bodies of one kind are contiguous, and kinds that rotate precede single particles, which have no orientation. Among the
single particles, the atoms of constrained, nonrigid clusters come first, in the order of
`openmm_exactrb.constraints.clusters`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.constraints.clusters import Clusters, ClusterState
from openmm_exactrb.mechanics.particles import Particles, collect, move, place
from openmm_exactrb.mechanics.state import BodyState, State
from openmm_exactrb.support.messages import listed
from openmm_exactrb.support.types import Array, Indices

# Ratio of the smallest to the largest moment below which a body is thin, so that light particles define its
# orientation.
_THIN = 1e-6


@dataclass(frozen=True)
class Kind:
    """Bodies with the same masses and with common or individual shapes, in principal axes about the centre of mass."""

    particles: Indices  #: the k particles with mass of each of the n bodies (n, k)
    bodies: slice  #: indices of the bodies among all bodies
    masses: Array  #: masses of the particles (k,)
    sites: Array  #: positions of the particles, for all bodies (1, k, 3) or for each (n, k, 3)
    mass: float
    inertia: Array  #: ascending moments (1, 3) or (n, 3); the first is 0 for a linear body, all are 0 for a point

    def only(self, chosen: NDArray[np.bool_]) -> Kind:
        """Return the kind with only the bodies of a mask (n,); the indices `bodies` are unchanged."""
        sites, inertia = (a if len(a) == 1 else a[chosen] for a in (self.sites, self.inertia))
        return replace(self, particles=self.particles[chosen], sites=sites, inertia=inertia)

    @property
    def turns(self) -> bool:
        """Whether the bodies have an orientation, unlike single and coincident particles."""
        return bool(self.inertia.any())

    @property
    def linear(self) -> bool:
        """Whether all sites lie on axis 1."""
        return self.turns and bool(self.inertia[0, 0] == 0.0)

    @property
    def weights(self) -> Array:
        """Weights (k,) for the fit of an orientation: the masses, or ones if the body is thin."""
        thin = self.turns and not self.linear and bool((self.inertia[:, 0] < _THIN * self.inertia[:, 2]).any())
        return np.ones(len(self.masses)) if thin else self.masses


class RigidBodies:
    """The N bodies of a System of `n_particles`: rigid bodies, and the particles that belong to no rigid body.

    The kinds of the atoms of constrained clusters follow the kinds that rotate.
    """

    def __init__(self, kinds: Sequence[Kind], n_particles: int, clusters: Clusters | None = None) -> None:
        self.kinds = tuple(kinds)
        self._turning = tuple(kind for kind in kinds if kind.turns)
        self.n_particles = n_particles
        self.clusters = Clusters([]) if clusters is None else clusters
        #: K, the number of bodies that rotate.
        self.n_turning = sum(len(kind.particles) for kind in self._turning)
        self.mass: Array = np.concatenate([np.zeros(0), *(np.full(len(kind.particles), kind.mass) for kind in kinds)])
        self.particles = _particles(kinds)
        #: The first particle of each body (N,).
        self.first_particle = self.particles.rows[self.particles.starts[:-1]]
        #: The atoms of clusters among all bodies.
        self.clustered = slice(self.n_turning, self.n_turning + len(self.clusters.mass))
        #: Moments for the rotor (1, 3) or (K, 3). A linear body is treated as a sphere without momentum along its axis.
        self.inertia = _moments(self._turning)
        self._flexible = bool(len(self.clusters))

    @property
    def translational_freedom(self) -> int:
        """Number of degrees of freedom of centres of mass and single particles, minus constraints of clusters."""
        return 3 * (len(self) - len(self.clusters.mass)) + self.clusters.degrees_of_freedom

    @property
    def rotational_freedom(self) -> int:
        """Number of rotational degrees of freedom."""
        return sum((3 - kind.linear) * len(kind.particles) for kind in self._turning)

    @property
    def principal_moments(self) -> Array:
        """Principal moments (3, K) of the rotating bodies, which are 0 along the axis of a linear body."""
        rows = [np.broadcast_to(kind.inertia, (len(kind.particles), 3)) for kind in self._turning]
        return np.ascontiguousarray(np.concatenate([np.zeros((0, 3)), *rows]).T)

    def __len__(self) -> int:
        """Return the number of bodies, including single particles."""
        return len(self.mass)

    @property
    def owner(self) -> Indices:
        """The index of the body of each particle (n_particles,), or -1 for a particle that belongs to no body."""
        owner = np.full(self.n_particles, -1)
        owner[self.particles.rows] = np.repeat(np.arange(len(self)), np.diff(self.particles.starts))
        return owner

    def touched(self, particles: Indices) -> NDArray[np.bool_]:
        """Return a mask (N,) of the bodies, and of all atoms of the clusters, that contain one of the particles."""
        chosen = np.zeros(len(self) + 1, dtype=bool)  # the last entry is for particles outside all bodies
        chosen[self.owner[particles]] = True
        for _, columns in self.clusters.columns():
            atoms = columns + self.n_turning
            chosen[atoms] |= chosen[atoms].any(axis=1, keepdims=True)
        return chosen[:-1]

    def chosen(self, bodies: NDArray[np.bool_], number: Indices, n_particles: int) -> RigidBodies:
        """Return the bodies of a mask (N,), which selects whole clusters, as a new set in the same order.

        `number` contains the new index of each particle, and `n_particles` is the new number of particles.
        """
        kinds: list[Kind] = []
        start = 0
        for kind in self.kinds:
            own = bodies[kind.bodies]
            if own.any():
                some, stop = kind.only(own), start + int(own.sum())
                kinds.append(replace(some, particles=number[some.particles], bodies=slice(start, stop)))
                start = stop
        return RigidBodies(kinds, n_particles, self.clusters.chosen(bodies[self.clustered], number))

    def positions(self, state: BodyState, out: Array) -> Array:
        """Write the positions of all particles with mass into `out` (n_particles, 3)."""
        place(state.R, state.q, self.particles, out)
        return out

    def velocities(self, state: BodyState, out: Array) -> Array:
        """Write the velocities of all particles with mass into `out` (n_particles, 3)."""
        V, omega = self.tangent(state).P / self.mass, state.m / self.inertia.T
        move(V, omega, state.q, self.particles, out)
        return out

    def forces(self, state: BodyState, forces: Array) -> tuple[Array, Array]:
        """Return total forces (3, N) and body-frame torques (3, K) from forces on the particles (n_particles, 3)."""
        total, torque = np.empty((3, len(self))), np.empty((3, self.n_turning))
        collect(state.q, self.particles, forces, total, torque)
        return total, torque

    def tangent(self, state: BodyState) -> BodyState:
        """Return the state with momenta projected onto the constraints."""
        if not self._flexible:
            return state
        x, p = (np.ascontiguousarray(a[None, :, self.clustered]) for a in (state.R, state.P))
        P = state.P.copy()
        P[:, self.clustered] = self.clusters.tangent(ClusterState(x, p)).p[0]
        return state._replace(P=P)

    def canonical_momenta(
        self, state: BodyState, kT: float, rng: np.random.Generator, at_rest: bool = False
    ) -> BodyState:
        """Return a state with momenta drawn at kT (kJ/mol), optionally with the centre of mass at rest.

        Momenta are projected onto the constraints. The projection, which is orthogonal in the mass metric, yields the
        canonical distribution on the constraints.
        """
        P = np.sqrt(kT * self.mass) * rng.standard_normal(state.P.shape)
        if at_rest:
            P -= self.mass * (P.sum(axis=1, keepdims=True) / self.mass.sum())
        m = np.sqrt(kT * self.inertia.T) * rng.standard_normal(state.m.shape)
        for kind in self._turning:
            if kind.linear:
                m[0, kind.bodies] = 0.0
        return self.tangent(state._replace(P=P, m=m))

    def kinetic_energies(self, state: BodyState, velocity: Array | None = None) -> tuple[float, float]:
        """Return translational and rotational kinetic energies (kJ/mol) of momenta projected onto the constraints.

        If a velocity (3,) in nm/ps is given, the energies are those of the motion relative to this velocity.
        """
        P = self.tangent(state).P
        if velocity is not None:
            P = P - np.outer(velocity, self.mass)
        translational = 0.5 * float(np.sum(P * P / self.mass))
        return translational, 0.5 * float(np.sum(state.m * state.m / self.inertia.T))

    def drift(self, state: BodyState) -> Array:
        """Return the velocity (3,) of the centre of mass of all bodies, in nm/ps."""
        velocity: Array = state.P.sum(axis=1) / self.mass.sum()
        return velocity

    def name(self, body: int) -> str:
        """Return a description of a body, or of its cluster, that lists its particles."""
        for of_clusters, columns in self.clusters.columns():
            (cluster,) = np.nonzero((columns == body - self.n_turning).any(axis=1))
            if len(cluster):
                return of_clusters.name(int(cluster[0]))
        for kind in self.kinds:
            if kind.bodies.start <= body < kind.bodies.stop:
                return f"body {body} (particles {listed(kind.particles[body - kind.bodies.start])})"
        raise IndexError(f"body {body} does not exist: use a number from 0 to {len(self) - 1}")


class ChosenBodies:
    """Bodies that `RigidBodies.chosen` has selected, and the mask `chosen` (N,) of the selection."""

    def __init__(self, bodies: RigidBodies, chosen: NDArray[np.bool_]) -> None:
        self.bodies = bodies
        self.columns = np.flatnonzero(chosen)
        self.turning = self.columns[: bodies.n_turning]
        self._places = self.columns, self.columns, self.turning, self.turning

    def of(self, state: State) -> State:
        """Return the state of these bodies, given the state of all bodies."""
        return State(*(np.ascontiguousarray(a[..., i]) for a, i in zip(state, self._places, strict=True)))

    def into(self, state: State, own: State) -> State:
        """Return the state of all bodies in which the state of these bodies is replaced by `own`."""
        after = State(*(a.copy() for a in state))
        for a, b, i in zip(after, own, self._places, strict=True):
            a[..., i] = b
        return after


def _particles(kinds: Sequence[Kind]) -> Particles:
    """Return the particles of all bodies, in the order of the bodies."""
    sizes, rows, sites = [np.zeros(1, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for kind in kinds:
        n, k = kind.particles.shape
        sizes.append(np.full(n, k))
        rows.append(kind.particles.ravel())
        sites.append(np.broadcast_to(kind.sites, (n, k, 3)).reshape(-1, 3))
    return Particles(np.cumsum(np.concatenate(sizes)), np.concatenate(rows), np.concatenate(sites))


def _moments(turning: Sequence[Kind]) -> Array:
    """Return the moments (K, 3) for the rotor, or (1, 3) if they are the same for all bodies."""
    if not turning:
        return np.ones((1, 3))
    moments = [np.where(kind.linear, kind.inertia[:, 2:], kind.inertia) for kind in turning]
    if len(turning) == 1:
        return moments[0]
    return np.concatenate(
        [np.broadcast_to(rows, (len(kind.particles), 3)) for rows, kind in zip(moments, turning, strict=True)]
    )
