"""The flow of the kinetic energy, and what belongs to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb import kernels
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.state import State
from openmm_exactrb.rotors import Flow as Rotation

Array = NDArray[np.float64]


def unchanged(state: State) -> State:
    """Return the state itself."""
    return state


@dataclass(frozen=True)
class Kinetic:
    """How bodies move without forces.

    Attributes
    ----------
    drift : callable
        drift(state, tau) -> state: the flow of the kinetic energy.
    order : int or None
        Order of this flow; None if it is exact.
    tangent : callable
        tangent(state) -> state, called after kicks: it takes away what constraints do not allow of the momenta.
        Nothing for rigid bodies.
    """

    drift: Flow[State]
    order: int | None = None
    tangent: Callable[[State], State] = unchanged


def rigid(mass: Array, rotation: Rotation, order: int | None = None) -> Kinetic:
    """Return the kinetic flow of rigid bodies.

    Parameters
    ----------
    mass : (N,) array
    rotation : callable
        rotation(q, m, tau) -> (q, m) of sums, as `openmm_exactrb.rotors.rotor_of_sums` returns it.
    order : int, optional
        Of the rotation.
    """
    advance = advancing()

    def drift(state: State, tau: float) -> State:
        q, m = rotation(state.q, state.m, tau)
        return State(advance(state.R, state.P[0] / mass, tau), state.P, q, m)

    return Kinetic(drift, order)


def advancing() -> Callable[[Array, Array, float], Array]:
    """Return advance(x, rate, tau) -> x + tau rate for a sum x (2, k, N) and rates (k, N)."""
    kernel = kernels.twins().sums.advance

    def advance(x: Array, rate: Array, tau: float) -> Array:
        total = np.empty(x.shape)
        kernel(np.ascontiguousarray(x), np.ascontiguousarray(rate), tau, total)
        return total

    return advance
