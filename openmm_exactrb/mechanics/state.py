"""The state of rigid bodies in double-doubles and in float64, its flows, and the memory of its last forces."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from openmm_exactrb.mathematics.compensated import exactly, renewed
from openmm_exactrb.support.types import Array

_S = TypeVar("_S")

#: flow(state, tau) -> the state after the time tau. The result may be the same object; the argument is not modified.
Flow = Callable[[_S, float], _S]
#: Force (3, N) and body-frame torque (3, K).
Force = tuple[Array, Array]
#: The forces of the last kicks, and the differences of the displaced forces, most recent first.
Remembered = tuple[list[Force], list[Force]]


class BodyState(NamedTuple):
    """Positions and momenta of N bodies, where the first K bodies rotate."""

    R: Array  #: centres of mass in nm (3, N)
    P: Array  #: linear momenta in amu nm/ps (3, N)
    q: Array  #: orientations, scalar first, from the principal axes of the body into space (4, K)
    m: Array  #: angular momenta in the principal axes of the body, in amu nm²/ps (3, K)


class State(NamedTuple):
    """The state on which flows act, in double-doubles of `openmm_exactrb.mathematics.compensated` to reduce roundoff.

    Attributes
    ----------
    R, P : (2, 3, N) arrays
        Centres of mass in nm and linear momenta in amu nm/ps.
    q : (2, 4, K) array
        Orientations.
    m : (2, 3, K) array
        Angular momenta in the body frame.
    """

    R: Array
    P: Array
    q: Array
    m: Array

    @classmethod
    def of(cls, rounded: BodyState) -> State:
        """Return a rounded state as double-doubles with low parts of zero."""
        return cls(*map(exactly, rounded))

    @property
    def rounded(self) -> BodyState:
        """The state rounded to float64."""
        return BodyState(self.R[0], self.P[0], self.q[0], self.m[0])

    def renewed(self, rounded: BodyState) -> State:
        """Return the state with new high parts.

        Unchanged numbers keep their low parts, and unchanged arrays are not copied.
        """
        pairs = zip(self, rounded, strict=True)
        return State(*(x if np.array_equal(x[0], high) else renewed(x, high) for x, high in pairs))


class ForceMemory:
    """The forces of the last kicks, most recent first, from which a processed scheme computes its output.

    Attributes
    ----------
    forces, differences : deque of (force, torque)
        Forces at the last positions, and displaced minus undisplaced forces in the last force-gradient kicks.
    closed : bool
        Whether additions are ignored, as is the case while output is computed.
    """

    def __init__(self, forces: int = 0, differences: int = 0) -> None:
        self.forces: deque[Force] = deque(maxlen=forces)
        self.differences: deque[Force] = deque(maxlen=differences)
        self.closed = False

    def add_force(self, force: Force) -> None:
        """Store a force."""
        if not self.closed:
            self.forces.appendleft(force)

    def add_difference(self, difference: Force) -> None:
        """Store a displaced minus an undisplaced force."""
        if not self.closed:
            self.differences.appendleft(difference)

    @property
    def full(self) -> bool:
        """Whether the memory is full."""
        return all(len(some) == some.maxlen for some in (self.forces, self.differences))

    def clear(self) -> None:
        """Delete all forces."""
        self.forces.clear()
        self.differences.clear()

    def copy(self) -> Remembered:
        """Return copies of the stored forces and differences."""
        return list(self.forces), list(self.differences)

    def restore(self, copy: Remembered) -> None:
        """Replace the contents by a result of `copy`."""
        self.clear()
        self.forces.extend(copy[0][: self.forces.maxlen])
        self.differences.extend(copy[1][: self.differences.maxlen])
