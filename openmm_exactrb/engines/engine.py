"""The definition of an engine: a record of functions with which the steps of an integrator are performed.

The record contains all properties of an engine that the rest of the package uses. A new engine therefore consists of a
folder with its record, and an entry in `openmm_exactrb.engines.catalogue.ENGINES`. Reasons and advice are sentences
without a full stop.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import openmm

from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.updates import ContextUpdates
from openmm_exactrb.mechanics.free_motion import Constrain
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.multiple_time_steps.fast_forces import MultipleTimeSteps
from openmm_exactrb.multiple_time_steps.found import Found, found
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.openmm_access.units import gas_constant_times
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.support.descriptions import unperformed
from openmm_exactrb.thermostats.thermostat import Thermostat


@dataclass(frozen=True)
class Settings:
    """The settings that define the steps of an integrator.

    Attributes
    ----------
    scheme : Scheme
        The scheme of a step, including the substeps of the thermostat.
    outer : Scheme
        The scheme that the user chose.
    splitting : Scheme
        The drifts and kicks of a step, from the outer scheme or from the proposal of hybrid Monte Carlo.
    splits : int
        Number of steps of the splitting per step.
    h : float
        Step size in ps.
    groups : int
        The active force groups, as a bit mask.
    named : list of lists of int, or None
        The particles of bodies in addition to the bodies defined by constraints.
    check : bool
        Whether a jump of the total energy raises an error.
    constraints : tuple of callable
        Types of constraints in addition to distances; see `openmm_exactrb.mechanics.free_motion`.
    """

    scheme: Scheme
    outer: Scheme
    splitting: Scheme
    splits: int
    h: float
    groups: int
    rotor: Rotor
    fast: MultipleTimeSteps | None
    thermostat: Thermostat | None
    named: list[list[int]] | None
    check: bool
    constraints: tuple[Constrain, ...] = ()

    def found(self, context: Any) -> Found:
        """Return the bodies of a Context and its fast forces, which these settings look for only once."""
        known: dict[str, Found] = self.__dict__
        if "_found" not in known:
            known["_found"] = found(context, self.named, self.fast)
        return known["_found"]

    @property
    def unperformed(self) -> str | None:
        """Why a substep or the thermostat, whose kernels were overridden alone, has no flow of its own, or None.

        A class that overrides them in order to have no kernels keeps its flow.
        """
        for substep, part in dict((*self.scheme.rows, *self.splitting.rows)).items():
            why = unperformed(substep, "kernel_moves", "bind")
            if why and substep.kernel_moves(part) is not None:
                return why
        if (thermostat := self.thermostat) is None:
            return None
        why = unperformed(thermostat, "kernel_exchange", *thermostat.flows)
        return why if why and thermostat.kernel_exchange(0.0, (0, 0)) is not None else None

    @property
    def numbers(self) -> tuple[str, ...]:
        """The names of the persistent numbers that substeps change."""
        return () if self.thermostat is None else self.thermostat.persistent

    @property
    def watched(self) -> tuple[float, float] | None:
        """KT (kJ/mol) and the relaxation time (ps) if the temperature is monitored: with friction, and if checked."""
        thermostat = self.thermostat
        if thermostat is None or thermostat.relaxation is None or not self.check:
            return None
        return gas_constant_times(thermostat.temperature), thermostat.relaxation

    @property
    def accepts_hot_states(self) -> bool:
        """Whether resonances heat a run, which hybrid Monte Carlo prevents by rejecting states."""
        return any(substep.kicks for substep, _ in self.scheme.sequence)

    @property
    def memory(self) -> int | None:
        """The number of forces that a processed scheme stores, or None for other schemes."""
        return sum(self.scheme.memory) if self.scheme.processor else None

    @property
    def own_numbers(self) -> tuple[str, ...]:
        """The names of the persistent numbers that only this thermostat has."""
        return () if self.thermostat is None else self.thermostat.own_numbers

    def fingerprint(self, context: Any) -> float:
        """Return a number that identifies all to which the inner state of a processed scheme belongs, except forces.

        An inner state can be continued only with the processor, step size, force groups, free motion, box, parameters
        and time with which it was computed. Without a processor, the result is 0.
        """
        if not self.scheme.processor:
            return 0.0
        state = context.getState(parameters=True)
        return _hash(self.identity, arrays.surroundings(state), state.getTime()._value)

    @cached_property
    def identity(self) -> float:
        """A number that identifies the settings to which the inner state of a processed scheme belongs."""
        return _hash(self.scheme.processor, self.h, self.groups, self.rotor.name, self.fast)


def _hash(*values: object) -> float:
    """Return a number from 1 that identifies values, in every process."""
    return 1.0 + int.from_bytes(hashlib.blake2b(repr(values).encode(), digest_size=6).digest(), "big")


class Propagator(Protocol):
    """Performs the steps of an integrator in a Context, and owns the state between the steps."""

    @property
    def sync(self) -> Synchronisation:
        """The state of the bodies; a propagator whose state is outdated must be replaced."""

    @property
    def updates(self) -> ContextUpdates:
        """The updates that OpenMM performs between steps."""

    @property
    def last_exchange(self) -> tuple[State, State] | None:
        """The states before and after the last heat exchange, or None if the state has changed since that step.

        What does not affect kinetic energies may be that of a later time.
        """

    @property
    def defers_inner_drifts(self) -> bool:
        """Whether drifts with inner steps after the last heat exchange are performed at the start of the next step."""

    def energy_at_exchange(self, version: object, settings: Callable[[], Settings]) -> float:
        """Return the total energy (kJ/mol) at the last heat exchange; the arguments are those of `advance`.

        A ValueError is raised if the engine cannot compute this energy.
        """

    def advance(self, version: object, settings: Callable[[], Settings], key: int, n: int) -> None:
        """Perform n steps; after any error, the Context contains a valid state.

        settings() is called if the `version` of the settings differs from that of the last call; `key` is the key of
        the random numbers.
        """


@dataclass(frozen=True)
class Engine:
    """An engine.

    Attributes
    ----------
    name : str
    unsupported : callable
        unsupported(settings) -> the reason why the scheme, the rotor or the thermostat is not supported, or None.
    unsupported_in : callable
        unsupported_in(context, settings) -> the reason why a Context with this System and platform is not supported, or
        None.
    advice : callable
        advice(context, settings) -> whether ``engine="auto"`` selects the engine if it is supported, and the reason.
    marks : callable
        marks(settings) -> possible values of the first variable of an integrator that contains a state of this engine;
        zero means that the integrator contains no state. The mark identifies the engine that wrote a checkpoint or
        State.
    declare : callable
        declare(integrator, settings) gives an integrator without a Context its variables.
    release : callable
        release(integrator) ends the use of an integrator by the engine, before another engine uses it.
    propagator : callable
        propagator(context, integrator, settings, timings) -> Propagator; the call prepares the Context and the
        integrator.
    prepare_to_read : callable, optional
        prepare_to_read(xml) enables OpenMM to read XML with integrators of this engine.
    information : callable
        information() -> a sentence about the engine for ``exactrb info``.
    """

    name: str
    unsupported: Callable[[Settings], str | None]
    unsupported_in: Callable[[Any, Settings], str | None]
    advice: Callable[[Any, Settings], tuple[bool, str]]
    marks: Callable[[Settings], tuple[float, ...]]
    declare: Callable[[openmm.CustomIntegrator, Settings], None]
    propagator: Callable[[Any, openmm.CustomIntegrator, Settings, Timings], Propagator]
    prepare_to_read: Callable[[str], None] = lambda xml: None
    release: Callable[[openmm.CustomIntegrator], None] = lambda integrator: None
    information: Callable[[], str] = lambda: "available"
