"""The bodies of a Context whose state lives on the device, in copies on all of their particles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.engines.custom_program import load
from openmm_exactrb.mechanics.state import BodyState, State

Array = NDArray[np.float64]


class ParticleCopies(Synchronisation):
    """A `Synchronisation` that reads the state only when it is asked for, since the device does not need it."""

    #: Whether the device has moved on since `state` was read.
    behind = False
    _copied: State | None = None  # the state that the copies hold

    def pull(self) -> bool:
        """Bring the state up to date, and the copies where something was set in the Context."""
        if self.behind:
            self._seen = None
        changed = super().pull()
        self.behind = False
        if self.state is not self._copied:
            self.push()
        return changed

    def settle(self) -> tuple[Array, Array]:
        """Bring the copies up to date with the Context; return its positions (nm) and velocities (nm/ps)."""
        if self._seen is None or not all(map(np.array_equal, self._seen, self.held())):
            self.pull()
        elif not self.behind and self.state is not self._copied:
            self.push()
        return self.shown

    @property
    def shown(self) -> tuple[Array, Array]:
        """Positions (nm) and velocities (nm/ps) that the Context showed when it was last looked at."""
        assert self._seen is not None
        return self._seen

    def moved_on(self) -> tuple[Array, Array]:
        """Note that the device has moved the bodies, and return positions (nm) and velocities (nm/ps)."""
        self._seen, self.behind = self.held(), True
        return self.shown

    def lose(self) -> None:
        """Forget the state: the next one comes from positions and velocities of the Context."""
        self._seen, self._copied = None, None

    def saved(self, x: Array, v: Array) -> State | None:
        """Return the state that the copies hold, in the periodic images of positions x, if it may be another one."""
        if self._seen is not None and all(map(np.array_equal, self._seen, (x, v))):
            return None
        known, box = load.read(self._integrator(), self.bodies), self.box()
        if known is not None and box is not None:  # OpenMM wraps molecules, and shows them where they were
            state, first = known.rounded, self.bodies.first_particle
            apart = x[first] - self.bodies.positions(state, x.copy())[first]
            shifts = np.rint(apart @ np.linalg.inv(box)) @ box
            if shifts.any():
                known = known.renewed(state._replace(R=state.R + shifts.T))
        self._copied = known
        return known

    def _velocities(self, rounded: BodyState, v: Array) -> Array:
        """Write the velocities of a state that was read; those of clusters are constrained by OpenMM."""
        bodies = self.bodies
        bodies.velocities(rounded, v)
        v[bodies.clusters.particles] = (rounded.P / bodies.mass)[:, bodies.clustered].T
        return v

    def _read_inner(self) -> None:
        """Leave an inner state where it is: in the program."""

    def push(self) -> None:
        """Write the state into the Context, and to the copies."""
        load.write(self._integrator(), self.bodies, self.state)
        self._copied, self.behind = self.state, False
        super().push()

    def _write(self) -> None:
        """Do nothing: the copies have the state."""

    _unmark = _withdraw = _write
