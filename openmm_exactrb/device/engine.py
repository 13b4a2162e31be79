"""The engine on the device: loads the bodies, lets OpenMM run the program, and looks at what came of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.context.couplings import Couplings
from openmm_exactrb.context.host import Host, Plan
from openmm_exactrb.context.session import Session
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.device import load, names
from openmm_exactrb.device.chosen import Chosen
from openmm_exactrb.device.gather import MOST
from openmm_exactrb.device.noise import draws
from openmm_exactrb.device.replicas import Replicas
from openmm_exactrb.device.rotor import RANGE
from openmm_exactrb.device.rows import Table
from openmm_exactrb.device.watch import Before, Watch
from openmm_exactrb.motion.guard import NonFiniteError, advice
from openmm_exactrb.motion.kinetic import rigid
from openmm_exactrb.rotors import Rotor, rotor_of_sums
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import DRIFT

# How much faster bodies may come to turn within a call than at its start, and the least rotations of a drift, for those
# that begin at rest: first, and when that was not enough.
_HASTE = ((1.75, 1), (5.0, 4), (20.0, 16))
# More rotations of a drift are not tried again: steps are far too long then, not bodies too fast.
_MOST = 256
# More are not even tried once: they would take hours.
_NEVER = 65536


@dataclass
class Device(Host):
    """Steps of an integrator in its present Context that OpenMM makes by the integrator's program.

    Attributes
    ----------
    watch : Watch
        What looks at the energy.
    rate : float or None
        b norm(m) of the fastest body in 1/ps, None where it was not measured.
    noise : (int, int) or None
        The seed and the number of steps behind which the generators of a bath stand, None where nobody knows.
    """

    watch: Watch = field(kw_only=True)
    rate: float | None = None
    noise: tuple[int, int] | None = None

    @property
    def _replicas(self) -> Replicas:
        assert isinstance(self.session, Replicas)
        return self.session

    def advance(self, integrator: openmm.CustomIntegrator, plan: Plan, n: int) -> None:
        """Make n steps. After an error the Context holds what it held before.

        Where bodies come to turn too fast for the rotor's range, the steps are made again with shorter rotations.

        Raises
        ------
        NonFiniteError
            If numbers become infinite, a body turns faster than that too, forces are too large to be summed, or energy
            comes from nowhere.
        """
        scheme, context, (x, v) = plan.scheme, self._replicas.context, self._replicas.settle()
        before = Before(x, v, context.getState().getPeriodicBoxVectors(), context.getTime(), context.getStepCount())
        for name, value in plan.numbers.items():
            integrator.setGlobalVariableByName(name, value)
        for number, (haste, least) in enumerate(_HASTE):
            turns = max(least, self._turns(integrator, scheme, haste))
            if number and turns > _MOST:
                break
            self._have_noise(integrator, plan, before.step)
            try:
                finite = self._attempt(integrator, scheme, n, turns)
                gain = self._gained(integrator, plan.kT, before) if finite else None
            except BaseException:
                self._go_back(integrator, before)
                raise
            if finite and not gain:
                self.noise = plan.seed, before.step + n
                return
            self._go_back(integrator, before)
            if gain:
                raise NonFiniteError(f"within the {n} steps after step {before.step}: {gain}. {advice('call')}")
        raise NonFiniteError(
            f"within the {n} steps after step {before.step} positions became infinite, a body turned more than "
            f"{_HASTE[-1][0]:g} times as fast as the fastest one before, or forces on a body were beyond {MOST:.2g} "
            "kJ/mol/nm. The Context keeps the state before this call: take a smaller step size or fewer steps a call, "
            "or minimise the energy first"
        )

    def _have_noise(self, integrator: openmm.CustomIntegrator, plan: Plan, step: int) -> None:
        """Have the generators of a bath stand where the seed and the number of a step say, unless they do."""
        if not plan.numbers:
            return
        stands = self.noise == (plan.seed, step) and integrator.getGlobalVariableByName(names.SEEDED) == plan.seed
        if not stands:
            sites = bool(integrator.getGlobalVariableByName(names.SITES))
            load.seed(integrator, self._replicas.bodies, plan.seed, step * draws(Table.of(plan.scheme), sites))

    def _gained(self, integrator: openmm.CustomIntegrator, kT: float, before: Before) -> str | None:
        """Say what is wrong with the energy, or return None."""
        context = self._replicas.context
        if not self.watch.suspects(before.v, self._replicas.shown[1], max(kT, self.couplings.hottest(context))):
            return None
        gain = self.watch.gained(context, integrator.getIntegrationForceGroups(), before)
        self._replicas.moved_on()  # positions were away for the look
        return gain

    def _attempt(self, integrator: openmm.CustomIntegrator, scheme: Scheme, n: int, turns: int) -> bool:
        """Make n steps, and tell whether they led to finite numbers."""
        try:
            for call in _calls(n, bool(scheme.processor) and not self.couplings.act):
                self._tell(integrator, scheme, turns, call)
                openmm.CustomIntegrator.step(integrator, call.steps)
            finite = all(np.isfinite(a).all() for a in self._replicas.moved_on())
        except openmm.OpenMMException as error:
            if "NaN" not in str(error):
                raise
            return False
        finally:
            self._tell(integrator, scheme, turns, Call(0))
            integrator.setGlobalVariableByName(names.KNOWN, 0.0)
        if finite and n:
            fastest = integrator.getGlobalVariableByName(names.FASTEST)
            self.rate = fastest ** (1.0 / names.POWER) if math.isfinite(fastest) else None  # its power may be too large
            self.timings.evaluations += n * scheme.forces + scheme.processing
        return finite

    def _tell(self, integrator: openmm.CustomIntegrator, scheme: Scheme, turns: int, call: Call) -> None:
        """Tell the program which turns of its loop a step has; for plain OpenMM, a whole step."""
        sites = bool(integrator.getGlobalVariableByName(names.SITES))
        first, last = Table.of(scheme).span(turns, sites, call.enters, call.leaves)
        news = {names.TURNS: turns, names.FIRST: first, names.LAST: last, names.ASKED: call.asks, names.CHANGED: 1}
        for name, value in news.items():
            integrator.setGlobalVariableByName(name, float(value))

    def _turns(self, integrator: openmm.CustomIntegrator, scheme: Scheme, haste: float) -> int:
        """Return how many rotations a drift needs, for bodies that will turn so many times as fast as now.

        Raises
        ------
        NonFiniteError
            If they are far too many.
        """
        session = self._replicas
        if self.rate is None or not session.behind:
            if session.behind:
                session.take_up()
            self.rate = load.fastest(session.bodies, session.state.rounded)
        h = float(integrator.getStepSize().value_in_unit(unit.picosecond))
        longest = max((abs(part) for letter, part in scheme.word + scheme.processor if letter == DRIFT), default=0.0)
        needed = haste * self.rate * abs(h) * longest / RANGE
        if not needed <= _NEVER:
            raise NonFiniteError(
                f"the fastest body would need {needed:.2g} rotations in a drift: take a smaller step size, or set "
                "velocities that bodies can have"
            )
        return math.ceil(needed)

    def _go_back(self, integrator: openmm.CustomIntegrator, before: Before) -> None:
        """Bring the Context back to what it held."""
        context = self._replicas.context
        integrator.setGlobalVariableByName(names.LOADED, 0.0)
        context.setPeriodicBoxVectors(*before.box)
        context.setPositions(before.x)
        context.setVelocities(before.v)
        context.setTime(before.time)
        openmm.Context.setStepCount(context, before.step)  # not the method that the session watches
        self.noise = None
        self._replicas.lose()
        self._replicas.take_up()


def device(
    context: Any,
    integrator: openmm.CustomIntegrator,
    rotor: Rotor,
    named: list[list[int]] | None,
    timings: Timings,
    chosen: Chosen,
) -> Device:
    """Prepare the System of a Context and the program of its integrator.

    Raises
    ------
    ValueError
        As `Session`.
    """
    system = context.getSystem()
    sites = any(map(system.isVirtualSite, range(system.getNumParticles())))
    chosen.furnish(context, integrator, Session(context, integrator, named).bodies)
    session, couplings = Replicas(context, integrator, named), Couplings(context, named or [])
    pushed = 2 if couplings.pushes else couplings.removes_motion
    for name, value in ((names.SITES, sites), (names.BAROSTAT, couplings.moves), (names.PUSHED, pushed)):
        integrator.setGlobalVariableByName(name, float(value))
    kinetic = rigid(session.bodies.mass, rotor_of_sums(rotor, session.bodies.inertia), rotor.order)
    return Device(session, couplings, kinetic, timings, watch=Watch(system, session.bodies))


@dataclass(frozen=True)
class Call:
    """A call of OpenMM.

    Attributes
    ----------
    steps : int
    enters, leaves : bool
        Whether each step prepares the state of a processed scheme, and finishes it.
    asks : bool
        Whether it is to measure how fast bodies turn.
    """

    steps: int
    enters: bool = True
    leaves: bool = True
    asks: bool = False


def _calls(n: int, processed: bool) -> Iterator[Call]:
    """Yield into which calls of OpenMM n steps fall."""
    alone = not processed
    if n > 1 and processed:
        yield Call(1, leaves=False)
        n, enters = n - 1, False
    else:
        enters = True
    if n > 1:
        yield Call(n - 1, alone, alone)
    if n > 0:
        yield Call(1, enters, True, asks=True)
