"""The propagator of the host engine, which performs the steps of an integrator in its Context.

The propagator is created once for a Context, and bound to the settings of the integrator whenever these have changed.
The propagator owns the state. For a processed scheme, this state remains in inner coordinates between calls, and the
Context shows a copy transformed by the scheme's output or by the post-processor.
"""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.context import variables
from openmm_exactrb.context.forces import ContextForces, EvaluatedForces
from openmm_exactrb.context.inner import Inner
from openmm_exactrb.context.outside_forces import conserve_energy
from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.updates import ContextUpdates
from openmm_exactrb.context.variables import Numbers
from openmm_exactrb.engines.engine import Settings
from openmm_exactrb.engines.host.environment import Bound, HostEnvironment
from openmm_exactrb.engines.host.storage import storage_of
from openmm_exactrb.library.library import library, of_library
from openmm_exactrb.mechanics.divergence import DivergenceCheck, Overheating, freedom_by_kind, kinetic_by_kind
from openmm_exactrb.mechanics.free_motion import Kinetic, free_motion
from openmm_exactrb.mechanics.state import Flow, ForceMemory, State
from openmm_exactrb.multiple_time_steps.inner_drift import InnerDrift
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.schemes.thermostatted import canonical_momenta
from openmm_exactrb.steps.sequence import behind_exchange, inverse, through, up_to_kick


class Clock:
    """The number of steps and the time (ps) of a Context within a call, on which some forces depend.

    Time advances in the drifts. Since time is treated as a coordinate, schemes keep their order with time-dependent
    forces. The function step_openmm(integrator, n) lets OpenMM perform its own part of n steps.
    """

    def __init__(self, context: openmm.Context, step_openmm: Callable[[Any, int], None]) -> None:
        self._context, self._step_openmm = weakref.ref(context), step_openmm
        self.begin()

    def begin(self) -> None:
        """Read the number of steps and the time from the Context."""
        context: Any = self._context()
        self.number, self.time = context.getStepCount(), context.getTime().value_in_unit(unit.picosecond)
        self._drifted = 0.0
        self.keep()

    def drift(self, tau: float) -> None:
        """Advance the time within a step."""
        self._drifted += tau
        context: Any = self._context()
        context.setTime(self.time + self._drifted)

    def next(self, h: float) -> None:
        """Complete a step of h (ps)."""
        self._set(self.number + 1, self.time + h)

    def keep(self) -> None:
        """Save the present number and time."""
        self._kept = self.number, self.time

    def restore(self) -> None:
        """Restore the saved number and time."""
        self._set(*self._kept)

    def update(self, integrator: openmm.CustomIntegrator, n: int, h: float) -> None:
        """Let OpenMM perform n steps of its own, the last of which begins at the present time."""
        context: Any = self._context()
        present = self.time + self._drifted
        openmm.Context.setStepCount(context, self.number - n)
        context.setTime(present - (n - 1) * h)
        self._step_openmm(integrator, n)
        openmm.Context.setStepCount(context, self.number)
        context.setTime(present)

    def end_step(self) -> None:
        """Set the time to that of the end of the last step."""
        self._set(self.number, self.time)

    def _set(self, number: int, time: float) -> None:
        self.number, self.time, self._drifted = number, time, 0.0
        context: Any = self._context()
        openmm.Context.setStepCount(context, number)  # bypasses the method that detects changes by the user
        context.setTime(time)


class HostPropagator:
    """Performs the steps of an integrator in a Context; see `openmm_exactrb.engines.engine.Propagator`."""

    def __init__(
        self, context: openmm.Context, integrator: openmm.CustomIntegrator, settings: Settings, timings: Timings
    ) -> None:
        rotor = settings.rotor
        self._found = settings.found(context)
        self.sync = Synchronisation(
            context, integrator, settings.named, bodies=self._found.bodies, storage=storage_of(settings)
        )
        self._kinetic = free_motion(self.sync.bodies, rotor, settings.constraints)
        self.updates = ContextUpdates(context, settings.named or [], self._kinetic.lost)
        self._conserves = conserve_energy(context.getSystem())
        self._timings, self._integrator = timings, weakref.ref(integrator)
        self._positions = self.sync.positions
        self._bonded = self._found.numbers(self._system) if settings.fast else None
        self._take_fast_forces(settings)
        self._clock = Clock(context, library().step_openmm if of_library(integrator) else variables.step_openmm)
        self._version: object = None
        self._processed, self._h = False, 0.0
        self.environment: HostEnvironment
        self._memory: ForceMemory
        self._slow: EvaluatedForces
        self._overheating: Overheating | None = None
        self._left: State | None = None  # the final state of the last call of `advance`

    @property
    def last_exchange(self) -> tuple[State, State] | None:
        """The states before and after the last heat exchange, or None if the state has changed since that step."""
        return self.environment.last_exchange if self._left is self.sync.state else None

    @property
    def defers_inner_drifts(self) -> bool:
        """Return True; see `thermostatted.canonical_momenta`."""
        return True

    def advance(self, version: object, settings: Callable[[], Settings], key: int, n: int) -> None:
        """Perform n steps. After any error, the Context contains the last valid state.

        Substeps are bound to settings() again if the `version` of the settings differs from that of the last call;
        `key` is the key of the random numbers. An IntegrationError is raised if a step diverges; with a processed
        scheme, the Context then contains the state before the call.
        """
        self._left = None
        self._settle(version, settings)
        environment, integrator = self.environment, self._integrator()
        environment.key = key
        environment.numbers.load(integrator)
        try:
            with np.errstate(all="ignore"):  # non-finite numbers are reported with their bodies
                self._make(n)
        finally:
            self._clock.restore()
            environment.numbers.store(integrator)
            self.sync.push()
        if self._overheating is not None:
            self._overheating.see(self._clock.time, lambda: kinetic_by_kind(self.sync.bodies, self.sync.state))
        if n:
            self._left = self.sync.state

    def energy_at_exchange(self, version: object, settings: Callable[[], Settings]) -> float:
        """Return the total energy (kJ/mol) at the last heat exchange, where energy errors have the scheme's order.

        The drifts after this exchange are temporarily undone. The arguments are those of `advance`.
        """
        self._settle(version, settings)
        try:
            with np.errstate(all="ignore"):
                state = through(self._back, self.sync.state)
            kinetic = sum(self.sync.bodies.kinetic_energies(state.rounded))
            return kinetic + self.environment.all_forces.energy_at(state)
        finally:
            self._clock.restore()
            self.sync.push()

    def _settle(self, version: object, settings: Callable[[], Settings]) -> None:
        """Update the state and the substeps after changes to the Context and the integrator."""
        changed = self.sync.pull()
        self._clock.begin()
        self._positions.version += 1  # other quantities on which forces depend may have changed
        if self._bonded is not None and self._bonded.changed(self._system):
            present = settings()
            self._found = self._found.renewed(self._system, present.fast)
            self._take_fast_forces(present)
            self._version, self.sync.inner = None, None
        if version != self._version:
            self._bind(settings())
            self._version, changed = version, True
        if changed:
            self.environment.divergence.begin(self.sync.state)
            if self._overheating is not None:
                self._overheating.begin(self._clock.time)

    @property
    def _system(self) -> openmm.System:
        return self.sync.context.getSystem()

    def _take_fast_forces(self, settings: Settings) -> None:
        """Prepare inner steps for the fast forces."""
        fast, arguments = self._found.fast, (self.sync, settings.rotor, self._timings, not settings.constraints)
        self._resonances = self._found.resonances(self._system)
        self._inner_drift = None if fast is None else InnerDrift(fast, *arguments)

    def _make(self, n: int) -> None:
        """Perform n steps from the present state."""
        check, clock = self.environment.divergence, self._clock
        check.enter(clock.number + 1, clock.time, self.sync.state)
        if not n:
            return
        state = self._entered()
        check.keep_from(state)
        for _ in range(n):
            check.enter(clock.number + 1, clock.time, state)
            state = through(self._step, state)
            check.leave(state)
            clock.next(self._h)
            state = self._updated(state)
            if not self._processed:
                self._keep(state)
        if self._processed:
            self._keep(self._shown(state))
            clock.restore()  # the drifts of the output have advanced the time
            fingerprint = self.sync.fingerprint(self.sync.context)
            self.sync.inner = Inner(state, fingerprint, self._memory.copy(), self._slow.last_known())

    def _keep(self, state: State) -> None:
        """Accept a state and the data that belong to it as valid."""
        self.sync.state = state
        self._clock.keep()
        self.environment.numbers.keep()

    # -- processed schemes: the inner state continues, and the output is a copy --------------------------------------

    def _entered(self) -> State:
        """Return the state from which steps continue."""
        if not self._processed:
            return self.sync.state
        inner = self.sync.valid_inner()
        self._clock.restore()
        self._positions.version += 1
        if inner is None:
            return self._processed_from(self.sync.state)
        self._memory.restore(inner.memory)
        return inner.state

    def _processed_from(self, state: State) -> State:
        """Return the inner state that corresponds to a true state at the present positions."""
        check = self.environment.divergence
        check.keep_from(state)
        inner = through(self._processor, state)
        check.leave(inner)  # the kicks of the processor grow with the step size, which may be far too large
        self._memory.clear()
        return inner

    def _true(self, inner: State) -> State:
        """Return the true state that corresponds to an inner state at the present positions, by the post-processor."""
        return self._copied(self._postprocessor, inner)

    def _shown(self, inner: State) -> State:
        """Return the output for an inner state, as a copy, so that the error of the output does not accumulate."""
        cheap = self._output and self._memory.full
        return self._copied(self._output if cheap else self._postprocessor, inner)

    def _copied(self, substeps: Bound, inner: State) -> State:
        """Return a copy of the inner state after substeps whose forces are not stored."""
        self._memory.closed = True
        try:
            return through(substeps, inner)
        finally:
            self._memory.closed = False

    # -- OpenMM's updates between steps --------------------------------------------------------------------------------

    def _updated(self, state: State) -> State:
        """Return a state after the updates of OpenMM that follow a step."""
        if not self.updates.act:
            return state
        n = self.updates.due()
        if self._processed or not n:
            state = self.environment.at_rest(state)
        if not n:
            return state
        box = arrays.box(self.sync.context.getState())
        try:
            state = self._acted(state, n, box)
        except BaseException:
            self.sync.context.setPeriodicBoxVectors(*np.reshape(box, (3, 3)))
            raise
        self._clock.end_step()
        self.environment.divergence.keep_from(state)
        return state

    def _acted(self, state: State, n: int, box: tuple[float, ...]) -> State:
        """Return a state after n of OpenMM's updates; `box` is the box before these updates.

        Barostats act on the true state of a processed scheme. With other schemes, they act at the positions of the
        next kick, and so does a CMMotionRemover.
        """
        before = self._true(state) if self._processed else through(self._up_to_kick, state)
        there = before if self._processed else self.environment.at_rest(before)
        self._positions.write(there)
        if self.updates.pushes:
            self.sync.write_velocities(there)
        self._clock.update(self._integrator(), n, self._h)
        self._timings.evaluations += self.updates.trial_energies(n)
        after = self.updates.changed(self.sync, there, box)
        if after is not there or self.updates.pushes:
            self._positions.moved()
        if after is not before:
            return self._processed_from(after) if self._processed else through(self._back_from_kick, after)
        if before is not state:
            self._positions.version += 1  # the Context again contains the positions of the state
        return state

    # -- binding substeps ----------------------------------------------------------------------------------------------

    def _bind(self, settings: Settings) -> None:
        """Bind the substeps of the settings to a new environment."""
        sync, h = self.sync, settings.h
        forces = ContextForces(self._positions, settings.groups, self._timings)
        divergence = DivergenceCheck(sync.bodies, forces.energy_at, sync.box, self._conserves and settings.check)
        kinetic, slow = self._split(settings, forces, divergence)
        scheme, bodies = settings.scheme if slow is forces else settings.scheme.with_inner_steps, sync.bodies
        self._h, self._processed, self._slow = h, bool(scheme.processor), slow
        sync.fingerprint = settings.fingerprint
        slow.memory = self._memory = ForceMemory(*scheme.memory)
        watched = settings.watched if self._conserves else None
        self._overheating = watched and Overheating(freedom_by_kind(bodies), *watched)
        self.environment = environment = HostEnvironment(
            bodies,
            np.where(bodies.principal_moments > 0.0, bodies.principal_moments, np.inf),
            kinetic,
            slow,
            forces,
            divergence,
            self._clock,
            self.updates,
            Numbers(settings.numbers),
            settings,
            self._positions,
            self._found.whole,
        )
        step = canonical_momenta(scheme.sequence) if kinetic.split else scheme.sequence
        self._step, self._output = environment.bound(step, h), environment.bound(scheme.output, h)
        self._back = environment.bound(inverse(behind_exchange(step)), h)
        ahead = up_to_kick(step)
        self._up_to_kick, self._back_from_kick = environment.bound(ahead, h), environment.bound(inverse(ahead), h)
        self._processor, self._postprocessor = (
            environment.bound(rows, h) for rows in (scheme.processor, scheme.postprocessor)
        )

    def _split(
        self, settings: Settings, forces: ContextForces, divergence: DivergenceCheck
    ) -> tuple[Kinetic, EvaluatedForces]:
        """Return the free motion, including any fast forces, and the forces of kicks."""
        kinetic, check = self._kinetic, divergence.finite
        constrained = bool(settings.constraints) or bool(len(self.sync.bodies.clusters))
        displaced = _checked(kinetic.displaced, check) if constrained else kinetic.displaced
        inner, scheme = self._inner_drift, settings.splitting
        drift, slow = self._timed(kinetic.drift), cast(EvaluatedForces, forces)
        split: Mapping[str, Flow[State]] = {}
        if inner is not None and inner.fast.acts(scheme, settings.h):
            h = settings.h / settings.splits
            drift, split, slow = inner.split(forces, kinetic, self._timed, divergence, scheme, h)
            if self._resonances is not None and settings.accepts_hot_states:
                self._resonances.warn(scheme, abs(h))
        if constrained:  # the drift of a cluster may fail, unlike that of a rigid body
            drift, split = _checked(drift, check), {name: _checked(some, check) for name, some in split.items()}
        return Kinetic(drift, displaced, kinetic.tangent, split), slow

    def _timed(self, drift: Flow[State], passes: bool = True) -> Flow[State]:
        """Return a drift that marks positions as changed and, if time `passes`, advances the time of the Context."""
        positions, clock, timings = self._positions, self._clock, self._timings

        def flow(state: State, tau: float) -> State:
            start, nested = time.perf_counter(), timings.forces
            state = drift(state, tau)
            timings.rotor += time.perf_counter() - start - (timings.forces - nested)
            positions.version += 1
            if passes:
                clock.drift(tau)
            return state

        return flow


def _checked(flow: Callable[[State, Any], State], check: Callable[[State], Any]) -> Callable[[State, Any], State]:
    """Return a flow that raises NonFiniteError before OpenMM evaluates forces at non-finite positions."""

    def checked(state: State, argument: Any) -> State:
        after = flow(state, argument)
        check(after)
        return after

    return checked
