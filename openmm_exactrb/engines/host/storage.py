"""The state of the host engine in the arrays of a program without kernels, which the library's integrators store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from openmm_exactrb.context.variables import INNER, SHOWN, PerDof, Storage, by_library, own_numbers
from openmm_exactrb.engines.engine import Settings
from openmm_exactrb.library.library import Machine, library, of_library
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import Force, State
from openmm_exactrb.support.types import Array

# The bit of changed parameters of forces, see `Machine.changes`.
_FORCES = 4


class ProgramStorage:
    """The storage of an integrator of the library; it has an inner state and `memory` forces for a processed scheme."""

    def __init__(self, integrator: Any, bodies: RigidBodies, memory: int | None) -> None:
        n, turning = len(bodies), bodies.n_turning
        self._machine, self._memory = Machine(library(), integrator), memory or 0
        #: The first number of an integrator that holds a state in this storage.
        self.mark = by_library(own_numbers(integrator))
        self._shapes = {"R": (2, 3, n), "P": (2, 3, n), "q": (2, 4, turning), "m": (2, 3, turning)}
        self._which = (SHOWN,) if memory is None else (SHOWN, INNER)
        self._of_forces = (3, n), (3, turning)
        arrays: list[tuple[str, tuple[int, ...]]] = [
            (self._name(which, name), shape) for which in self._which for name, shape in self._shapes.items()
        ]
        arrays += [(self._last(k, part), self._of_forces[part]) for k in range(self._memory) for part in (0, 1)]
        lines = (f"array {name} 8 {max(int(np.prod(shape)), 1)} saved" for name, shape in arrays)
        self._machine.load("\n".join(lines) + "\n")

    def write(self, state: State, which: str = SHOWN) -> None:
        """Write the double-doubles of a state."""
        for name, values in zip(self._shapes, state, strict=True):
            self._upload(self._name(which, name), values)

    def read(self, which: str = SHOWN) -> State | None:
        """Return the double-doubles of a state, or None if there are none."""
        if which not in self._which:
            return None
        return State(*(self._download(self._name(which, name), shape) for name, shape in self._shapes.items()))

    def write_forces(self, memory: Sequence[Force]) -> None:
        """Write forces (3, N) and torques (3, K)."""
        for k, pair in enumerate(memory):
            for part, values in enumerate(pair):
                self._upload(self._last(k, part), values)

    def read_forces(self, count: int) -> list[Force] | None:
        """Return `count` forces and torques that `write_forces` wrote, or None if another scheme wrote them."""
        if count > self._memory:
            return None
        force, torque = self._of_forces
        return [
            (self._download(self._last(k, 0), force), self._download(self._last(k, 1), torque)) for k in range(count)
        ]

    def forces_changed(self) -> bool | None:
        """Return whether parameters of forces have changed since the last call, of which OpenMM informs the library."""
        return bool(self._machine.changes(clear=_FORCES) & _FORCES)

    def _upload(self, name: str, values: Array) -> None:
        if values.size:
            self._machine.upload(name, values)

    def _download(self, name: str, shape: tuple[int, ...]) -> Array:
        return self._machine.download(name, np.empty(shape)) if np.prod(shape) else np.empty(shape)

    def _name(self, which: str, name: str) -> str:
        return f"host_{which}{name}"

    def _last(self, k: int, part: int) -> str:
        return f"host_last{k}_{part}"


def storage_of(settings: Settings) -> Callable[[Any, RigidBodies], Storage]:
    """Return the function storage(integrator, bodies) that returns where an integrator stores the state."""

    def storage(integrator: Any, bodies: RigidBodies) -> Storage:
        if of_library(integrator):
            return ProgramStorage(integrator, bodies, settings.memory)
        return PerDof(integrator, bodies)

    return storage
