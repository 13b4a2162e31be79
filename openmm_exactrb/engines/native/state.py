"""The state of the bodies of a Context, stored in arrays in the machine."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from openmm_exactrb.context import variables
from openmm_exactrb.context.inner import Inner, has_saved_forces, save_forces
from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.library.library import Machine
from openmm_exactrb.mechanics.fit import fit
from openmm_exactrb.mechanics.state import State

# Bits of external changes, see `Machine.changes`.
SET, FORCES, LOADED = 3, 4, 8
# In single precision, positions (nm) and velocities (nm/ps) agree with a state if they differ from it by at most this
# absolute tolerance plus this relative tolerance.
_SINGLE, _SINGLE_PART = 1e-5, 1e-6


class NativeState(Synchronisation):
    """A `Synchronisation` that reads the state from the machine only on request.

    The program integrator detects external changes to the Context, so that a comparison of states is not needed.
    """

    _behind = False  # whether the machine has moved the bodies since `state` was read
    stepped = False  #: whether the state is the result of the last steps

    def begin(self, machine: Machine, parts: Sequence[Any], processed: bool, single: bool) -> None:
        """Store the state in the arrays of a program on `machine`, which the program's `parts` read and write."""
        self._machine, self._parts, self._processed = machine, parts, processed
        if single:
            self._same, self._rigid = (_SINGLE, _SINGLE_PART), _SINGLE

    def pull(self) -> bool:
        """Update the state from the machine, and return whether the Context was changed.

        A changed state is also written to the machine.
        """
        changes = self._machine.changes()
        if not changes & (SET | LOADED):
            if self._behind:
                self.state, self._behind = self._read(), False
            return False
        self.context.computeVirtualSites()
        x, v = self.held()
        known = self._read() if variables.marked(self._integrator()) else None
        if changes & LOADED and self._machine["inner"] and not has_saved_forces(self.context, self._integrator()):
            self._discard_inner()
        if known is None:
            state = State.of(fit(self.bodies, self._joined(x), v))
        else:
            state = self.compared(known, self._joined(x), v)
        elsewhere = self._elsewhere(x)
        self.particles[:], self._v[:] = x, v
        self._take(known, state, elsewhere)
        rounded = self.state.rounded
        shown = self.bodies.positions(rounded, self.particles), self.bodies.velocities(rounded, v.copy())
        if max(np.abs(held - rigid).max() for held, rigid in zip((x, v), shown, strict=True)) > self._rigid:
            self.push()
        return True

    def settle(self) -> tuple[bool, bool]:
        """Call `pull` if there are external changes; return whether the state and whether the forces have changed."""
        changes = self._machine.changes(clear=FORCES)
        changed = self.pull() if changes & (SET | LOADED) else False
        return changed, bool(changes & FORCES) or self._silently_changed()

    def _silently_changed(self) -> bool:
        """Return whether forces have changed without a report by OpenMM.

        The machine then forgets the forces of its last evaluation, as it does when a state is restored.
        """
        if self._reports or has_saved_forces(self.context, self._integrator()):
            return False
        self._machine.keep()
        self._machine.restore()
        return True

    def remember_forces(self) -> None:
        """Save a sum of the forces if OpenMM does not report all their changes."""
        if not self._reports:
            save_forces(self.context, self._integrator())

    def moved_on(self) -> None:
        """Record that the machine has moved the bodies, or was restored."""
        self._behind = True

    def _take(self, known: State | None, state: State, elsewhere: bool) -> None:
        """Accept a state, and write it to the machine if it changed or if massless particles moved (`elsewhere`)."""
        self.state, self._behind, self.stepped = state, False, False
        if elsewhere or state is not known:
            self.inner = None if known is None or elsewhere or not self._processed else self._inner()
            if known is not None:
                self._follow(known, state)
            self._upload()
        self.mark()
        self._machine.changes(clear=SET | LOADED)

    def mark(self) -> None:
        """Mark the integrator's variables as containing a state."""
        integrator = self._integrator()
        variables.mark(integrator, variables.native(variables.own_numbers(integrator)))

    def _upload(self) -> None:
        for part in self._parts:
            part.write(self._machine, self.state, copied=True)
            if self._processed and self.inner is not None:
                part.write(self._machine, self.inner.state, copied=False)
        if self._processed and self.inner is None:
            self._discard_inner()

    def _inner(self) -> Inner | None:
        """Read the state in inner coordinates from the machine, or return None if there is no such state."""
        fingerprint = self._machine["inner"]
        return Inner(self._read(copied=False), fingerprint) if fingerprint else None

    def in_machine(self, shown: bool) -> State:
        """Return the state in the machine: the shown state, or the state in inner coordinates."""
        return self._read(copied=shown)

    def _read(self, copied: bool = True) -> State:
        """Read the shown state from the machine or, if not `copied`, the state in inner coordinates."""
        n, turning = len(self.bodies), self.bodies.n_turning
        out = State(*(np.zeros((2, *shape)) for shape in ((3, n), (3, n), (4, turning), (3, turning))))
        for part in self._parts:
            part.read(self._machine, out, copied)
        return out

    def push(self) -> None:
        """Write the state to the Context and to the machine."""
        self.positions.moved()  # the machine may have moved the bodies since they were written
        self.positions.write(self.state)
        self.write_velocities(self.state)
        self._upload()
        self._machine.changes(clear=SET | LOADED)

    @contextlib.contextmanager
    def kept(self, slot: int) -> Iterator[None]:
        """Keep the state in a place of the machine, and restore it to the bit after other positions were written."""
        self._machine.keep(slot)
        try:
            yield
        finally:
            self._machine.restore(slot)
            self.positions.moved()
            self._machine.changes(clear=SET)

    def renew(self) -> None:
        """Write the state to the arrays of a new program, without inner coordinates."""
        self.inner = None
        self._upload()

    def replace(self, state: State) -> None:
        """Replace the state of the bodies and push it."""
        self.state, self.inner, self._behind, self.stepped = state, None, False, False
        self.push()

    def _write(self) -> None:
        """Save a sum of the forces to which an inner state belongs; OpenMM saves the arrays that contain the state."""
        if not self._machine["inner"]:
            return
        if self._machine.changes() & SET and self._fixed_moved():
            self._discard_inner()
        elif self.context.getSystem().getNumForces() == self._n_forces:
            save_forces(self.context, self._integrator())
        else:  # OpenMM cannot evaluate forces before `reinitialize`
            self._discard_inner()

    def _discard_inner(self) -> None:
        """Discard the inner state, so that steps continue from the shown state."""
        self._machine["inner"] = 0.0

    _write_shown = _discard_inner  # the forces of a reinitialised Context may be other ones

    def _withdraw(self) -> None:
        """Do nothing, because no variables hold the state."""

    _unmark = _withdraw
