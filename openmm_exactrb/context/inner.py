"""Nested forces in a Context: drifts with steps of their own, and kicks by what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context.excerpt import Excerpt
from openmm_exactrb.context.forces import Forces, Kicks, OtherGroups, Places, Remainder
from openmm_exactrb.context.nesting import Nested
from openmm_exactrb.context.session import Session
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.guard import Guard
from openmm_exactrb.motion.kick import kick
from openmm_exactrb.motion.kinetic import Kinetic, of_bodies, rigid
from openmm_exactrb.motion.nested import nested_drift
from openmm_exactrb.motion.part import Whole
from openmm_exactrb.motion.state import State
from openmm_exactrb.rotors import Rotor, rotor_of_sums
from openmm_exactrb.schemes.scheme import Scheme

_COUNTER = "fast_evaluations"


class Inner:
    """What stands within the drifts of a Context.

    Parameters
    ----------
    nested : Nested
    bodies : RigidBodies
        All of the Context.
    rotor : Rotor
    timings : Timings

    Attributes
    ----------
    nested : Nested
    """

    def __init__(self, nested: Nested, bodies: RigidBodies, rotor: Rotor, timings: Timings) -> None:
        self.nested, self._timings = nested, timings
        self._portion = Whole(bodies) if nested.excerpt is None else nested.excerpt.part
        self._kinetic = free_motion(self._portion.bodies, rotor, timings)
        self._own = None if nested.excerpt is None else Own(nested.excerpt)
        self._clusters_outside = len(self._portion.bodies.clusters) < len(bodies.clusters)
        self._free = rigid(bodies.mass, timings.of_rotor(rotor_of_sums(rotor, bodies.inertia)), rotor.order)

    def split(
        self,
        session: Session,
        kinetic: Kinetic,
        forces: Forces,
        guard: Guard,
        splitting: Scheme,
        h: float,
        along: Callable[[Flow[State]], Flow[State]],
    ) -> tuple[Kinetic, Kicks, Callable[[], None]]:
        """Return drifts with the nested forces in them, what is left for kicks, and what keeps up with the Context.

        Parameters
        ----------
        session : Session
        kinetic : Kinetic
            Of all bodies.
        forces : Forces
            All of them.
        guard : Guard
        splitting : Scheme
            Whose drifts they are.
        h : float
            Its step in ps.
        along : callable
            along(drift) -> a drift with which the time of the Context goes on.
        """
        in_context = self._own is None  # whether nested forces are those of the Context, which may look at its time
        fast, slow, follow = self._sides(session, forces)
        drift = nested_drift(
            self._others(kinetic),
            self._portion,
            along(kinetic.drift) if in_context else self._kinetic.drift,
            guard.bearable(self._portion.bodies, kick(fast)),
            self.nested.inner(splitting).word,
            self.nested.repetitions(splitting, h),
        )
        if len(self._portion.bodies.clusters):
            drift = guard.finite(drift)
        return replace(kinetic, drift=drift if in_context else along(drift)), slow, follow

    def _others(self, kinetic: Kinetic) -> Flow[State] | None:
        """Return a drift of all bodies that is right for the others: mostly none of them is of a cluster."""
        if self._own is None:
            return None
        return kinetic.drift if self._clusters_outside else self._free.drift

    def _sides(self, session: Session, forces: Forces) -> tuple[Forces, Kicks, Callable[[], None]]:
        if self._own is None:
            bits = self.nested.bits
            fast = forces.of(bits, _COUNTER)
            return fast, OtherGroups(forces.of(~bits), fast), lambda: None
        part, own = self._own.excerpt.part, self._own
        fast = own.forces(session, forces.groups, self._timings)
        return fast, Remainder(forces, fast, part), lambda: own.follow(session)


class Own:
    """The Context of an excerpt, which follows box, parameters and particles without mass of another one."""

    def __init__(self, excerpt: Excerpt) -> None:
        self.excerpt = excerpt
        platform = openmm.Platform.getPlatform("Reference")  # few forces: threads and launches would cost more
        self._context = openmm.Context(excerpt.system, openmm.VerletIntegrator(0.001), platform)
        self._changes = excerpt.system.usesPeriodicBoundaryConditions() or bool(len(self._context.getParameters()))
        self._massless = np.flatnonzero([not excerpt.system.getParticleMass(i) for i in range(len(excerpt.particles))])

    def forces(self, session: Session, groups: int, timings: Timings) -> Forces:
        """Return the forces of some groups (bits) on the bodies of the part."""
        self._x = session.particles[self.excerpt.particles]
        self._places = Places(self._context, self.excerpt.part.bodies, self._x)
        self.follow(session)
        return Forces(self._places, groups, timings, not self._changes, counter=_COUNTER)

    def follow(self, session: Session) -> None:
        """Take over the box, the parameters and the places of particles without mass."""
        theirs = session.particles[self.excerpt.particles[self._massless]]
        if not np.array_equal(self._x[self._massless], theirs):
            self._x[self._massless] = theirs
            self._places.lose()
        if self._changes:
            self._surround(session.context)

    def _surround(self, context: Any) -> None:
        state = context.getState(parameters=True)
        self._context.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
        theirs = state.getParameters()
        for name in self._context.getParameters():
            if name in theirs:  # not that of a force which joined the System after its Context was made
                self._context.setParameter(name, theirs[name])


def free_motion(bodies: RigidBodies, rotor: Rotor, timings: Timings) -> Kinetic:
    """Return how bodies move without forces."""
    return of_bodies(bodies, timings.of_rotor(rotor_of_sums(rotor, bodies.inertia)), rotor.order)
