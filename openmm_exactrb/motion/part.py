"""Some of the bodies of a System by themselves: their state, and what acts on them."""

from __future__ import annotations

import copy
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.state import State

Array = NDArray[np.float64]


class Portion(Protocol):
    """Bodies that move for a time by themselves.

    Attributes
    ----------
    bodies : RigidBodies
    """

    @property
    def bodies(self) -> RigidBodies:
        """See above."""

    def of(self, state: State) -> State:
        """Return the state of these bodies from that of all."""

    def into(self, state: State, own: State) -> State:
        """Return the state of all with that of these bodies in it."""


class Whole:
    """All bodies."""

    def __init__(self, bodies: RigidBodies) -> None:
        self.bodies = bodies

    def of(self, state: State) -> State:
        """Return the state."""
        return state

    def into(self, state: State, own: State) -> State:
        """Return the state of these bodies, which are all."""
        return own


class Part:
    """Some of the bodies.

    Places that `into` has handed on are those that `of` returns again, the very arrays: so forces know them.

    Parameters
    ----------
    bodies : RigidBodies
        They, as `RigidBodies.chosen` returns them.
    chosen : (N,) array of bool
        Which of all bodies they are.
    """

    def __init__(self, bodies: RigidBodies, chosen: NDArray[np.bool_]) -> None:
        self.bodies = bodies
        self.columns = np.flatnonzero(chosen)
        self.turning = self.columns[: bodies.n_turning]
        self._places: tuple[Array, Array, Array, Array] | None = None  # R, q of all, and of these

    def of(self, state: State) -> State:
        """Return the state of these bodies from that of all."""
        if self._places is None or self._places[0] is not state.R or self._places[1] is not state.q:
            own = _columns(state.R, self.columns), _columns(state.q, self.turning)
            self._places = state.R, state.q, *own
        _, _, R, q = self._places
        return State(R, _columns(state.P, self.columns), q, _columns(state.m, self.turning))

    def into(self, state: State, own: State) -> State:
        """Return the state of all with that of these bodies in it."""
        all_columns = self.columns, self.columns, self.turning, self.turning
        after = State(*map(_with_columns, state, own, all_columns))
        self._places = after.R, after.q, own.R, own.q
        return after

    def twin(self) -> Part:
        """Return the same part with a memory of its own."""
        return copy.copy(self)


def _columns(a: Array, columns: NDArray[np.intp]) -> Array:
    return np.ascontiguousarray(a[..., columns])


def _with_columns(a: Array, own: Array, columns: NDArray[np.intp]) -> Array:
    after = a.copy()
    after[..., columns] = own
    return after
