"""The engine that carries words out here, with forces from OpenMM."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.context.account import Account
from openmm_exactrb.context.clock import Clock
from openmm_exactrb.context.couplings import Couplings
from openmm_exactrb.context.forces import Forces, Kicks, Places
from openmm_exactrb.context.inner import Inner, free_motion
from openmm_exactrb.context.letters import LETTERS, Maker, Parts, flows
from openmm_exactrb.context.nesting import Nesting, nested_in
from openmm_exactrb.context.session import Session
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.motion.engine import run, steps
from openmm_exactrb.motion.guard import Guard
from openmm_exactrb.motion.kinetic import Kinetic
from openmm_exactrb.motion.minimise import minimised
from openmm_exactrb.motion.state import State
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import OPENMM, Word


@dataclass(frozen=True)
class Plan:
    """What the steps of an integrator are.

    Attributes
    ----------
    scheme : Scheme
        With all letters of a step in its word.
    makers : mapping
        What makes the flows of letters, by their first character.
    kT : float
        Of a bath, in kJ/mol; 0 without one.
    account : Account
        What the steps add up.
    numbers : mapping
        What a program on a device is told of a bath, by the names of its variables.
    seed : int
        Of the noise there.
    splitting : Scheme or None
        The drifts and kicks of a step, where there is more in the scheme, or it has them in one letter.
    splits : int
        Steps of a splitting in a step.
    """

    scheme: Scheme
    makers: Mapping[str, Maker]
    kT: float = 0.0
    account: Account = field(default_factory=Account)
    numbers: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    splitting: Scheme | None = None
    splits: int = 1


@dataclass
class Host:
    """What the steps of an integrator in its present Context are made of.

    Attributes
    ----------
    session : Session
    couplings : Couplings
    kinetic : Kinetic
    timings : Timings
    inner : Inner or None
        What may stand within the drifts.
    """

    session: Session
    couplings: Couplings
    kinetic: Kinetic
    timings: Timings
    inner: Inner | None = None

    def advance(self, integrator: openmm.CustomIntegrator, plan: Plan, n: int) -> None:
        """Make n steps; what happens, the Context then holds the last state that is one of the bodies.

        Raises
        ------
        ValueError
            If nobody makes the flow of a letter.
        NonFiniteError
            If a step is a bad one.
        """
        session, couplings, scheme, account = self.session, self.couplings, plan.scheme, plan.account
        session.take_up()
        h = integrator.getStepSize().value_in_unit(unit.picosecond)
        places = Places(session.context, session.bodies, session.particles)
        steady = not couplings.act and plan.makers.items() <= LETTERS.items()
        forces = Forces(places, integrator.getIntegrationForceGroups(), self.timings, steady)
        clock = Clock(session.context, integrator, h)
        guard = Guard(session.bodies, forces.potential, clock.at_time(forces.potential), session.box)
        kinetic, slow, follow = self._split(plan, forces, guard, clock, h)
        parts = Parts(session.bodies, kinetic, forces, slow, guard, scheme, clock, account)
        moves = flows(scheme.word + scheme.processor, parts, plan.makers)
        moves[OPENMM] = couplings.flow(session, places, clock)
        between: Word = ((OPENMM, 1.0),) if couplings.act else ()
        guard.begin(session.state, max(couplings.hottest_thermostat(session.context), plan.kT), clock.time)
        state, kept = session.state, (clock.number, clock.time)
        try:
            with np.errstate(all="ignore"):  # what is not finite is reported, with the bodies concerned
                for word, whole in steps(scheme, n, alone=couplings.act):
                    guard.enter(clock.number + 1, clock.time, state, anew=couplings.act)
                    state = guard.leave(run(word, moves, state, h))
                    clock.next()
                    if whole:
                        session.state, kept = state, (clock.number, clock.time)
                        account.keep()
                        session.state = state = run(between, moves, state, h)
                        follow()
        finally:
            clock.reset(*kept)
            account.close()
            session.publish()

    def _split(
        self, plan: Plan, forces: Forces, guard: Guard, clock: Clock, h: float
    ) -> tuple[Kinetic, Kicks, Callable[[], None]]:
        """Return drifts and kicks, with what is nested in the drifts, and what keeps up with the Context."""
        splitting, kinetic = plan.splitting or plan.scheme, self._guarded(guard)
        if self.inner is None or not self.inner.nested.acts(splitting, h, LETTERS.items() <= plan.makers.items()):
            return replace(kinetic, drift=clock.along(kinetic.drift)), forces, lambda: None
        options = forces, guard, splitting, h / plan.splits, clock.along
        return self.inner.split(self.session, kinetic, *options)

    def _guarded(self, guard: Guard) -> Kinetic:
        """Return drifts and displacements that raise NonFiniteError where a cluster finds no way along its constraints.

        Rigid bodies always do. OpenMM is not asked for forces at places that are no numbers.
        """
        if not len(self.session.bodies.clusters):
            return self.kinetic
        drift, displaced = guard.finite(self.kinetic.drift), guard.finite(self.kinetic.displaced)
        return replace(self.kinetic, drift=drift, displaced=displaced)

    def minimise(self, groups: int, tolerance: float, iterations: int) -> None:
        """Bring the bodies to a minimum of the potential energy of some force groups (bits)."""
        session = self.session
        forces = Forces(Places(session.context, session.bodies, session.particles), groups, self.timings)
        session.replace(
            minimised(
                session.bodies,
                session.state.rounded,
                lambda state: forces.landscape(State.of(state)),
                tolerance,
                iterations,
                session.box(),
            )
        )


def host(
    context: openmm.Context,
    integrator: openmm.CustomIntegrator,
    rotor: Rotor,
    named: list[list[int]] | None,
    timings: Timings,
    nesting: Nesting | None = None,
) -> Host:
    """Find the bodies of a Context, and what moves them."""
    session = Session(context, integrator, named)
    kinetic = free_motion(session.bodies, rotor, timings)
    nested = nested_in(context.getSystem(), session.bodies, nesting)
    inner = None if nested is None else Inner(nested, session.bodies, rotor, timings)
    return Host(session, Couplings(context, named or []), kinetic, timings, inner)
