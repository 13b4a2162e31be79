"""Forces of a Context as a function of places."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.context import arrays
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.part import Part
from openmm_exactrb.motion.state import State

Array = NDArray[np.float64]


class Places:
    """Writes the places of bodies into a Context, unless they are there.

    Parameters
    ----------
    context : openmm.Context
    bodies : RigidBodies
    x : (n_particles, 3) array
        Positions of all particles; those of the bodies are overwritten.
    """

    def __init__(self, context: Any, bodies: RigidBodies, x: Array) -> None:
        self.context, self.bodies, self._x = context, bodies, x
        self._at: State | None = None

    def write(self, state: State) -> None:
        """Have the Context at the places of a state."""
        if self._at is None or not _same_places(self._at, state):
            self.context.setPositions(self.bodies.positions(state.rounded, self._x))
            self.context.computeVirtualSites()
            self._at = state

    def lose(self) -> None:
        """Forget where the Context is: something else moves it."""
        self._at = None


class Forces:
    """Forces and torques on bodies at the places of a state.

    The last ones are kept as long as places, box and parameters of the Context are the same. What else forces depend on
    cannot be seen (``updateParametersInContext``): each call of `step` has Forces of its own.

    Parameters
    ----------
    places : Places
    groups : int
        Bits of the force groups that act.
    timings : Timings
    counter : str, optional
        Which number of the timings counts the evaluations.
    steady : bool
        Whether nothing within the call can change box or parameters: they are not looked at then, which would cost 30
        microseconds a step.
    energies : bool, optional
        Whether the potential energy is asked for with every force, because it will be needed.
    """

    def __init__(
        self,
        places: Places,
        groups: int,
        timings: Timings,
        steady: bool = False,
        energies: bool = False,
        counter: str = "evaluations",
    ) -> None:
        self._places, self.groups, self._timings, self._steady = places, groups, timings, steady
        self._energies, self._counter = energies, counter
        self._at: State | None = None
        self._seen: Any = None  # the State of OpenMM that they come from
        self._value = (np.zeros(0), np.zeros(0))

    def __call__(self, state: State) -> tuple[Array, Array]:
        """Return the forces (3, N) and body-frame torques (3, K)."""
        if not self._known(state):
            start = time.perf_counter()
            self._places.write(state)
            self._seen = self._places.context.getState(
                forces=True, energy=self._energies, parameters=not self._steady, groups=self.groups
            )
            forces = arrays.forces(self._seen)
            self._timings.forces += time.perf_counter() - start
            self._timings.count(self._counter)
            self._value = self._places.bodies.forces(state.rounded, forces)
            self._at = state
        return self._value

    def twin(self) -> Forces:
        """Return the same forces with a memory of their own."""
        return Forces(self._places, self.groups, self._timings, self._steady, counter=self._counter)

    def of(self, groups: int, counter: str = "evaluations") -> Forces:
        """Return those of some of the groups, given by their bits."""
        return Forces(self._places, self.groups & groups, self._timings, self._steady, counter=counter)

    def landscape(self, state: State) -> tuple[float, Array, Array]:
        """Return the potential energy in kJ/mol, forces (3, N) and body-frame torques (3, K)."""
        self._places.write(state)
        found = self._places.context.getState(energy=True, forces=True, groups=self.groups)
        force, torque = self._places.bodies.forces(state.rounded, arrays.forces(found))
        return float(found.getPotentialEnergy()._value), force, torque

    def with_energies(self) -> Forces:
        """Return the same forces, with a memory of the potential energy too."""
        return Forces(self._places, self.groups, self._timings, self._steady, True, self._counter)

    def potential(self, state: State) -> float:
        """Return the potential energy in kJ/mol: nothing where no group acts."""
        if not self.groups:
            return 0.0
        if self._energies:
            self(state)
            return float(self._seen.getPotentialEnergy()._value)
        self._places.write(state)
        energy = self._places.context.getState(energy=True, groups=self.groups).getPotentialEnergy()
        return float(energy._value)

    def _known(self, state: State) -> bool:
        """Tell whether the forces at the places of a state are the last ones."""
        if self._at is None or not _same_places(self._at, state):
            return False
        if self._steady:
            return True
        now = self._places.context.getState(parameters=True)
        return arrays.surroundings(now) == arrays.surroundings(self._seen)


class Kicks(Protocol):
    """The forces of the kicks of a scheme."""

    def __call__(self, state: State) -> tuple[Array, Array]:
        """Return forces (3, N) and body-frame torques (3, K)."""

    def twin(self) -> Kicks:
        """Return the same forces with a memory of their own."""

    def with_energies(self) -> Kicks:
        """Return the same forces, with a memory of the potential energy too."""

    def potential(self, state: State) -> float:
        """Return the potential energy of all forces, nested ones too, in kJ/mol."""


@dataclass(frozen=True)
class OtherGroups:
    """The forces of some groups, where those of others are nested.

    Attributes
    ----------
    slow, fast : Forces
    """

    slow: Forces
    fast: Forces

    def __call__(self, state: State) -> tuple[Array, Array]:
        """Return forces (3, N) and body-frame torques (3, K)."""
        return self.slow(state)

    def twin(self) -> OtherGroups:
        """Return the same forces with a memory of their own."""
        return replace(self, slow=self.slow.twin())

    def with_energies(self) -> OtherGroups:
        """Return the same forces, with a memory of the potential energy too."""
        return replace(self, slow=self.slow.with_energies())

    def potential(self, state: State) -> float:
        """Return the potential energy of all forces in kJ/mol."""
        return self.slow.potential(state) + self.fast.potential(state)


@dataclass(frozen=True)
class Remainder:
    """All forces less those that are nested and act on a part of the bodies.

    Whatever the nested forces are, both together are all forces. So nothing has to be changed in the System.

    Attributes
    ----------
    forces, fast : Forces
        All, and those on the bodies of the part.
    part : Part
    """

    forces: Forces
    fast: Forces
    part: Part

    def __call__(self, state: State) -> tuple[Array, Array]:
        """Return forces (3, N) and body-frame torques (3, K)."""
        force, torque = (a.copy() for a in self.forces(state))
        fast_force, fast_torque = self.fast(self.part.of(state))
        force[:, self.part.columns] -= fast_force
        torque[:, self.part.turning] -= fast_torque
        return force, torque

    def twin(self) -> Remainder:
        """Return the same forces with a memory of their own."""
        return Remainder(self.forces.twin(), self.fast.twin(), self.part.twin())

    def with_energies(self) -> Remainder:
        """Return the same forces, with a memory of the potential energy too."""
        return replace(self, forces=self.forces.with_energies())

    def potential(self, state: State) -> float:
        """Return the potential energy of all forces in kJ/mol."""
        return self.forces.potential(state)


def _same_places(a: State, b: State) -> bool:
    """Tell whether two states are at the same places: flows hand on the very arrays that they do not change."""
    return a.R is b.R and a.q is b.q
