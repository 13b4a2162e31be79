"""The propagator on the device: loads the bodies, has OpenMM run the program, and checks the result."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.context import variables
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.updates import ContextUpdates, conserve_energy
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.custom_program import fast_group, load, names
from openmm_exactrb.engines.custom_program.gather import MOST
from openmm_exactrb.engines.custom_program.noise import draws
from openmm_exactrb.engines.custom_program.particle_copies import ParticleCopies
from openmm_exactrb.engines.custom_program.program import Layout
from openmm_exactrb.engines.custom_program.rotor import RANGE
from openmm_exactrb.engines.custom_program.support import UnsupportedError, needs
from openmm_exactrb.engines.engine import NO_BALANCE, Settings
from openmm_exactrb.engines.host.propagator import inner_mark
from openmm_exactrb.mechanics.divergence import ADVICE, GROWN, IntegrationError, NonFiniteError, gained
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.openmm_access.molecules import in_flexible_molecules

Array = NDArray[np.float64]

# How much faster bodies may come to turn within a call than at its start, and the least rotations of a drift, for those
# that begin at rest: first, and when that was not enough.
_HASTE = ((1.75, 1), (5.0, 4), (20.0, 16))
# More rotations of a drift are not tried again: steps are far too long then, not bodies too fast.
_MOST = 256
# More are not even tried once: they would take hours.
_NEVER = 65536
# By what part of the time of a call it may be wrong: sums of steps are rounded.
_ROUNDED = 1e-6


class DevicePropagator:
    """Makes the steps of an integrator in its Context by the integrator's program, which OpenMM runs.

    The System of the Context and the program of the integrator are prepared for it.

    Parameters, attributes and errors are those of `openmm_exactrb.engines.host.propagator.Propagator`; the rotor is the
    exact one.
    """

    def __init__(
        self,
        context: Any,
        integrator: openmm.CustomIntegrator,
        settings: Settings,
        timings: Timings,
        layout: Layout,
    ) -> None:
        system, named = context.getSystem(), settings.named
        self.sync, self.updates = (
            ParticleCopies(context, integrator, named, layout.table.constrained),
            ContextUpdates(context, named or []),
        )
        fast_group.answer(context)
        self._integrator, self._timings = weakref.ref(integrator), timings
        timings.evaluations += 1  # OpenMM makes its kernels where it evaluates an energy
        self._table, self._scheme, self._prepared = layout.table, settings.scheme, settings
        self._layout = layout
        # A barostat or thermostat of the System acts on the true state, and OpenMM does not tell when.
        self._continues = self._table.continues and not (self.updates.moves or self.updates.pushes)
        # Box, parameters and step size at the end of the last call: inner coordinates are theirs.
        self._surroundings: object = None
        self._inner_step = 0.0
        self._sites = any(map(system.isVirtualSite, range(system.getNumParticles())))
        pushed = 2 if self.updates.pushes else self.updates.removes_motion
        load.tell(integrator, {names.SITES: self._sites, names.BAROSTAT: self.updates.moves, names.PUSHED: pushed})
        self._version: object = None
        self._numbers: Mapping[str, float] = {}  # what the program is told of a thermostat
        self._named, self._flagged = named, False
        self._rate: float | None = None  # b norm(m) of the fastest body in 1/ps, if it was measured
        self._noise: tuple[int, int] | None = None  # seed and step count for which the generators are set, if known
        # For the divergence check.
        self._masses = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])
        self._conserves, self._checks = conserve_energy(system), True
        self._largest = 0.0  # kinetic energy before a call
        self._kept = False  # whether the program still holds the inner state of the begin of the call

    @property
    def outdated(self) -> bool:
        """Whether the Context is gone, was made again, or needs another program."""
        return self.sync.outdated or self._stale

    @property
    def _stale(self) -> bool:
        """Whether the present step size or force groups need another program."""
        integrator: Any = self._integrator()
        present = replace(self._prepared, h=self._step_size(integrator), groups=integrator.getIntegrationForceGroups())
        if present == self._prepared:
            return False
        try:
            stale = present.groups != self._prepared.groups or needs(self.sync.context, present).layout != self._layout
        except UnsupportedError:
            stale = True
        if not stale:
            self._prepared = present
        return stale

    @property
    def last_exchange(self) -> tuple[State, State] | None:
        """Raise ValueError: the program shows no states within a step."""
        raise ValueError("momenta within a step are not available on the device: use engine='host'")

    def energy_at_exchange(self, version: object, settings: Callable[[], Settings]) -> float:
        """Raise ValueError: the device does not add up the heat of its thermostat."""
        raise ValueError(NO_BALANCE)

    def advance(self, version: object, settings: Callable[[], Settings], key: int, n: int) -> None:
        """Make n steps. After an error the Context holds what it held before.

        Arguments are those of `openmm_exactrb.engines.host.propagator.Propagator.advance`. If bodies come to turn too
        fast for the rotor's range, the steps are repeated with shorter rotations.

        NonFiniteError if numbers become infinite, a body turns faster than that too, or forces are too large to be
        summed; IntegrationError if the total energy rises by integration errors.
        """
        if version != self._version:
            present = settings()
            self._version, self._checks = version, present.check and self._conserves
            numbers = None if present.thermostat is None else present.thermostat.device_numbers()
            of = (names.KT, *names.FRICTIONS, *names.FLEXIBLE_FRICTIONS)
            self._numbers = {} if numbers is None else dict(zip(of, numbers, strict=True))
        integrator, context = self._integrator(), self.sync.context
        x, v = self.sync.settle()
        if self._continues and self._leave(integrator):
            x, v = self.sync.moved_on()
        before = context.getState()
        step = before.getStepCount()
        load.tell(integrator, self._numbers)
        self._flag(integrator, x)
        for number, (haste, least) in enumerate(_HASTE):
            turns = max(least, self._turns(integrator, haste))
            if number and turns > _MOST:
                break
            if self._numbers:
                self._seed(integrator, key, step)
            try:
                finite = self._attempt(integrator, n, turns)
                gain = self._gain(integrator, before, x, v) if finite else None
            except BaseException:
                self._go_back(before, x, v)
                raise
            if finite and not gain:
                self._noise, self._surroundings = (key, step + n), self._present_surroundings()
                self._inner_step = self._step_size(integrator)
                self._correct_time(before.getTime()._value + n * self._inner_step, n * self._inner_step)
                return
            self._go_back(before, x, v)
            if gain:
                raise IntegrationError(f"within the {n} steps after step {step}: {gain}. {ADVICE.format('call')}")
        raise NonFiniteError(
            f"within the {n} steps after step {step} positions became infinite, a body turned more than "
            f"{_HASTE[-1][0]:g} times as fast as the fastest one before, or forces on a body were beyond {MOST:.2g} "
            "kJ/mol/nm. The Context keeps the state before this call: use a smaller step size or fewer steps a call, "
            "or minimise the energy first"
        )

    def _present_surroundings(self) -> object:
        return arrays.surroundings(self.sync.context.getState(parameters=True)) if self._continues else None

    def _correct_time(self, time: float, elapsed: float) -> None:
        """Set the time (ps) behind a call unless it is right: on Reference it ignores a new step size."""
        context = self.sync.context
        if abs(context.getTime()._value - time) > _ROUNDED * abs(elapsed):
            context.setTime(time)

    def _seed(self, integrator: openmm.CustomIntegrator, seed: int, step: int) -> None:
        """Set the random number generators for a seed and a step count, unless they are."""
        if self._noise != (seed, step) or integrator.getGlobalVariableByName(names.SEEDED) != seed:
            load.seed(integrator, self.sync.bodies, seed, step * draws(self._table, self._sites))

    def _flag(self, integrator: openmm.CustomIntegrator, x: Array) -> None:
        """Load which particles, at x, are in flexible molecules, where frictions depend on it and it is not loaded."""
        one, other = ([self._numbers.get(name) for name in of] for of in (names.FRICTIONS, names.FLEXIBLE_FRICTIONS))
        if one != other and not (self._flagged and integrator.getGlobalVariableByName(names.FLAGGED)):
            context = self.sync.context
            # Those of the host, where two atoms with a constraint between them are one body.
            bodies = find_bodies(context.getSystem(), x, self._named, self.sync.box())
            load.flag(integrator, bodies, in_flexible_molecules(context, bodies, self._named))
            self._flagged = True

    def _attempt(self, integrator: openmm.CustomIntegrator, n: int, turns: int) -> bool:
        """Make n steps, and return whether all positions and velocities are finite."""
        integrator.setGlobalVariableByName(names.EVALUATED, 0.0)
        mark = inner_mark(self._scheme, self._step_size(integrator))
        known = self._known(integrator) if self._has_inner(integrator, mark) else None
        self._kept = known is not None
        try:
            for part in self._passes(n, known):
                self._configure(integrator, turns, part)
                if part.keeps:
                    self._kept = False
                    self._aside(integrator)
                else:
                    openmm.CustomIntegrator.step(integrator, part.steps)
                self._timings.fast_evaluations += part.steps * self._table.fast_kicks(part.begin, part.end)
            x, v = self.sync.moved_on()
            finite = bool(np.isfinite(x).all() and np.isfinite(v).all())
        except openmm.OpenMMException as error:
            if "NaN" not in str(error):
                raise
            return False
        finally:
            self._configure(integrator, turns, _Pass(0, *self._whole))
            integrator.setGlobalVariableByName(names.KNOWN, 0.0)
            self._timings.evaluations += round(integrator.getGlobalVariableByName(names.EVALUATED))
        if finite and n:
            fastest = integrator.getGlobalVariableByName(names.FASTEST)
            self._rate = fastest ** (1.0 / names.POWER) if math.isfinite(fastest) else None  # a power may be too large
            self._timings.evaluations += self.updates.trial_energies(n)
            if self._continues:
                variables.put(integrator, variables.COORDINATES, mark)
                self._know(integrator, n, known or (0, 0))
        return finite

    def _step_size(self, integrator: openmm.CustomIntegrator) -> float:
        return float(integrator.getStepSize().value_in_unit(unit.picosecond))

    # -- the inner state of a processed scheme ----------------------------------------------------------------------

    def _has_inner(self, integrator: openmm.CustomIntegrator, mark: float) -> bool:
        """Return whether the program holds an inner state in the coordinates with this mark."""
        return self._continues and variables.get(integrator, variables.COORDINATES) == mark

    def _leave(self, integrator: openmm.CustomIntegrator) -> bool:
        """Leave inner coordinates that are not those of the present settings; return whether particles moved.

        The inverse of the processor is exact. Under other forces than those of the inner state what was shown is kept.
        """
        h, mark = self._step_size(integrator), variables.get(integrator, variables.COORDINATES)
        same = self._surroundings in (None, self._present_surroundings())
        if not mark or (same and mark == inner_mark(self._scheme, h)):
            return False
        variables.put(integrator, variables.COORDINATES, 0.0)
        if not same or mark != inner_mark(self._scheme, self._inner_step):
            return False
        openmm.CustomIntegrator.setStepSize(integrator, self._inner_step)
        integrator.setGlobalVariableByName(names.EVALUATED, 0.0)
        try:
            self._configure(integrator, self._turns(integrator, _HASTE[0][0]), _Pass(1, "rest", "leave", returns=True))
            self._aside(integrator)
        finally:
            openmm.CustomIntegrator.setStepSize(integrator, h)
            integrator.setGlobalVariableByName(names.KNOWN, 0.0)
            self._timings.evaluations += round(integrator.getGlobalVariableByName(names.EVALUATED))
        return True

    def _known(self, integrator: openmm.CustomIntegrator) -> tuple[int, int]:
        """Return how many forces and differences are remembered with it."""
        forces, differences = (int(variables.get(integrator, n)) for n in (variables.REMEMBERED, variables.DIFFERENCES))
        return forces, differences

    def _know(self, integrator: openmm.CustomIntegrator, n: int, known: tuple[int, int]) -> None:
        """Note how many are behind n steps."""
        some = zip((variables.REMEMBERED, variables.DIFFERENCES), known, self._table.remembered(), strict=True)
        for (name, before, more), most in zip(some, self._table.memory, strict=True):
            variables.put(integrator, name, min(most, before + n * more))

    @property
    def _whole(self) -> tuple[str, str]:
        """The parts of a step alone."""
        return ("enter", "leave") if self._table.enter else ("step", "step")

    def _passes(self, n: int, known: tuple[int, int] | None) -> list[_Pass]:
        """Return the passes of n steps, given how many forces are remembered with the inner state, if there is one."""
        if not n:
            return []
        if not self._continues:
            return _Pass.steps_of(n, _Pass(1, *self._whole))
        first = _Pass(1, "enter", "step") if known is None else _Pass(1, "again", "step", returns=True)
        steps = [first, *_Pass.steps_of(n - 1, _Pass(1, "step", "step"))]
        steps[-1] = steps[-1]._replace(asks=True)
        then = (before + n * more for before, more in zip(known or (0, 0), self._table.remembered(), strict=True))
        cheap = self._table.output and all(map(int.__ge__, then, self._table.memory))
        part = "output" if cheap else "leave"
        return [*steps, _Pass(1, part, part, keeps=True)]

    def _aside(self, integrator: openmm.CustomIntegrator) -> None:
        """Make a pass that is no step: time and step count stay, and the remover of motion acts as in the last one."""
        context = self.sync.context
        count, time = context.getStepCount(), context.getTime()
        openmm.Context.setStepCount(context, count - 1)  # not the method that is watched
        try:
            openmm.CustomIntegrator.step(integrator, 1)
        finally:
            openmm.Context.setStepCount(context, count)
            context.setTime(time)

    # -- what the program is told -----------------------------------------------------------------------------------

    def _configure(self, integrator: openmm.CustomIntegrator, turns: int, part: _Pass) -> None:
        """Set which turns of the program's loop a pass has; in plain OpenMM, a whole step."""
        first, last = self._table.span(turns, self._sites, part.begin, part.end)
        news = {names.TURNS: turns, names.FIRST: first, names.LAST: last, names.ASKED: part.asks, names.CHANGED: 1}
        load.tell(integrator, news | {names.KEEP: part.keeps, names.RETURN: part.returns})

    def _turns(self, integrator: openmm.CustomIntegrator, haste: float) -> int:
        """Return the number of rotations that a drift needs, if bodies come to turn `haste` times as fast as now.

        NonFiniteError if they are far too many.
        """
        sync = self.sync
        behind = sync.behind
        if self._rate is None or not behind:
            if behind:
                sync.pull()
            self._rate = load.fastest(sync.bodies, sync.state.rounded)
        needed = haste * self._rate * abs(self._step_size(integrator)) * self._table.longest_drift / RANGE
        if not needed <= _NEVER:
            raise NonFiniteError(
                f"the fastest body would need {needed:.2g} rotations in a drift: use a smaller step size, or set "
                "velocities that bodies can have"
            )
        return math.ceil(needed)

    def _gain(self, integrator: openmm.CustomIntegrator, before: Any, x: Array, v: Array) -> str | None:
        """Return by how much the total energy rose in a call that began at x and v, or None if that is no error.

        Energies are compared if the kinetic energy is far above all those before calls, and above what thermostats
        account for: twice the canonical mean, and 20 kT more for systems of a few bodies. The Context is moved to the
        positions before the call and back.
        """
        (x_now, v_now), context, bodies = self.sync.shown, self.sync.context, self.sync.bodies
        kinetic_before, kinetic = (0.5 * float(self._masses @ np.einsum("ij,ij->i", u, u)) for u in (v, v_now))
        self._largest = max(self._largest, kinetic_before)
        if not self._checks or kinetic <= GROWN * self._largest:
            return None
        kT = max(self._numbers.get(names.KT, 0.0), self.updates.hottest(context))
        freedom = bodies.translational_freedom + bodies.rotational_freedom
        if kinetic <= GROWN * kT * (freedom + 20):
            return None
        self._timings.evaluations += 2
        groups, box = integrator.getIntegrationForceGroups(), context.getState().getPeriodicBoxVectors()
        potential = _potential(context, groups)
        _move(context, x, before.getPeriodicBoxVectors())
        potential_before = _potential(context, groups)
        _move(context, x_now, box)
        self.sync.moved_on()  # the positions before the call were in the Context
        return gained(freedom, (kinetic_before, kinetic_before + potential_before), (kinetic, kinetic + potential))

    def _go_back(self, before: Any, x: Array, v: Array) -> None:
        """Bring the Context back to what it held: a State with box, time and step count, positions and velocities."""
        context, integrator = self.sync.context, self._integrator()
        kept = variables.get(integrator, variables.COORDINATES) if self._kept else 0.0
        load.tell(integrator, {names.LOADED: 0.0})
        openmm.Context.setState(context, before)  # not the method that is watched
        context.setPositions(x)
        context.setVelocities(v)
        self._noise = None
        self.sync.lose()
        self.sync.pull()
        variables.put(integrator, variables.COORDINATES, kept)  # steps leave it alone, but not what is remembered
        self._know(integrator, 0, (0, 0))


class _Pass(NamedTuple):
    """A call of OpenMM: so many steps, from the begin of a part of the table to the end of one.

    It measures how fast bodies turn if it `asks`; it begins by returning to the inner state, or by keeping it.
    """

    steps: int
    begin: str
    end: str
    asks: bool = False
    returns: bool = False
    keeps: bool = False

    @staticmethod
    def steps_of(n: int, step: _Pass) -> list[_Pass]:
        """Return n passes like a step, the last of which asks."""
        passes = [step._replace(steps=n - 1), step._replace(steps=min(n, 1), asks=True)]
        return [some for some in passes if some.steps > 0]


def _potential(context: Any, groups: int) -> float:
    return float(context.getState(energy=True, groups=groups).getPotentialEnergy()._value) if groups else 0.0


def _move(context: Any, x: Array, box: Any) -> None:
    context.setPeriodicBoxVectors(*box)
    context.setPositions(x)
