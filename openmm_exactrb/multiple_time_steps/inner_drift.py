"""Drifts with fast forces within them, in a Context: the inner steps of multiple time stepping.

M. Tuckerman, B. J. Berne and G. J. Martyna, J. Chem. Phys. 97, 1990 (1992), doi:10.1063/1.463137: the drift of the
outer scheme is the flow of the kinetic energy and of a potential, which has a splitting of its own. Bodies on which
this potential does not act have a single drift.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context.forces import ContextForces, EvaluatedForces, Remainder, SlowGroups
from openmm_exactrb.context.synchronisation import Positions, Synchronisation
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.divergence import DivergenceCheck
from openmm_exactrb.mechanics.free_motion import Kinetic, free_motion, only_distances, rigid
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.multiple_time_steps.compiled_forces import BondedForces, terms_of
from openmm_exactrb.multiple_time_steps.compiled_inner_steps import CompiledInnerSteps
from openmm_exactrb.multiple_time_steps.excerpt import Excerpt
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces
from openmm_exactrb.multiple_time_steps.resonance import Resonances
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.rotors import COMPILED, Rotor, rotor_of_sums
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.sequence import Sequence, bound, repeated, through
from openmm_exactrb.substeps import DRIFT, KICK, Substep, kick

_COUNTER = "fast_evaluations"


class InnerDrift:
    """Drifts of the bodies of a Context with fast forces in them."""

    def __init__(self, fast: FastForces, sync: Synchronisation, rotor: Rotor, timings: Timings) -> None:
        self.fast, self._bodies, self._timings = fast, sync.bodies, timings
        self._own = None if fast.excerpt is None else ExcerptContext(fast.excerpt, sync)
        self._part = sync.bodies if fast.excerpt is None else fast.excerpt.part.bodies
        self._rotor, self._free = rotor, free_motion(self._part, rotor)
        forces = None if fast.excerpt is None else fast.excerpt.forces
        self._resonances = Resonances(sync.context.getSystem(), fast.named or range(32), forces)
        self._rigid = rigid(sync.bodies.mass, rotor_of_sums(rotor, sync.bodies.inertia, checked=False))

    def warn_of_resonances(self, scheme: Scheme, h: float) -> None:
        """Warn once if slow forces in steps of h (ps) are in resonance with the motion within the drifts."""
        self._resonances.warn(scheme, abs(h))

    def split(
        self,
        forces: ContextForces,
        kinetic: Kinetic,
        timed: Callable[..., Flow[State]],
        divergence: DivergenceCheck,
        scheme: Scheme,
        h: float,
    ) -> tuple[Flow[State], Mapping[str, Flow[State]], EvaluatedForces]:
        """Return the drifts with fast forces, and the remaining active forces for kicks.

        The drifts are those of all bodies and, unless all have inner steps, the drifts of subsets as in
        ``Kinetic.split``. timed(drift, passes=True) is a drift that moves the positions of the Context and, if
        `passes`, advances its time; h (ps) is the step of the scheme.
        """
        inner, repetitions = self.fast.inner(scheme).sequence, self.fast.repetitions(scheme, h)
        if self._own is None:
            fast = forces.of(self.fast.groups, _COUNTER)
            fast_kick = kick(fast, divergence.of_inner_steps(self._part))
            drift = inner_steps(timed(kinetic.drift), fast_kick, inner, repetitions)
            return drift, {}, SlowGroups(forces, fast, self._timings)
        own, part = self._own, self._own.excerpt.part
        inner_bodies, fast = self._of_excerpt(own, forces, divergence, inner, repetitions)
        others = self._of_others(kinetic)

        def of_all(state: State, tau: float) -> State:
            return part.into(others(state, tau), inner_bodies(part.of(state), tau))

        def of_inner(state: State, tau: float) -> State:
            return part.into(state, inner_bodies(part.of(state), tau))

        def of_others(state: State, tau: float) -> State:
            return part.into(others(state, tau), part.of(state))

        split = {"inner": own.kept_up(timed(of_inner, passes=False)), "others": own.kept_up(timed(of_others))}
        return own.kept_up(timed(of_all)), split, Remainder(forces, fast, part)

    def _of_excerpt(
        self,
        own: ExcerptContext,
        forces: ContextForces,
        divergence: DivergenceCheck,
        inner: Sequence,
        repetitions: Callable[[float], int],
    ) -> tuple[Flow[State], ContextForces]:
        """Return the drift with inner steps for the bodies of the excerpt, and their fast forces."""
        terms, of_groups = terms_of(own.excerpt.numbered, forces.groups), (forces.groups, self._timings, _COUNTER)
        if terms is None:
            fast = ContextForces(own.positions, *of_groups)
        else:
            fast = BondedForces(terms, own.positions, *of_groups)
            if self._rotor in COMPILED and only_distances():
                return CompiledInnerSteps(fast, inner, repetitions, divergence), fast
        fast_kick = kick(fast, divergence.of_inner_steps(self._part))
        return inner_steps(own.counting_moves(self._free.drift), fast_kick, inner, repetitions), fast

    def _of_others(self, kinetic: Kinetic) -> Flow[State]:
        """Return a drift that is valid for bodies outside of the excerpt; that of rigid bodies is cheaper."""
        clusters_outside = len(self._part.clusters) < len(self._bodies.clusters)
        return kinetic.drift if clusters_outside or not only_distances() else self._rigid.drift


def inner_steps(
    drift: Flow[State], fast_kick: Flow[State], sequence: Sequence, repetitions: Callable[[float], int]
) -> Flow[State]:
    """Return a drift that consists of inner steps, with a sequence of drifts and kicks by the fast forces.

    repetitions(tau) is the number of inner steps in a drift of this time.
    """
    flows: dict[Substep, Flow[State]] = {DRIFT: drift, KICK: fast_kick}

    @cache
    def rows(tau: float) -> list[tuple[Flow[State], float]]:
        n = repetitions(tau)
        return bound(repeated(sequence, n), flows, tau / n)

    return lambda state, tau: through(rows(tau), state)


class ExcerptContext:
    """The Context of an excerpt, which follows box, parameters and massless particles of another Context."""

    def __init__(self, excerpt: Excerpt, sync: Synchronisation) -> None:
        self.excerpt, self._sync = excerpt, sync
        platform = openmm.Platform.getPlatform("Reference")  # few forces: threads and launches would cost more
        self._context = openmm.Context(excerpt.system, openmm.VerletIntegrator(0.001), platform)
        self._changes = excerpt.system.usesPeriodicBoundaryConditions() or bool(len(self._context.getParameters()))
        self._massless = np.flatnonzero(parameters.masses(excerpt.system) == 0.0)
        self._x = sync.particles[excerpt.particles]
        self._all = sync.positions
        follow = weakref.WeakMethod(self._follow)  # no cycle, which would keep the Context until it is collected
        self.positions = FollowingPositions(self._context, excerpt.part.bodies, self._x, sync.positions, follow)

    def counting_moves(self, drift: Flow[State]) -> Flow[State]:
        """Return a drift of the bodies of the excerpt that changes its positions."""

        def flow(state: State, tau: float) -> State:
            state = drift(state, tau)
            self.positions.version += 1
            return state

        return flow

    def kept_up(self, drift: Flow[State]) -> Flow[State]:
        """Return a drift of all bodies that also updates the positions of the excerpt."""

        def flow(state: State, tau: float) -> State:
            state = drift(state, tau)
            self.positions.keep_up()
            return state

        return flow

    def _follow(self) -> None:
        self._x[self._massless] = self._sync.particles[self.excerpt.particles[self._massless]]
        if not self._changes:
            return
        arrays.take_surroundings(self._context, self._all.context.getState(parameters=True))


class FollowingPositions(Positions):
    """Positions of an excerpt, updated whenever those of the whole have changed, except by the excerpt's own drift."""

    def __init__(
        self, context: Any, bodies: RigidBodies, x: Any, followed: Positions, follow: Callable[[], Any]
    ) -> None:
        self._followed, self._follow, self._seen, self._count = followed, follow, -1, 0
        super().__init__(context, bodies, x)

    @property
    def version(self) -> int:
        """The version, which follows that of the positions of the whole."""
        if self._seen != self._followed.version:
            self.keep_up()
            self._count += 1
            self._follow()()
        return self._count

    @version.setter
    def version(self, count: int) -> None:
        self._count = count

    def keep_up(self) -> None:
        """Record that the present positions are those of the whole."""
        self._seen = self._followed.version
