"""The environment to which substeps and thermostats are bound: forces, free motion, clock and noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.divergence import DivergenceCheck
from openmm_exactrb.mechanics.free_motion import Kinetic
from openmm_exactrb.mechanics.state import Flow, Force, ForceMemory, State
from openmm_exactrb.support.types import Array

if TYPE_CHECKING:
    from openmm_exactrb.steps.substeps import Sequence


class Clock(Protocol):
    """The number of the present step, and the time in ps at its start."""

    number: int
    time: float


class Numbers(Protocol):
    """Named numbers that checkpoints contain. Changes to `present` become permanent when the step is accepted."""

    present: dict[str, float]


class Forces(Protocol):
    """Forces and torques on bodies, evaluated once for each version of the positions."""

    memory: ForceMemory

    def __call__(self, state: State) -> Force:
        """Return the force (3, N) and body-frame torque (3, K) of a state at the present positions."""

    def at(self, state: State) -> Force:
        """Return the force and the torque at the positions of any state."""

    def energy(self, state: State) -> float:
        """Return the potential energy (kJ/mol) of all forces for a state at the present positions."""

    def with_energies(self) -> None:
        """Evaluate the potential energy together with the forces in all later evaluations."""


class Environment(Protocol):
    """The argument of `bind`: the quantities and functions that a substep or a thermostat can use.

    Attributes
    ----------
    key : int
        Key of the random numbers in a call of `step`; `openmm_exactrb.random.rng.Instant` generates noise from this
        key and the clock.
    last_exchange : (State, State) or None
        The states before and after the last heat exchange, set by the thermostat.
    """

    key: int
    last_exchange: tuple[State, State] | None

    @property
    def bodies(self) -> RigidBodies:
        """The bodies of the Context."""

    @property
    def inertia(self) -> Array:
        """The principal moments of inertia (3, K), which are infinite about the axis of a linear body."""

    @property
    def kinetic(self) -> Kinetic:
        """The free motion of the bodies, including any fast forces."""

    @property
    def numbers(self) -> Numbers:
        """The persistent numbers that substeps change."""

    @property
    def clock(self) -> Clock:
        """The clock, with the number of the present step and its time."""

    @property
    def divergence(self) -> DivergenceCheck:
        """The divergence check; ``finite(state)`` and ``finite_momenta(state)`` raise errors for diverged states."""

    @property
    def degrees_of_freedom(self) -> tuple[int, int]:
        """The numbers of translational and of rotational degrees of freedom."""

    def forces(self, group: int | None = None) -> Forces:
        """Return the forces of a force group or, by default, all forces that kicks apply."""

    def exchange_of(self, number: int) -> Flow[State]:
        """Return the flow of heat exchange `number` of a step."""

    def flow_of(self, sequence: Sequence) -> Flow[State]:
        """Return the flow of a sequence of substeps: flow(state, h) -> state."""

    def flexible(self) -> NDArray[np.bool_]:
        """Return a mask (N,) of the bodies in molecules of more than one body."""

    def moved(self) -> None:
        """Mark the positions as changed, so that forces are evaluated again."""
