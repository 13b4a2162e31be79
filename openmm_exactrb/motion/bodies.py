"""Rigid bodies and single particles as one set of arrays, and the particles that they consist of.

The state of N bodies is one set of component-first float64 arrays. Bodies of one kind are neighbours, and kinds that
turn come before single particles, which have no attitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb import kernels
from openmm_exactrb.motion.state import BodyState
from openmm_exactrb.quaternions import matrix

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Kind:
    """Bodies of the same masses, and of one shape or of one each.

    Attributes
    ----------
    particles : (n, k) array
        The k particles with mass of each of the n bodies.
    bodies : slice
        Where they stand among all bodies.
    masses : (k,) array
    sites : (1, k, 3) or (n, k, 3) array
        Places of the particles in the principal axes of the body, about the centre of mass: of all bodies, or of each.
    mass : float
    inertia : (1, 3) or (n, 3) array
        Principal moments in ascending order; the first is 0 for a linear body, all are for a single particle.
    """

    particles: Indices
    bodies: slice
    masses: Array
    sites: Array
    mass: float
    inertia: Array

    @property
    def turns(self) -> bool:
        """Whether the bodies have an attitude: all but single particles."""
        return bool(self.sites.shape[1] > 1)

    @property
    def linear(self) -> bool:
        """Whether all sites lie on axis 1."""
        return self.turns and bool(self.inertia[0, 0] == 0.0)


class RigidBodies:
    """The rigid bodies of a System and its free particles.

    Parameters
    ----------
    kinds : sequence of Kind
    n_particles : int
        Particles of the System, virtual sites and those without mass included.

    Attributes
    ----------
    mass : (N,) array
    inertia : (1, 3) or (K, 3) array
        Moments for the rotor, of one kind with one shape or of each body that turns. A linear body turns as a sphere
        does whose momentum has no component along the axis.
    first_particle : (N,) array of int
    n_turning : int
        K, the number of bodies that turn.
    """

    def __init__(self, kinds: Sequence[Kind], n_particles: int) -> None:
        self.kinds = tuple(kinds)
        self.n_particles = n_particles
        self.n_turning = sum(len(kind.particles) for kind in kinds if kind.turns)
        self.mass: Array = np.concatenate([np.zeros(0), *(np.full(len(kind.particles), kind.mass) for kind in kinds)])
        self.first_particle: Indices = np.concatenate(
            [np.zeros(0, dtype=np.intp), *(kind.particles[:, 0] for kind in kinds)]
        )
        self.inertia = _moments([kind for kind in kinds if kind.turns])
        self._particles_of = kernels.twins().bodies

    @property
    def rotational_freedom(self) -> int:
        """Rotational degrees of freedom."""
        return sum((3 - kind.linear) * len(kind.particles) for kind in self.kinds if kind.turns)

    @property
    def principal_moments(self) -> Array:
        """Principal moments of the bodies that turn, (3, K): 0 along the axis of a linear one."""
        turning = [kind for kind in self.kinds if kind.turns]
        rows = [np.broadcast_to(kind.inertia, (len(kind.particles), 3)) for kind in turning]
        return np.ascontiguousarray(np.concatenate([np.zeros((0, 3)), *rows]).T)

    def __len__(self) -> int:
        """Return the number of bodies, single particles included."""
        return len(self.mass)

    def positions(self, state: BodyState, out: Array) -> Array:
        """Write the positions of all particles with mass into `out` (n_particles, 3)."""
        for kind in self.kinds:
            if kind.turns:
                self._particles_of.place(state.R, state.q, kind.particles, kind.sites, kind.bodies.start, out)
            else:
                out[kind.particles[:, 0]] = state.R.T[kind.bodies]
        return out

    def velocities(self, state: BodyState, out: Array) -> Array:
        """Write the velocities of all particles with mass into `out` (n_particles, 3)."""
        Q = matrix(state.q)
        V = (state.P / self.mass).T
        omega = state.m.T / self.inertia
        for kind in self.kinds:
            velocity = V[kind.bodies, None]
            if kind.turns:
                relative = np.cross(omega[kind.bodies, None], kind.sites)
                velocity = velocity + np.einsum("ijn,nsj->nsi", Q[:, :, kind.bodies], relative)
            out[kind.particles] = velocity
        return out

    def forces(self, state: BodyState, forces: Array) -> tuple[Array, Array]:
        """Return total forces (3, N) and body-frame torques (3, K) from forces on the particles (n_particles, 3)."""
        total, torque = np.empty((3, len(self))), np.empty((3, self.n_turning))
        for kind in self.kinds:
            if kind.turns:
                self._particles_of.collect(
                    state.q, kind.particles, kind.sites, kind.bodies.start, forces, total, torque
                )
            else:
                total[:, kind.bodies] = forces[kind.particles[:, 0]].T
        return total, torque

    def kinetic_energies(self, state: BodyState) -> tuple[float, float]:
        """Return the translational and rotational kinetic energies in kJ/mol."""
        translational = 0.5 * float(np.sum(state.P * state.P / self.mass))
        return translational, 0.5 * float(np.sum(state.m * state.m / self.inertia.T))

    def name(self, body: int) -> str:
        """Say which particles a body consists of."""
        for kind in self.kinds:
            if kind.bodies.start <= body < kind.bodies.stop:
                return f"body {body} (particles {', '.join(map(str, kind.particles[body - kind.bodies.start]))})"
        raise IndexError(f"there is no body {body}")


def _moments(turning: list[Kind]) -> Array:
    """Return the moments for the rotor, one row for all where all bodies have the same."""
    if not turning:
        return np.ones((1, 3))
    moments = [np.where(kind.linear, kind.inertia[:, 2:], kind.inertia) for kind in turning]
    if len(turning) == 1:
        return moments[0]
    return np.concatenate(
        [np.broadcast_to(rows, (len(kind.particles), 3)) for rows, kind in zip(moments, turning, strict=True)]
    )
