"""The forces of a Context as a function of positions."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
import openmm

from openmm_exactrb.context.synchronisation import Positions
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.bodies import ChosenBodies
from openmm_exactrb.mechanics.state import BodyState, Force, ForceMemory, State
from openmm_exactrb.openmm_access import arrays, platforms
from openmm_exactrb.support.types import Array


class KnownForces(NamedTuple):
    """Forces that OpenMM evaluated earlier, which OpenMM may now evaluate to other values.

    OpenMM reports ``updateParametersInContext`` to integrators of the library only. In Python, nothing short of another
    evaluation notices changed forces: the parameters of the System's forces are those of the Context only after this
    call, and reading all of them takes as long as an evaluation.
    """

    forces: ContextForces
    state: State
    found: openmm.State

    def changed(self) -> bool:
        """Return whether forces have changed in a Context with the same box and parameters as at the evaluation.

        Forces that differ from one evaluation to the next, such as random ones, are no change. The positions, the time
        and the number of steps of the Context are afterwards those of the evaluation.
        """
        now = self._now()
        return self._differ(now, arrays.forces(self.found)) and not self._differ(now, self._now())

    def _now(self) -> Array:
        """Return the forces that OpenMM evaluates at the same positions and time."""
        context = self.forces.positions.context
        context.setTime(self.found.getTime())
        openmm.Context.setStepCount(context, self.found.getStepCount())  # not the method that detects changes by users
        return arrays.forces(self.forces.asked(self.state, forces=True))

    def _differ(self, now: Array, before: Array) -> bool:
        """Return whether a force differs by more than rounding errors."""
        return not np.abs(now - before).max(initial=0.0) <= self.forces.rounding * np.sqrt((before * before).mean())


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
    def last_known(self) -> list[KnownForces]:
        """Return the last forces that OpenMM evaluated at present positions."""

    @abstractmethod
    def _evaluated(self, state: State, present: bool) -> Force:
        """Return the forces and torques at the present positions, or at the positions of any state."""


class ContextForces(EvaluatedForces):
    """The forces of given force groups (bits); `counter` is the attribute of the timings that counts evaluations."""

    def __init__(self, positions: Positions, groups: int, timings: Timings, counter: str = "evaluations") -> None:
        super().__init__(positions)
        self.groups, self._timings, self._counter = groups, timings, counter
        self._energies, self._energy = False, 0.0
        self._last: tuple[State, openmm.State] | None = None
        #: A bound of the rounding errors of forces, relative to the root mean square force.
        self.rounding = platforms.rounding(positions.context)

    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of these groups at the present positions."""
        if self._energies:
            self(state)
            return self._energy
        return self.energy_at(state)

    def energy_at(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of these groups at the positions of any state."""
        if not self.groups:
            return 0.0
        return float(self.asked(state, energy=True).getPotentialEnergy()._value)

    def with_energies(self) -> None:
        """Evaluate the potential energy together with the forces in all later evaluations."""
        self._energies = True

    def last_known(self) -> list[KnownForces]:
        """Return the last forces that OpenMM evaluated at present positions."""
        return [] if self._last is None else [KnownForces(self, *self._last)]

    def landscape(self, state: BodyState) -> tuple[float, Array, Array]:
        """Return the potential energy (kJ/mol), force and torque at the positions of any state."""
        self.positions.write(State.of(state))
        found = self.positions.context.getState(energy=True, forces=True, groups=self.groups)
        return float(found.getPotentialEnergy()._value), *self.positions.bodies.forces(state, arrays.forces(found))

    def of(self, groups: int, counter: str = "evaluations") -> ContextForces:
        """Return the forces of those groups that are also in `groups` (bits)."""
        return ContextForces(self.positions, self.groups & groups, self._timings, counter)

    def asked(self, state: State, **kinds: bool) -> Any:
        """Return OpenMM's State at the positions of any state of the bodies, and count the evaluation."""
        start = time.perf_counter()
        self.positions.write(state)
        found = self.positions.context.getState(groups=self.groups, **kinds)
        self._count(start)
        return found

    def _evaluated(self, state: State, present: bool) -> Force:
        found = self.asked(state, forces=True, energy=self._energies)
        if present:
            self._last = state, found
            if self._energies:
                self._energy = float(found.getPotentialEnergy()._value)
        return self.positions.bodies.forces(state.rounded, arrays.forces(found))

    def _count(self, start: float) -> None:
        """Count an evaluation that started at the given time."""
        self._timings.forces += time.perf_counter() - start
        setattr(self._timings, self._counter, getattr(self._timings, self._counter) + 1)


class SlowGroups(ContextForces):
    """The forces of given groups without the fast forces, which are integrated within the drifts."""

    def __init__(self, forces: ContextForces, fast: ContextForces, timings: Timings) -> None:
        super().__init__(forces.positions, forces.groups & ~fast.groups, timings)
        self._fast = fast

    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of slow and fast forces."""
        return super().energy(state) + self._fast.energy(state)

    def last_known(self) -> list[KnownForces]:
        """Return the last slow and fast forces that OpenMM evaluated at present positions."""
        return super().last_known() + self._fast.last_known()


class Remainder(EvaluatedForces):
    """All forces minus the fast forces on selected bodies, which are evaluated separately.

    For any choice of fast forces, the remainder and the fast forces sum to all forces. The System is not modified.
    """

    def __init__(self, forces: ContextForces, fast: ContextForces, part: ChosenBodies) -> None:
        super().__init__(forces.positions)
        self._forces, self._fast, self._part = forces, fast, part

    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of all forces."""
        return self._forces.energy(state)

    def with_energies(self) -> None:
        """Evaluate the potential energy together with the forces in all later evaluations."""
        self._forces.with_energies()

    def last_known(self) -> list[KnownForces]:
        """Return the last of all forces that OpenMM evaluated at present positions."""
        return self._forces.last_known()

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
