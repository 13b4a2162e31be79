"""The forces of a Context as a function of positions."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from openmm_exactrb.context.synchronisation import Positions
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.bodies import Part
from openmm_exactrb.mechanics.state import BodyState, Force, ForceMemory, State
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.support.types import Array


class EvaluatedForces(ABC):
    """Forces and torques on bodies, evaluated once for each version of the positions."""

    def __init__(self, positions: Positions) -> None:
        self.positions = positions
        self.memory = ForceMemory()
        self._version, self._value = -1, (np.zeros(0), np.zeros(0))

    def __call__(self, state: State) -> Force:
        """Return the force (3, N) and body-frame torque (3, K) of a state at the present positions."""
        version = self.positions.version
        if self._version != version:
            self._value = self._evaluated(state, present=True)
            self._version = version
            self.memory.add_force(self._value)
        return self._value

    def at(self, state: State) -> Force:
        """Return the forces and torques at the positions of any state."""
        return self._evaluated(state, present=False)

    @abstractmethod
    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of all forces for a state at the present positions."""

    @abstractmethod
    def with_energies(self) -> None:
        """Evaluate the potential energy together with the forces in all later evaluations."""

    @abstractmethod
    def _evaluated(self, state: State, present: bool) -> Force:
        """Return the forces and torques at the present positions, or at the positions of any state."""


class ContextForces(EvaluatedForces):
    """The forces of given force groups (bits); `counter` is the attribute of the timings that counts evaluations."""

    def __init__(self, positions: Positions, groups: int, timings: Timings, counter: str = "evaluations") -> None:
        super().__init__(positions)
        self.groups, self._timings, self._counter = groups, timings, counter
        self._energies, self._energy = False, 0.0

    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of these groups at the present positions."""
        if self._energies:
            self(state)
            return self._energy
        return self._potential_energy(self.positions.write, state)

    def energy_at(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of these groups at the positions of any state."""
        return self._potential_energy(self.positions.show, state)

    def with_energies(self) -> None:
        """Evaluate the potential energy together with the forces in all later evaluations."""
        self._energies = True

    def landscape(self, state: BodyState) -> tuple[float, Array, Array]:
        """Return the potential energy (kJ/mol), force and torque at the positions of any state."""
        self.positions.show(State.of(state))
        found = self.positions.context.getState(energy=True, forces=True, groups=self.groups)
        return float(found.getPotentialEnergy()._value), *self.positions.bodies.forces(state, arrays.forces(found))

    def of(self, groups: int, counter: str = "evaluations") -> ContextForces:
        """Return the forces of those groups that are also in `groups` (bits)."""
        return ContextForces(self.positions, self.groups & groups, self._timings, counter)

    def _potential_energy(self, place: Callable[[State], None], state: State) -> float:
        if not self.groups:
            return 0.0
        return float(self._asked(place, state, energy=True).getPotentialEnergy()._value)

    def _evaluated(self, state: State, present: bool) -> Force:
        place = self.positions.write if present else self.positions.show
        found = self._asked(place, state, forces=True, energy=self._energies)
        if self._energies and present:
            self._energy = float(found.getPotentialEnergy()._value)
        return self.positions.bodies.forces(state.rounded, arrays.forces(found))

    def _asked(self, place: Callable[[State], None], state: State, **kinds: bool) -> Any:
        """Return OpenMM's State at the positions that a state of the bodies defines, and count the evaluation."""
        start = time.perf_counter()
        place(state)
        found = self.positions.context.getState(groups=self.groups, **kinds)
        self._count(start)
        return found

    def _count(self, start: float) -> None:
        """Count an evaluation that started at the given time."""
        self._timings.forces += time.perf_counter() - start
        self._add_evaluations(1)

    def _add_evaluations(self, n: int) -> None:
        setattr(self._timings, self._counter, getattr(self._timings, self._counter) + n)


class SlowGroups(ContextForces):
    """The forces of given groups without the fast forces, which are integrated within the drifts."""

    def __init__(self, forces: ContextForces, fast: ContextForces, timings: Timings) -> None:
        super().__init__(forces.positions, forces.groups & ~fast.groups, timings)
        self._fast = fast

    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of slow and fast forces."""
        return super().energy(state) + self._fast.energy(state)


class Remainder(EvaluatedForces):
    """All forces minus the fast forces on selected bodies, which are evaluated separately.

    For any choice of fast forces, the remainder and the fast forces sum to all forces. The System is not modified.
    """

    def __init__(self, forces: ContextForces, fast: ContextForces, part: Part) -> None:
        super().__init__(forces.positions)
        self._forces, self._fast, self._part = forces, fast, part

    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of all forces."""
        return self._forces.energy(state)

    def with_energies(self) -> None:
        """Evaluate the potential energy together with the forces in all later evaluations."""
        self._forces.with_energies()

    def _evaluated(self, state: State, present: bool) -> Force:
        own = self._part.of(state)
        if present:
            all_forces, fast_forces = self._forces(state), self._fast(own)
        else:
            all_forces, fast_forces = self._forces.at(state), self._fast.at(own)
        force, torque = (a.copy() for a in all_forces)
        force[:, self._part.columns] -= fast_forces[0]
        torque[:, self._part.turning] -= fast_forces[1]
        return force, torque
