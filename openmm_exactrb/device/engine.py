"""The engine on the device: loads the bodies, has OpenMM run the program, and checks the result."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.context.environment import Settings
from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.updates import ContextUpdates
from openmm_exactrb.device import load, names
from openmm_exactrb.device.gather import MOST
from openmm_exactrb.device.noise import draws
from openmm_exactrb.device.replicas import Replicas
from openmm_exactrb.device.rotor import RANGE
from openmm_exactrb.device.rows import Table
from openmm_exactrb.device.selection import Selection
from openmm_exactrb.device.watch import Snapshot, Watch
from openmm_exactrb.mechanics.divergence import IntegrationError, NonFiniteError, advice
from openmm_exactrb.rotors import Rotor

# How much faster bodies may come to turn within a call than at its start, and the least rotations of a drift, for those
# that begin at rest: first, and when that was not enough.
_HASTE = ((1.75, 1), (5.0, 4), (20.0, 16))
# More rotations of a drift are not tried again: steps are far too long then, not bodies too fast.
_MOST = 256
# More are not even tried once: they would take hours.
_NEVER = 65536


@dataclass(kw_only=True)
class DevicePropagator:
    """Makes the steps of an integrator in its Context by the integrator's program, which OpenMM runs.

    Attributes
    ----------
    integrator : weakref.ref
    sync : Replicas
    updates : ContextUpdates
    timings : Timings
    table : Table
        The rows of the program.
    forces, processing : int
        Force evaluations of a step, and of the processor and its inverse.
    sites : bool
        Whether the System has virtual sites.
    watch : Watch
    version, numbers : object, mapping
        Of the settings, and what the program is told of their thermostat.
    rate : float or None
        b norm(m) of the fastest body in 1/ps; None if it was not measured.
    noise : (int, int) or None
        Seed and step count for which the random number generators are set; None if unknown.
    """

    integrator: Callable[[], Any]
    sync: Replicas
    updates: ContextUpdates
    timings: Timings
    table: Table
    forces: int
    processing: int
    sites: bool
    watch: Watch
    version: object = None
    numbers: Mapping[str, float] = field(default_factory=dict)
    rate: float | None = None
    noise: tuple[int, int] | None = None

    @classmethod
    def of(
        cls,
        context: Any,
        integrator: openmm.CustomIntegrator,
        rotor: Rotor,
        named: list[list[int]] | None,
        timings: Timings,
        selection: Selection,
    ) -> DevicePropagator:
        """Prepare the System of a Context and the program of its integrator.

        Raises
        ------
        ValueError
            As `Synchronisation`.
        """
        system = context.getSystem()
        sites = any(map(system.isVirtualSite, range(system.getNumParticles())))
        selection.install_device(context, integrator, Synchronisation(context, integrator, named).bodies)
        sync, updates = Replicas(context, integrator, named), ContextUpdates(context, named or [])
        pushed = 2 if updates.pushes else updates.removes_motion
        for name, value in ((names.SITES, sites), (names.BAROSTAT, updates.moves), (names.PUSHED, pushed)):
            integrator.setGlobalVariableByName(name, float(value))
        bodies, scheme = sync.bodies, selection.scheme
        return cls(
            integrator=weakref.ref(integrator),
            sync=sync,
            updates=updates,
            timings=timings,
            table=selection.table,
            forces=scheme.forces,
            processing=scheme.processing,
            sites=sites,
            watch=Watch(system, bodies.translational_freedom + bodies.rotational_freedom),
        )

    def advance(self, version: object, settings: Callable[[], Settings], key: int, n: int) -> None:
        """Make n steps. After an error the Context holds what it held before.

        Arguments are those of `openmm_exactrb.context.propagator.Propagator.advance`.

        If bodies come to turn too fast for the rotor's range, the steps are repeated with shorter rotations.

        Raises
        ------
        NonFiniteError
            If numbers become infinite, a body turns faster than that too, or forces are too large to be summed.
        IntegrationError
            If the total energy rises by integration errors.
        """
        if version != self.version:
            present = settings()
            thermostat, self.watch.asked = present.thermostat, present.check
            self.version, self.numbers = version, {} if thermostat is None else thermostat.device_numbers()
        integrator, numbers = self.integrator(), self.numbers
        kT = numbers.get(names.KT, 0.0)
        context, (x, v) = self.sync.context, self.sync.settle()
        before = Snapshot(x, v, context.getState().getPeriodicBoxVectors(), context.getTime(), context.getStepCount())
        for name, value in numbers.items():
            integrator.setGlobalVariableByName(name, value)
        for number, (haste, least) in enumerate(_HASTE):
            turns = max(least, self._turns(integrator, haste))
            if number and turns > _MOST:
                break
            if numbers:
                self._seed(integrator, key, before.step)
            try:
                finite = self._attempt(integrator, n, turns)
                gain = self._gained(context, integrator, kT, before) if finite else None
            except BaseException:
                self._go_back(context, integrator, before)
                raise
            if finite and not gain:
                self.noise = key, before.step + n
                return
            self._go_back(context, integrator, before)
            if gain:
                raise IntegrationError(f"within the {n} steps after step {before.step}: {gain}. {advice('call')}")
        raise NonFiniteError(
            f"within the {n} steps after step {before.step} positions became infinite, a body turned more than "
            f"{_HASTE[-1][0]:g} times as fast as the fastest one before, or forces on a body were beyond {MOST:.2g} "
            "kJ/mol/nm. The Context keeps the state before this call: take a smaller step size or fewer steps a call, "
            "or minimise the energy first"
        )

    def _seed(self, integrator: openmm.CustomIntegrator, seed: int, step: int) -> None:
        """Set the random number generators for a seed and a step count, unless they are."""
        if self.noise != (seed, step) or integrator.getGlobalVariableByName(names.SEEDED) != seed:
            load.seed(integrator, self.sync.bodies, seed, step * draws(self.table, self.sites))

    def _gained(self, context: Any, integrator: openmm.CustomIntegrator, kT: float, before: Snapshot) -> str | None:
        """Return what is wrong with the energy, or None."""
        if not self.watch.grown(before.v, self.sync.shown[1]):
            return None
        kT = max(kT, self.updates.hottest(context))
        self.timings.evaluations += 2
        gain = self.watch.gained(context, integrator.getIntegrationForceGroups(), before, kT)
        self.sync.moved_on()  # the positions before the call were in the Context
        return gain

    def _attempt(self, integrator: openmm.CustomIntegrator, n: int, turns: int) -> bool:
        """Make n steps, and return whether all positions and velocities are finite."""
        try:
            for call in _calls(n, self.table.enter > 0 and not self.updates.act):
                self._configure(integrator, turns, call)
                openmm.CustomIntegrator.step(integrator, call.steps)
            x, v = self.sync.moved_on()
            finite = bool(np.isfinite(x).all() and np.isfinite(v).all())
        except openmm.OpenMMException as error:
            if "NaN" not in str(error):
                raise
            return False
        finally:
            self._configure(integrator, turns, Call(0))
            integrator.setGlobalVariableByName(names.KNOWN, 0.0)
        if finite and n:
            fastest = integrator.getGlobalVariableByName(names.FASTEST)
            self.rate = fastest ** (1.0 / names.POWER) if math.isfinite(fastest) else None  # its power may be too large
            self.timings.evaluations += n * self.forces + self.processing + self.updates.trial_energies(n)
        return finite

    def _configure(self, integrator: openmm.CustomIntegrator, turns: int, call: Call) -> None:
        """Set which turns of the program's loop a step has; in plain OpenMM, a whole step."""
        first, last = self.table.span(turns, self.sites, call.enters, call.leaves)
        news = {names.TURNS: turns, names.FIRST: first, names.LAST: last, names.ASKED: call.asks, names.CHANGED: 1}
        for name, value in news.items():
            integrator.setGlobalVariableByName(name, float(value))

    def _turns(self, integrator: openmm.CustomIntegrator, haste: float) -> int:
        """Return the number of rotations that a drift needs, if bodies come to turn `haste` times as fast as now.

        Raises
        ------
        NonFiniteError
            If they are far too many.
        """
        sync = self.sync
        behind = sync.behind
        if self.rate is None or not behind:
            if behind:
                sync.pull()
            self.rate = load.fastest(sync.bodies, sync.state.rounded)
        h = float(integrator.getStepSize().value_in_unit(unit.picosecond))
        needed = haste * self.rate * abs(h) * self.table.longest_drift / RANGE
        if not needed <= _NEVER:
            raise NonFiniteError(
                f"the fastest body would need {needed:.2g} rotations in a drift: take a smaller step size, or set "
                "velocities that bodies can have"
            )
        return math.ceil(needed)

    def _go_back(self, context: Any, integrator: openmm.CustomIntegrator, before: Snapshot) -> None:
        """Bring the Context back to what it held."""
        integrator.setGlobalVariableByName(names.LOADED, 0.0)
        context.setPeriodicBoxVectors(*before.box)
        context.setPositions(before.x)
        context.setVelocities(before.v)
        context.setTime(before.time)
        openmm.Context.setStepCount(context, before.step)  # not the method that is watched
        self.noise = None
        self.sync.lose()
        self.sync.pull()


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
