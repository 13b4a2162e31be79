"""Drifts that include fast forces, in a Context: the inner steps of multiple time stepping.

The drift of the outer scheme is the flow of the kinetic energy and of a fast potential, and is itself split by the
method of M. Tuckerman, B. J. Berne and G. J. Martyna, J. Chem. Phys. 97, 1990 (1992), doi:10.1063/1.463137. Bodies on
which fast bonded forces do not act have a single drift. With named force groups, or with constraints that may join any
bodies, all bodies have inner steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
import openmm

from openmm_exactrb.context.forces import ContextForces, EvaluatedForces, Remainder, SlowGroups
from openmm_exactrb.context.synchronisation import Positions, Synchronisation
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.divergence import DivergenceCheck
from openmm_exactrb.mechanics.free_motion import Kinetic, free_motion, rigid
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.multiple_time_steps.excerpt import Excerpt
from openmm_exactrb.multiple_time_steps.excerpt_forces import BondedForces, terms_of
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.rotors import Rotor, rotor_of_sums
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.sequence import Sequence, bound, repeated, through
from openmm_exactrb.steps.substeps import DRIFT, KICK, Substep, kick

_COUNTER = "fast_evaluations"


class InnerDrift:
    """Drifts of the bodies of a Context that include fast forces.

    Bodies without fast forces have inner steps too if they are not `separable` from the others.
    """

    def __init__(
        self, fast: FastForces, sync: Synchronisation, rotor: Rotor, timings: Timings, separable: bool = True
    ) -> None:
        self.fast, self._bodies, self._timings, self._separable = fast, sync.bodies, timings, separable
        excerpt = fast.excerpt
        self._own = None if excerpt is None else ExcerptPositions(excerpt, sync)
        self._part = sync.bodies if excerpt is None else excerpt.part.bodies
        self._free = free_motion(self._part, rotor)
        self._rigid = rigid(sync.bodies.mass, rotor_of_sums(rotor, sync.bodies.inertia, checked=False))

    def split(
        self,
        forces: ContextForces,
        kinetic: Kinetic,
        timed: Callable[..., Flow[State]],
        divergence: DivergenceCheck,
        scheme: Scheme,
        h: float,
    ) -> tuple[Flow[State], Mapping[str, Flow[State]], EvaluatedForces]:
        """Return the drift of all bodies, drifts of subsets, and the active forces that remain for kicks.

        The drifts include the fast forces. The subsets are those of ``Kinetic.split``; there are no subsets if all
        bodies have inner steps. The function timed(drift, passes=True) returns a drift that marks the positions of the
        Context as changed and, if `passes`, advances its time; h (ps) is the step of the scheme.
        """
        inner, repetitions = self.fast.inner(scheme).sequence, self.fast.repetitions(scheme, h)
        if self._own is None:
            fast = forces.of(self.fast.groups, _COUNTER)
            fast_kick = kick(fast, divergence.of_inner_steps(self._part))
            drift = inner_steps(timed(kinetic.drift), fast_kick, inner, repetitions)
            return drift, {}, SlowGroups(forces, fast, self._timings)
        own, part = self._own, self._own.excerpt.part
        fast = self._forces_of(own, forces)
        slow, fast_kick = Remainder(forces, fast, part), kick(fast, divergence.of_inner_steps(self._part))
        if not self._separable:

            def kick_of_part(state: State, tau: float) -> State:
                return part.into(state, fast_kick(part.of(state), tau))

            drift = inner_steps(_followed_by(own.moved, kinetic.drift), kick_of_part, inner, repetitions)
            return _followed_by(own.keep_up, timed(drift)), {}, slow
        inner_bodies = inner_steps(_followed_by(own.moved, self._free.drift), fast_kick, inner, repetitions)
        others = self._of_others(kinetic)

        def of_all(state: State, tau: float) -> State:
            return part.into(others(state, tau), inner_bodies(part.of(state), tau))

        def of_inner(state: State, tau: float) -> State:
            return part.into(state, inner_bodies(part.of(state), tau))

        def of_others(state: State, tau: float) -> State:
            return part.into(others(state, tau), part.of(state))

        split = {
            "inner": _followed_by(own.keep_up, timed(of_inner, passes=False)),
            "others": _followed_by(own.keep_up, timed(of_others)),
        }
        return _followed_by(own.keep_up, timed(of_all)), split, slow

    def _forces_of(self, own: ExcerptPositions, forces: ContextForces) -> ContextForces:
        """Return the fast forces on the bodies of the excerpt, by compiled kernels if these support them."""
        of_groups = forces.groups, self._timings, _COUNTER
        terms = None if own.excerpt.on_sites else terms_of(own.excerpt.numbered, forces.groups)
        return ContextForces(own, *of_groups) if terms is None else BondedForces(terms, own, *of_groups)

    def _of_others(self, kinetic: Kinetic) -> Flow[State]:
        """Return a drift that is valid for bodies outside the excerpt.

        If no nonrigid cluster is outside the excerpt, this is the cheaper drift of rigid bodies.
        """
        clusters_outside = len(self._part.clusters) < len(self._bodies.clusters)
        return kinetic.drift if clusters_outside else self._rigid.drift


def inner_steps(
    drift: Flow[State], fast_kick: Flow[State], sequence: Sequence, repetitions: Callable[[float], int]
) -> Flow[State]:
    """Return a drift that consists of inner steps; each is a sequence of drifts and kicks by the fast forces.

    repetitions(tau) is the number of inner steps in a drift over tau (ps).
    """
    flows: dict[Substep, Flow[State]] = {DRIFT: drift, KICK: fast_kick}

    @cache
    def rows(tau: float) -> list[tuple[Flow[State], float]]:
        n = repetitions(tau)
        return bound(repeated(sequence, n), flows, tau / n)

    return lambda state, tau: through(rows(tau), state)


def _followed_by(notice: Callable[[], None], drift: Flow[State]) -> Flow[State]:
    """Return a drift after which a function is called."""

    def flow(state: State, tau: float) -> State:
        state = drift(state, tau)
        notice()
        return state

    return flow


class ExcerptPositions(Positions):
    """Positions of an excerpt in a separate Context, with box, parameters and massless particles of the whole System.

    Box, parameters and massless particles are updated whenever the positions of the whole System have changed, except
    after the drift of the excerpt itself.
    """

    def __init__(self, excerpt: Excerpt, sync: Synchronisation) -> None:
        platform = openmm.Platform.getPlatform("Reference")  # fastest for few forces
        self._own = openmm.Context(excerpt.system, openmm.VerletIntegrator(0.001), platform)
        self.excerpt, self._whole, self._seen, self._count = excerpt, sync.positions, -1, 0
        super().__init__(self._own, excerpt.part.bodies, sync.particles[excerpt.particles])
        periodic = excerpt.system.usesPeriodicBoundaryConditions() or bool(excerpt.on_sites)
        self._changes = periodic or bool(len(self._own.getParameters()))
        self._massless = np.flatnonzero(parameters.masses(excerpt.system) == 0.0)

    @property
    def version(self) -> int:
        """The version of the positions, which also changes when the positions of the whole System change."""
        if self._seen != self._whole.version:
            self.keep_up()
            self._count += 1
            self.particles[self._massless] = self._whole.particles[self.excerpt.particles[self._massless]]
            if self._changes:
                arrays.take_surroundings(self._own, self._whole.context.getState(parameters=True))
        return self._count

    @version.setter
    def version(self, count: int) -> None:
        self._count = count

    def keep_up(self) -> None:
        """Record that the present positions agree with those of the whole System."""
        self._seen = self._whole.version
