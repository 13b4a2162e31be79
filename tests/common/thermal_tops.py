"""Independent bodies at a thermostat, whose distributions are known: a dipole in a field, in a trap of springs."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from openmm_exactrb.mathematics.compensated import add, exactly
from openmm_exactrb.mathematics.quaternions import matrix
from openmm_exactrb.mechanics.rng import Instant
from openmm_exactrb.rotors import rotor_of_sums
from openmm_exactrb.schemes import spelled
from openmm_exactrb.substeps import DRIFT, HEAT_EXCHANGE, KICK

#: Moments of a water molecule in u nm², its mass in u, kT at 300 K in kJ/mol.
WATER = np.array([0.00614541, 0.01155054, 0.01769595])
WATER_MASS = 18.015
KT = 0.00831446261815324 * 300.0

# The weight of an outer kick of S2_2.
_L = 0.1931833275037836
SEQUENCES = {
    "BAOAB": spelled("B A O A B"),
    "OBABO": spelled("O B A B O"),
    "O S2_2 O": tuple(
        zip(
            (HEAT_EXCHANGE, KICK, DRIFT, KICK, DRIFT, KICK, HEAT_EXCHANGE),
            (0.5, _L, 0.5, 1.0 - 2.0 * _L, 0.5, _L, 0.5),
            strict=True,
        )
    ),
    "AOA": spelled("A O A"),
}


class State(NamedTuple):
    """Sums (2, k, N): centres, momenta, attitudes, angular momenta in the body frame."""

    R: np.ndarray
    P: np.ndarray
    q: np.ndarray
    m: np.ndarray


@dataclass(frozen=True)
class Tops:
    """N equal bodies, each alone; a linear one has the moments (0, I, I).

    The potential of a body is -x kT cos(theta) + M w² R²/2, with theta between its axis and z.
    """

    n: int
    moments: np.ndarray
    mass: float = 1.0
    kT: float = 1.0
    axis: int = 0
    x: float = 0.0
    w: float = 0.0

    @property
    def masses(self):
        return np.full(self.n, self.mass)

    @property
    def all_moments(self):
        return np.tile(self.moments[:, None], self.n)

    def cosine(self, state):
        return matrix(state.q[0])[2, self.axis]

    def energies(self, state):
        """Return the total energy of each body."""
        rate = np.divide(1.0, self.moments, out=np.zeros(3), where=self.moments > 0.0)
        kinetic = (state.P[0] ** 2).sum(axis=0) / self.mass + (state.m[0] ** 2 * rate[:, None]).sum(axis=0)
        trap = self.mass * self.w**2 * (state.R[0] ** 2).sum(axis=0)
        return 0.5 * (kinetic + trap) - self.x * self.kT * self.cosine(state)

    def flows(self):
        """Return the flows of drifts and kicks."""
        inertia = np.where(self.moments > 0.0, self.moments, self.moments.max())
        turn = rotor_of_sums("exact", inertia)
        arrow = np.eye(3)[:, self.axis, None]

        def drift(state, tau):
            q, m = turn(state.q, state.m, tau)
            return state._replace(R=add(state.R, tau * state.P[0] / self.mass), q=q, m=m)

        def kick(state, tau):
            torque = self.x * self.kT * np.cross(arrow, matrix(state.q[0])[2], axis=0)
            force = -self.mass * self.w**2 * state.R[0]
            return state._replace(P=add(state.P, tau * force), m=add(state.m, tau * torque))

        return {DRIFT: drift, KICK: kick}

    def run(self, sequence, exchange, state, h, steps, seed=1, see=None):
        """Carry the sequence out, `see(state)` after each step."""
        flows = self.flows()
        for step in range(steps):
            for place, (substep, part) in enumerate(sequence):
                if substep == HEAT_EXCHANGE:
                    P, m = exchange(state.P, state.m, part * h, Instant(seed, step, place))
                    state = state._replace(P=P, m=m)
                else:
                    state = flows[substep](state, part * h)
            if see is not None:
                see(state)
        return state

    def at_rest(self):
        q = np.zeros((4, self.n))
        q[0] = 1.0
        nothing = np.zeros((3, self.n))
        return State(*map(exactly, (nothing, nothing, q, nothing)))

    def canonical(self, rng):
        """Draw a state from the exact distribution."""
        v, spin = rng.random(self.n), 2.0 * np.pi * rng.random((2, self.n))
        cosine = 2.0 * v - 1.0 if self.x == 0.0 else 1.0 + np.log(v + (1.0 - v) * np.exp(-2.0 * self.x)) / self.x
        # The rotation about z takes y to the axis of the tilt, which takes the body's axis from z; before it the body
        # turns about its axis, which a cyclic change of the axes has brought to z.
        cyclic = np.array([0.5, 0.5, 0.5, 0.5])[:, None]
        to_z = {2: _about(2, np.zeros(1)), 1: cyclic, 0: _product(cyclic, cyclic)}[self.axis]
        q = _product(_product(_about(2, spin[0]), _about(1, np.arccos(cosine))), _product(_about(2, spin[1]), to_z))
        momenta = rng.standard_normal((2, 3, self.n))
        R = rng.standard_normal((3, self.n)) * (np.sqrt(self.kT / self.mass) / self.w if self.w else 0.0)
        P, m = np.sqrt(self.kT * self.mass) * momenta[0], np.sqrt(self.kT * self.moments)[:, None] * momenta[1]
        return State(*map(exactly, (R, P, q, m)))


def _about(axis, angle):
    q = np.zeros((4, len(angle)))
    q[0], q[1 + axis] = np.cos(0.5 * angle), np.sin(0.5 * angle)
    return q


def _product(p, q):
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:], axis=0)
    return np.concatenate([(p[0] * q[0] - (p[1:] * q[1:]).sum(axis=0))[None], vector])


def langevin_function(x):
    """Return the mean cosine of a dipole in a field."""
    return 1.0 / np.tanh(x) - 1.0 / x


class Mean:
    """The mean over time of a quantity (..., N) of independent bodies, and its error."""

    def __init__(self, quantity, burn=0):
        self.quantity, self.calls, self.burn, self.total = quantity, 0, burn, 0.0

    def __call__(self, state):
        self.calls += 1
        if self.calls > self.burn:
            self.total = self.total + self.quantity(state)

    @property
    def bodies(self):
        return self.total / (self.calls - self.burn)

    @property
    def value(self):
        return self.bodies.mean(axis=-1)

    @property
    def error(self):
        return self.bodies.std(axis=-1, ddof=1) / np.sqrt(self.bodies.shape[-1])
