"""The state of rigid bodies: as it moves, in sums high + low, and as it is shown, rounded to float64; and its flows."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mathematics.compensated import exactly, renewed

Array = NDArray[np.float64]
_S = TypeVar("_S")

#: flow(state, tau) moves a state by the time tau; it may return the state itself, and does not change what it is given.
Flow = Callable[[_S, float], _S]


class BodyState(NamedTuple):
    """Positions and momenta of N bodies, the first K of which turn."""

    R: Array  #: centres of mass in nm (3, N)
    P: Array  #: linear momenta in amu nm/ps (3, N)
    q: Array  #: orientations, scalar first, from the principal axes of the body into space (4, K)
    m: Array  #: angular momenta in the principal axes of the body, in amu nm²/ps (3, K)


class State(NamedTuple):
    """The same as sums of `openmm_exactrb.mathematics.compensated`, so that no step rounds it: what flows act on.

    Attributes
    ----------
    R, P : (2, 3, N) arrays
    q : (2, 4, K) array
    m : (2, 3, K) array
    """

    R: Array
    P: Array
    q: Array
    m: Array

    @classmethod
    def of(cls, rounded: BodyState) -> State:
        """Return a state that was rounded as sums with nothing in their low parts."""
        return cls(*map(exactly, rounded))

    @property
    def rounded(self) -> BodyState:
        """The high parts."""
        return BodyState(self.R[0], self.P[0], self.q[0], self.m[0])

    def renewed(self, rounded: BodyState) -> State:
        """Return the state with new high parts; low parts, and whole arrays, stay where they are what they were."""
        pairs = zip(self, rounded, strict=True)
        return State(*(x if np.array_equal(x[0], high) else renewed(x, high) for x, high in pairs))
