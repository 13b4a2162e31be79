"""Some of the bodies of a System: their state, and where it is in that of all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import State

Array = NDArray[np.float64]


class Part:
<<<<<<< HEAD
    """Some of the bodies, as `RigidBodies.chosen` returns them; `chosen` (N,) marks them among all."""
=======
    """Some of the bodies, as `RigidBodies.chosen` returns them; `chosen` (N,) are their indices among all."""
>>>>>>> 58ad5cc (getThermostat says what getBathSettings said; temperaturesAroundThermostat; one test of a barostat for both Ewald sums)

    def __init__(self, bodies: RigidBodies, chosen: NDArray[np.bool_]) -> None:
        self.bodies = bodies
        self.columns = np.flatnonzero(chosen)
        self.turning = self.columns[: bodies.n_turning]
        self._places = self.columns, self.columns, self.turning, self.turning

    def of(self, state: State) -> State:
        """Return the state of these bodies from that of all."""
        return State(*(np.ascontiguousarray(a[..., i]) for a, i in zip(state, self._places, strict=True)))

    def into(self, state: State, own: State) -> State:
        """Return the state of all with that of these bodies in it."""
        after = State(*(a.copy() for a in state))
        for a, b, i in zip(after, own, self._places, strict=True):
            a[..., i] = b
        return after
