"""The environment to which the substeps of a scheme are bound in a Context."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.context.forces import ContextForces, EvaluatedForces
from openmm_exactrb.context.synchronisation import Positions
from openmm_exactrb.context.updates import ContextUpdates
from openmm_exactrb.context.variables import Numbers
from openmm_exactrb.engines.engine import Settings
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.divergence import DivergenceCheck
from openmm_exactrb.mechanics.free_motion import Kinetic
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.openmm_access.molecules import in_flexible_molecules
from openmm_exactrb.steps.environment import Clock, Forces
from openmm_exactrb.steps.sequence import Sequence, bound, through
from openmm_exactrb.steps.substeps import Substep
from openmm_exactrb.support.descriptions import mismatch
from openmm_exactrb.support.types import Array
from openmm_exactrb.thermostats.thermostat import kinetic_gain

#: Flows of substeps with their times (ps).
Bound = list[tuple[Flow[State], float]]


@dataclass
class HostEnvironment:
    """The `openmm_exactrb.steps.environment.Environment` of a Context, to which substeps are bound.

    `slow` contains the forces of kicks, and `all_forces` the forces of all active force groups. In `whole`, unlike in
    `bodies`, each constrained pair of particles is a linear body (see `openmm_exactrb.multiple_time_steps.found`).
    """

    bodies: RigidBodies
    inertia: Array
    kinetic: Kinetic
    slow: EvaluatedForces
    all_forces: ContextForces
    divergence: DivergenceCheck
    clock: Clock
    updates: ContextUpdates
    numbers: Numbers
    settings: Settings
    positions: Positions
    whole: RigidBodies
    key: int = 0
    last_exchange: tuple[State, State] | None = None

    def forces(self, group: int | None = None) -> Forces:
        """Return the forces of a force group or, by default, all forces that kicks apply."""
        return self.slow if group is None else self.all_forces.of(1 << group)

    def exchange_of(self, number: int) -> Flow[State]:
        """Return the flow of heat exchange `number` of a step."""
        if self.settings.thermostat is None:
            raise ValueError(
                f"scheme {self.settings.scheme.name} contains a thermostat, but the integrator has none: pass "
                "thermostat=, such as openmm_exactrb.thermostats.Langevin(300, 1)"
            )
        return self.settings.thermostat.flow(self, number)

    def at_rest(self, state: State) -> State:
        """Return the state after a CMMotionRemover, and subtract from the heat the kinetic energy that it removed.

        With an AndersenThermostat, which adds energy too, there is no balance to keep.
        """
        after = self.updates.remove_motion(self.bodies.mass, state, self.clock.number)
        thermostat = self.settings.thermostat
        if after is not state and thermostat is not None and thermostat.heat is not None and not self.updates.pushes:
            self.numbers.present[thermostat.heat] += kinetic_gain(self.bodies, state, after)
        return after

    def moved(self) -> None:
        """Mark the positions as changed since the last substep."""
        self.positions.moved()

    def flexible(self) -> NDArray[np.bool_]:
        """Return a mask (N,) of the bodies in molecules of more than one body."""
        whole, first = self.whole, self.bodies.first_particle
        return in_flexible_molecules(self.positions.context, whole, self.settings.named)[whole.owner[first]]

    @property
    def degrees_of_freedom(self) -> tuple[int, int]:
        """The numbers of translational and of rotational degrees of freedom."""
        return self.updates.freedom(self.bodies)

    def bound(self, sequence: Sequence, h: float) -> Bound:
        """Return the flows of a sequence and their times, for the step size h (ps).

        With constraints other than distances, a projection of the momenta follows, because the last flow may be a kick.
        """
        flows: dict[Substep, Flow[State]] = {}
        for substep, _ in sequence:
            if substep not in flows:
                flows[substep] = self._flow_of(substep)
        projection: Bound = [(lambda state, _: self.kinetic.tangent(state), 0.0)] if self.settings.constraints else []
        return bound(sequence, flows, h) + projection

    def _flow_of(self, substep: Substep) -> Flow[State]:
        """Return the flow of a substep, which marks the positions as changed if the substep may change them."""
        flow = substep.bind(self)
        if not substep.moves and not mismatch(substep, "moves", "bind"):
            return flow

        def moving(state: State, tau: float) -> State:
            version = self.positions.version
            after = flow(state, tau)
            if self.positions.version == version and (substep.moves or _displaced(state, after)):
                self.moved()
            return after

        return moving

    def flow_of(self, sequence: Sequence) -> Flow[State]:
        """Return the flow of a sequence: flow(state, h) -> state."""
        known: dict[float, Bound] = {}

        def flow(state: State, h: float) -> State:
            if h not in known:
                known[h] = self.bound(sequence, h)
            return through(known[h], state)

        return flow


def _displaced(before: State, after: State) -> bool:
    """Return whether a flow may have changed positions; a flow that keeps them returns the same arrays."""
    return after.R is not before.R or after.q is not before.q
