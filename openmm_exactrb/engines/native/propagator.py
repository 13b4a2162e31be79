"""The propagator of the native engine, which lets the integrator execute a program and checks the result."""

from __future__ import annotations

import contextlib
import time
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.context.forces import ContextForces
from openmm_exactrb.context.outside_forces import conserve_energy
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.updates import ContextUpdates
from openmm_exactrb.engines.native.assembly import EXCHANGE_NUMBERS, Assembly
from openmm_exactrb.engines.native.exchange import around_exchange, at_exchange
from openmm_exactrb.engines.native.flexible.molecules import served
from openmm_exactrb.engines.native.flexible.part import Flexible
from openmm_exactrb.engines.native.reports import (
    at_next_step,
    judged,
    kinetic_by_kind,
    monitor,
    thermal,
    warn_of_resonances,
)
from openmm_exactrb.engines.native.state import NativeState
from openmm_exactrb.errors import DivergedError, IntegrationError, NonFiniteError
from openmm_exactrb.library.library import Machine, library
from openmm_exactrb.mechanics.divergence import GROWN, HOTTEST, gained, non_finite
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces
from openmm_exactrb.multiple_time_steps.found import Found
from openmm_exactrb.multiple_time_steps.virtual_sites import are_sites
from openmm_exactrb.openmm_access import platforms
from openmm_exactrb.openmm_access.molecules import in_flexible_molecules
from openmm_exactrb.support.warn import warn

# The state is checked after portions of at least and at most these numbers of steps. Portions grow while one takes less
# than this time (s).
_FEWEST, _MOST, _SECONDS = 10, 1000, 0.05
# The slots (see `Machine.keep`) of the state after steps whose energies are compared, and of the last shown state.
_AFTER, _LAST_SHOWN = 1, 2
# Kinetic and total energy in kJ/mol.
Energies = tuple[float, float]


class NativePropagator:
    """Performs the steps of an integrator in its Context with a program that the integrator executes.

    Parameters
    ----------
    context : openmm.Context
    integrator : openmm.CustomIntegrator
        The Python object that represents a program integrator of the library.
    settings : Settings
    timings : Timings

    Attributes
    ----------
    sync : NativeState
    updates : ContextUpdates
    """

    def __init__(self, context: Any, integrator: Any, settings: Any, timings: Timings) -> None:
        system = context.getSystem()
        self._on_processor = context.getPlatform().getName() in platforms.PROCESSORS
        self._found: Found = settings.found(context)
        self._resonances = self._found.resonances(system)
        self._bonded = self._found.numbers(system) if settings.fast else None
        self._fast_changed = False
        self.sync = NativeState(context, integrator, settings.named, bodies=self._found.bodies)
        self.updates = ContextUpdates(context, settings.named or [])
        self.machine = Machine(library(), integrator)
        self._integrator, self._timings, self._settings = weakref.ref(integrator), timings, settings
        self._sites = bool(are_sites(system).any())
        self._conserves = conserve_energy(system)
        self._version: object = None
        self._shown = True  # whether the Context shows the state, which within a call of a processed scheme it does not
        self._kept = True  # `_shown` before the present steps
        self._sent: tuple[float, ...] = ()
        self._evaluations = self.machine.evaluations
        # Forces from outside may raise errors, after which the Context contains the last complete step.
        self._portion, self._most = (_FEWEST, _MOST) if self._conserves else (1, 1)
        self._largest = 0.0  # the largest kinetic energy (kJ/mol) that was accepted
        self._reference: Energies | None = None  # the energies when it was accepted
        self._load()
        if (evaluated := self._served.evaluated) is not None and not self._on_processor:
            warn(evaluated.warning)

    @property
    def last_exchange(self) -> tuple[State, State] | None:
        """The states before and after the last heat exchange, or None if the state has changed since that step."""
        return around_exchange(self.sync, self.machine, self._assembly.parts) if self.sync.stepped else None

    @property
    def defers_inner_drifts(self) -> bool:
        """Whether kernels perform the inner steps; inner steps for which OpenMM evaluates forces are not deferred."""
        return self._served.evaluated is None

    def energy_at_exchange(self, version: object, settings: Callable[[], Any]) -> float:
        """Return the total energy (kJ/mol) at the last heat exchange.

        Raises
        ------
        ValueError
            If OpenMM evaluates fast forces in drifts after the exchange.
        """
        self.sync.pull()
        state = at_exchange(settings(), self._served, self._fast, self.sync)
        with self.sync.kept(_AFTER):
            forces = ContextForces(self.sync.positions, settings().groups, self._timings)
            return float(sum(self.sync.bodies.kinetic_energies(state.rounded)) + forces.energy_at(state))

    # -- the program ---------------------------------------------------------------------------------------------------

    def _load(self) -> None:
        """Load the program for the settings into the integrator, and write the tables of the program to the machine."""
        context: Any = self.sync.context
        self._served = served(context, self.sync.bodies, self._fast, self._settings)
        self._assembly = assembly = Assembly(
            self.sync.bodies,
            self._settings.scheme,
            self.updates,
            self._sites,
            self._settings.thermostat,
            self._flexible,
            self._served.evaluated,
            self._on_processor,
            self._single,
        )
        self.machine.load(assembly.program.text(self._on_processor))
        self.sync.begin(self.machine, assembly.parts, self._processed, platforms.precision(context) == "single")
        for part in assembly.parts:
            for name, values in part.tables().items():
                self.machine.upload(name, values)
        self.machine["removal"] = self.updates.removal

    @property
    def _single(self) -> bool:
        """Whether increments of the state are in single precision, like OpenMM's forces."""
        return not self._on_processor and platforms.precision(self.sync.context) != "double"

    @property
    def _flexible(self) -> list[Flexible]:
        return [Flexible(molecules, self.sync.particles) for molecules in self._served.molecules]

    @property
    def _fast(self) -> FastForces | None:
        return self._found.fast

    @property
    def _processed(self) -> bool:
        return bool(self._settings.scheme.processor)

    def _bind(self, settings: Any) -> None:
        """Adapt the numbers of the program to new settings; reload the whole program if necessary."""
        before, self._settings = (self._settings.h, self._settings.groups), settings
        nested = self._fast is not None and before != (settings.h, settings.groups)
        if self._assembly.scheme != settings.scheme or nested or self._fast_changed:
            self.sync.pull()
            self._load()
            self.sync.renew()
            self._fast_changed = False
        warn_of_resonances(settings, self._fast, self._resonances)
        self._overheating = monitor(self._settings, self.sync.bodies, self._assembly.parts) if self._conserves else None
        self.machine["settings"] = settings.identity
        self.machine["hottest"] = HOTTEST if self._judged else 1e300
        moves, numbers = self._assembly.table.values(settings.h, self._exchange)
        self.machine.upload("moves", moves)
        self.machine.upload("numbers", numbers)
        if getattr(settings.thermostat, "flexibleFriction", None) is not None:
            whole, first = self._found.whole, self.sync.bodies.first_particle
            flexible = in_flexible_molecules(self.sync.context, whole, settings.named)[whole.owner[first]]
            for part in self._assembly.parts:
                part.flag(self.machine, flexible)

    def _exchange(self, tau: float) -> tuple[float, ...]:
        """Return the numbers of a heat exchange over tau (ps), padded with zeros to `EXCHANGE_NUMBERS`."""
        numbers = self._settings.thermostat.kernel_exchange(tau, self.updates.freedom(self.sync.bodies))
        return (*numbers, *(0.0,) * (EXCHANGE_NUMBERS - len(numbers)))

    def _send(self, key: int) -> None:
        """Write the key of the random numbers, and what acts between steps, if they have changed."""
        updates = self.updates
        removes = updates.removes_motion and not updates.pushes
        present = updates.interval, updates.always, removes, key
        if present == self._sent:
            return
        before = self.machine["interval"], self.machine["always"]
        for name, value in zip(("interval", "always", "removes", "key"), present, strict=True):
            self.machine[name] = float(value)
        if (self.machine["interval"], self.machine["always"]) != before:
            self.machine["calls"] = 0.0  # begin to count steps
        self._sent = present

    def _send_numbers(self) -> None:
        """Write the persistent numbers of a thermostat to the machine, which returns them after each call."""
        integrator = self._integrator()
        if values := [variables.get(integrator, name) for name in self._settings.numbers]:
            self.machine.upload("thermostat", np.array(values))

    # -- calls -----------------------------------------------------------------------------------------------------

    def advance(self, version: object, settings: Callable[[], Any], key: int, n: int) -> None:
        """Perform n steps. After an error, the Context contains the state after the last valid step, or an earlier one.

        The arguments are those of `openmm_exactrb.engines.engine.Propagator.advance`.

        Raises
        ------
        NonFiniteError
            If positions or momenta become infinite, or if a body becomes faster than light.
        IntegrationError
            If integration errors increase the total energy abruptly.
        """
        changed, forces_changed = self.sync.settle()
        if forces_changed:
            self._take_new_forces()
        if version != self._version:
            self._bind(settings())
            self._version, changed = version, True
        if changed:
            self._sent = ()
        self._send(key)
        if changed or self._settings.own_numbers:  # which a user may set without a change of the Context
            self._send_numbers()
        if changed:
            self._largest, self._reference = self._report()[0], None
            if self._overheating is not None:
                self._overheating.begin(self.sync.context.getTime()._value)
        if n > self._portion and self._processed:
            self.machine.keep(_LAST_SHOWN)
        while n > 0:
            count = min(n, self._portion)
            start = time.perf_counter()
            self._perform(count, shows=count == n)
            if time.perf_counter() - start < _SECONDS:
                self._portion = min(2 * self._portion, self._most)
            n -= count
        self.sync.remember_forces()
        if self._overheating is not None:
            now = self.sync.context.getTime()._value
            self._overheating.see(now, lambda: kinetic_by_kind(self.machine, self._assembly.parts))

    def _perform(self, n: int, shows: bool, since: Energies | None = None) -> None:
        """Perform n steps; unless the Context `shows` the result, more steps follow.

        Later energies are compared with those in `since`, by default with those before these steps.

        If the steps diverge, they are repeated one by one, to find the step that does. The message names this step, and
        the Context contains the state before it.
        """
        self._kept = self._shown
        try:
            self._checked(n, shows, since)
            self.sync.stepped = True
        except DivergedError as found:
            self._restore()
            self._show_valid(found)
            if n == 1:
                raise at_next_step(found, self.sync) from None
            since = self._energies()
            self.machine.keep(_LAST_SHOWN)
            for k in range(n):
                self._perform(1, shows and k == n - 1, since)
        except BaseException as error:
            try:
                self._restore()
                self._show()
            except openmm.OpenMMException as second:  # the first error is raised, with a note
                error.add_note(f"The Context could not be restored ({second}): load a checkpoint into a new Context.")
            raise

    def _checked(self, n: int, shows: bool, since: Energies | None) -> None:
        """Perform n steps; raise DivergedError if they diverge, as OpenMM may notice while it evaluates forces."""
        try:
            self._make(n, shows, since)
        except openmm.OpenMMException as error:
            if "NaN" not in str(error):
                raise
            self._refuse()

    def _make(self, n: int, shows: bool, since: Energies | None) -> None:
        """Perform n steps, and compare energies where these may have jumped."""
        kinetic, bad = self._step(n, shows)
        if bad:
            self._refuse()
        self.updates.check_box(self.sync.context)
        grown = kinetic > GROWN * self._largest and self._judged
        if grown and kinetic > GROWN * thermal(self._settings, self.updates, self.sync):
            self._compare(since)
        self._largest = max(self._largest, kinetic)

    def _restore(self) -> None:
        """Restore the state before the present steps."""
        self.machine.restore()
        self._shown = self._kept
        self.sync.moved_on()
        self.sync.stepped = False

    def _show(self) -> None:
        """Show the state of a processed scheme in the Context, if it does not yet."""
        if not self._shown:
            self.machine.show()
            self._shown = True

    def _show_valid(self, found: DivergedError) -> None:
        """Show the state; if it is too large for this, restore the last shown state, and raise the error."""
        if self._shown:
            return
        with contextlib.suppress(openmm.OpenMMException):
            self._show()
            if not self._report()[1]:
                return
        self.machine.restore(_LAST_SHOWN)
        self._shown = True
        self.sync.moved_on()
        raise at_next_step(found, self.sync) from None

    def _step(self, n: int, shows: bool) -> tuple[float, bool]:
        """Perform n steps, and return a report; the Context `shows` the result, as it does without a processor."""
        machine, evaluations, self._shown = self.machine, self._evaluations, shows or not self._processed
        try:
            *report, evaluations = machine.perform(n, shows)
        except openmm.OpenMMException:
            evaluations = machine.evaluations
            raise
        finally:
            trials = self.updates.trial_energies(n)
            around = trials // 2 * self._assembly.evaluated_around
            slow = evaluations - self._evaluations - n * self._assembly.evaluated - around
            self._evaluations = evaluations
            self._timings.evaluations += slow + trials
            self.sync.moved_on()
        kinetic, bad = judged(*report)
        if not bad:
            self._timings.fast_evaluations += n * self._assembly.fast_evaluations + around
        return kinetic, bad

    def _report(self) -> tuple[float, bool]:
        """Return the kinetic energy (kJ/mol), and whether the state of any body is invalid."""
        return judged(*self.machine.report(self._shown))

    def _refuse(self) -> None:
        """Raise DivergedError with the names of the invalid bodies, or the cause of energies that are nan."""
        self.updates.check_box(self.sync.context)
        if not np.isfinite(self.machine.download("factors", np.empty(2))).all():  # zero if the thermostat has none
            raise DivergedError(IntegrationError, self._settings.thermostat.diverged)
        for shown in {
            self._shown,
            False,
        }:  # within a step, only the inner state of a processed scheme is the present one
            if what := non_finite(self.sync.bodies, self.sync.in_machine(shown)):
                raise DivergedError(NonFiniteError, what)
        raise DivergedError(NonFiniteError, "positions or forces became non-finite")

    @property
    def _judged(self) -> bool:
        """Whether a jump of the total energy raises an error."""
        return bool(self._conserves and self._settings.check)

    def _compare(self, since: Energies | None) -> None:
        """Raise DivergedError if the total energy has jumped.

        The energies are compared with those in `since`, or with earlier ones, and if these do not suffice, with those
        before the present steps.
        """
        after, size = self._energies(), len(self.sync.bodies)
        known = since or self._reference
        message = gained(size, known, after) if known is not None else ""
        if since is None and message is not None:
            self.machine.keep(_AFTER)
            here = self._shown
            self._restore()
            message = gained(size, self._energies(), after)
            self.machine.restore(_AFTER)
            self._shown = here
        if message is not None:
            raise DivergedError(IntegrationError, message)
        self._reference = after

    def _energies(self) -> Energies:
        """Return the kinetic and the total energy (kJ/mol) of the state that the Context shows."""
        self._show()
        self._timings.evaluations += 1
        state = self.sync.context.getState(energy=True, groups=self._settings.groups)
        kinetic = self._report()[0]
        return kinetic, kinetic + float(state.getPotentialEnergy()._value)

    def _take_new_forces(self) -> None:
        """Discard all that belongs to the forces before a change: inner coordinates, and numbers of fast forces."""
        self.machine["inner"] = 0.0
        system, settings = self.sync.context.getSystem(), self._settings
        if self._bonded is None or not self._bonded.changed(system):
            return
        before, self._found = self._fast, self._found.renewed(system, settings.fast)
        if before is None and self._fast is not None and self._fast.acts(settings.splitting, settings.h):
            raise ValueError(
                "the bonded forces have changed so that they need inner steps, for which the native engine has no "
                "program: call context.reinitialize(preserveState=True)"
            )
        self._resonances = self._found.resonances(system)
        self._fast_changed, self._version = True, None
