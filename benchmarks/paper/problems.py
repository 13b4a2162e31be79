"""Rigid bodies about a fixed point in a potential: energies, torques, and the initial values of the paper.

All arrays are component-first, for many copies of a problem: orientations q (4, N), body-frame angular momenta m (3,
N).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.mathematics.quaternions import matrix
from openmm_exactrb.mechanics.free_motion import rigid
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.rotors import Rotor, rotor_of_sums
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.sequence import repeated, run
from openmm_exactrb.steps.substeps import GradientKick, Substep, kick
from openmm_exactrb.support import checks

Array = NDArray[np.float64]
#: Attitudes (4, N) and body-frame angular momenta (3, N), or double-doubles of them.
TopState = tuple[Array, Array]


class Problem(Protocol):
    """Bodies with principal moments `inertia` (3, N) or (3, 1), a potential V(Q) and its torque."""

    inertia: Array

    def potential(self, q: Array) -> Array:
        """Return V, (N,)."""

    def torque(self, q: Array) -> Array:
        """Return the torque in the body frame, (3, N)."""

    def gradient_torque(self, q: Array) -> Array:
        """Return the torque (3, N) of the force-gradient potential f . I^-1 f, where f is the torque of V."""


def kinetic_energy(inertia: Array, m: Array) -> Array:
    """Return T = m . I^-1 m / 2 of component-first momenta, equation (3)."""
    energy: Array = 0.5 * np.sum(m * m / inertia, axis=0)
    return energy


def energy(problem: Problem, state: TopState) -> Array:
    """Return the total energy T + V of each body."""
    q, m = state
    return kinetic_energy(problem.inertia, m) + problem.potential(q)


def integrate(
    problem: Problem, state: TopState, h: float, n: int, scheme: Scheme, method: str | Rotor = "exact"
) -> TopState:
    """Move a problem by n steps of size h.

    Parameters
    ----------
    problem : Problem
    state : tuple
        (q, m), not changed: arrays (4, N) and (3, N), or double-doubles (2, 4, N) and (2, 3, N) of
        `openmm_exactrb.mathematics.compensated`, as they are within a call.
    h : float
        Step size.
    n : int
        Number of steps. The last stage of a step and the first of the next are one; a processor is applied before the
        first step, and its inverse after the last.
    scheme : Scheme
    method : str or Rotor, optional
        A key of `openmm_exactrb.ROTORS`, or an entry of your own.

    Returns
    -------
    tuple
        (q, m) after the last step, in the form of `state`.

    Raises
    ------
    ValueError
        If n is no whole number of at least 0.
    """
    n = checks.whole(n, "n", 0)
    q, m = (np.array(x) if np.ndim(x) == 3 else exactly(np.asarray(x, dtype=np.float64)) for x in state)
    nowhere = np.zeros((2, 3, 0))
    sequence = scheme.processor + repeated(scheme.sequence, n) + scheme.postprocessor if n else ()
    end = run(sequence, flows(problem, scheme, method), State(nowhere, nowhere, q, m), h)
    return (end.q, end.m) if np.ndim(state[0]) == 3 else (end.q[0], end.m[0])


def flows(problem: Problem, scheme: Scheme, method: str | Rotor = "exact") -> dict[Substep, Flow[State]]:
    """Return the flows of the substeps of a scheme for a problem; kicks with a gradient have the exact one."""
    drift = rigid(np.zeros(0), rotor_of_sums(method, problem.inertia.T)).drift
    plain = kick(lambda state: (_NOWHERE, problem.torque(state.q[0])))
    correction = kick(lambda state: (_NOWHERE, problem.gradient_torque(state.q[0])))

    def flow_of(substep: Substep) -> Flow[State]:
        if isinstance(substep, GradientKick):
            return lambda state, tau: correction(plain(state, tau), -0.5 * substep.strength * tau**3)
        return plain if substep.kicks else drift

    return {substep: flow_of(substep) for substep, _ in scheme.sequence + scheme.processor}


_NOWHERE = np.zeros((3, 0))


@dataclass(frozen=True)
class HeavyTop:
    """The heavy top (43) as a perturbed free body: V = epsilon e3 . Q^T u0.

    Attributes
    ----------
    inertia : (3, N) array
    epsilon : float or (N,) array
        Size of the perturbation.
    direction : (3, N) array
        The unit vectors u0.
    """

    inertia: Array
    epsilon: float | Array
    direction: Array

    @classmethod
    def random(cls, rng: np.random.Generator, epsilon: float, T0: float, n: int) -> tuple[HeavyTop, TopState]:
        """Draw n tops as section 3.3.1 does: I1 = 1, kinetic energy T0, random u0, attitude (1, 0, 0, 0).

        The moments I1 < I2 < I3 <= I1 + I2 are those of physical bodies; the kinetic energy is divided at random among
        the components of m.
        """
        I2 = rng.uniform(1.0, 3.0, n)
        inertia = np.stack([np.ones(n), I2, I2 + rng.uniform(0.0, 1.0, n)])
        # Shares of the kinetic energy: random, of sum one.
        shares = np.diff(np.sort(rng.random((2, n)), axis=0), axis=0, prepend=0.0, append=1.0)
        m = np.sqrt(2.0 * T0 * inertia * shares) * rng.choice([-1.0, 1.0], (3, n))
        u = rng.standard_normal((3, n))
        q = np.zeros((4, n))
        q[0] = 1.0
        return cls(inertia, epsilon, u / np.linalg.norm(u, axis=0)), (q, m)

    def _u(self, q: Array) -> Array:
        u: Array = np.einsum("ijn,in->jn", matrix(q), self.direction)
        return u

    def potential(self, q: Array) -> Array:
        """Return V, (N,)."""
        potential: Array = self.epsilon * self._u(q)[2]
        return potential

    def torque(self, q: Array) -> Array:
        """Return the torque epsilon (u2, -u1, 0), (3, N)."""
        u1, u2, _ = self._u(q)
        return self.epsilon * np.stack([u2, -u1, np.zeros_like(u1)])

    def gradient_torque(self, q: Array) -> Array:
        """Return the torque u x dU/du of U = epsilon² (u2²/I1 + u1²/I2), (3, N)."""
        u, (I1, I2, _) = self._u(q), self.inertia
        slope = np.stack([u[0] / I2, u[1] / I1, np.zeros_like(u[0])])
        return 2.0 * self.epsilon**2 * np.cross(u, slope, axis=0)


@dataclass(frozen=True)
class Satellite:
    """A satellite on a circular orbit, (44) and (45): V = 3 mu/(2 r³) u . I u with u = Q^T e3.

    Attributes
    ----------
    inertia : (3, N) array
    gravity : float
        mu = gM, m³/s².
    radius : float
        r, in the paper's unit.
    """

    inertia: Array
    gravity: float = 3.986e14
    radius: float = 1.5e5

    @classmethod
    def paper(cls) -> tuple[Satellite, TopState]:
        """Return the satellite of section 3.3.2 and its state at the start."""
        satellite = cls(np.array([[1.7e4], [3.7e4], [5.4e4]]))
        omega = np.array([[15.0], [-15.0], [15.0]])
        return satellite, (np.array([[1.0], [0.0], [0.0], [0.0]]), satellite.inertia * omega)

    @property
    def strength(self) -> float:
        """The factor 3 mu/r³."""
        return 3.0 * self.gravity / self.radius**3

    def potential(self, q: Array) -> Array:
        """Return V, (N,)."""
        u = matrix(q)[2]
        potential: Array = 0.5 * self.strength * np.sum(u * self.inertia * u, axis=0)
        return potential

    def torque(self, q: Array) -> Array:
        """Return the torque 3 mu/r³ u x I u, (3, N)."""
        u = matrix(q)[2]
        return self.strength * np.cross(u, self.inertia * u, axis=0)

    def gradient_torque(self, q: Array) -> Array:
        """Return the torque u x dU/du of U = f . I^-1 f for f = s u x I u, (3, N)."""
        u = matrix(q)[2]
        Iu = self.inertia * u
        w = np.cross(u, Iu, axis=0) / self.inertia
        slope = np.cross(Iu, w, axis=0) + self.inertia * np.cross(w, u, axis=0)
        return 2.0 * self.strength**2 * np.cross(u, slope, axis=0)
