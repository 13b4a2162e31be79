"""Thermostats: what each of them says of itself, and the substep that they all have."""

from __future__ import annotations

import secrets
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.environment import Environment
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.rng import Instant
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.schemes import Scheme, thermostatted
from openmm_exactrb.support.types import Array

#: exchange(P, m, tau, at) -> (P, m): momenta as sums (2, 3, N) and (2, 3, K), new arrays or the same ones.
Exchange = Callable[[Array, Array, float, Instant], tuple[Array, Array]]

_SEEDS = 2**31  # those of OpenMM that are not negative
_STREAMS = 2**22  # with the seed they fit into the 53 bits of a variable of OpenMM


class Factors(NamedTuple):
    """The kernel that makes the two factors of a heat exchange on a device, a function in kernels/thermostats.cl.

    Its defines come with it, and how many persistent numbers it has: first those of ``Thermostat.numbers``, then the
    thermostat's own.
    """

    kernel: str
    defines: tuple[tuple[str, object], ...]
    size: int


class Thermostat(ABC):
    """A thermostat of an `openmm_exactrb.ExactRigidBodyIntegrator`.

    Derive a frozen dataclass from it and hand it over as ``thermostat=``.

    Attributes
    ----------
    temperature : float
        In K.
    numbers : tuple of str
        Persistent numbers of `openmm_exactrb.context.variables` that its steps change.
    heat : str or None
        The one of them in which the energy is added up that it gives to the bodies.
    factors : Factors, optional
        The kernel of a device that makes the numbers by which an exchange multiplies momenta, if it does.
    scheme : str
        The default scheme of an integrator with it: "BAOA", the splitting of LangevinMiddleIntegrator, which
        evaluates forces once a step. A deterministic thermostat has one that is symmetric in time.
    """

    temperature: float
    numbers: ClassVar[tuple[str, ...]] = ()
    heat: ClassVar[str | None] = None
    factors: Factors | None = None
    scheme: ClassVar[str] = "BAOA"

    @property
    def relaxation(self) -> float | None:
        """The time in ps in which it takes heat away, if a run that stays hot for longer is an error of its step."""
        return None

    @property
    def own_numbers(self) -> tuple[str, ...]:
        """Persistent numbers that no other thermostat has: checkpoints with them are for this one alone."""
        return ()

    @abstractmethod
    def bind(self, environment: Environment) -> Exchange:
        """Return what it does to momenta.

        Parameters
        ----------
        environment : openmm_exactrb.environment.Environment
        """

    def flow(self, environment: Environment, number: int) -> Flow[State]:
        """Return the flow of its n-th substep in a step, which acts on momenta along the constraints."""
        exchange, tangent = self.bind(environment), environment.kinetic.tangent
        clock, outside = environment.clock, environment.divergence.outside
        bodies, numbers, heat = environment.bodies, environment.numbers, self.heat

        def flow(state: State, tau: float) -> State:
            along = tangent(state)
            P, m = exchange(along.P, along.m, tau, Instant(environment.key, clock.number, number))
            same = P is along.P and m is along.m
            after = state if same else tangent(state._replace(P=P, m=m))
            if heat is not None and not same:
                numbers.present[heat] += _gain(bodies, along, after)
            outside(state, after)
            environment.last_exchange = state, after
            return after

        return flow

    def steps(self, scheme: Scheme) -> Scheme:
        """Return a scheme with half of its flow before and half after each step, unless it has it within."""
        return thermostatted.with_thermostat(scheme)

    def splitting(self, scheme: Scheme) -> tuple[Scheme, int]:
        """Return the drifts and kicks of a step, and how many steps of the scheme they are."""
        return scheme, 1

    def settings(self) -> Mapping[str, Any]:
        """Return the settings that decide on the bits of a run."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def kernel_exchange(self, tau: float, freedom: tuple[int, int]) -> tuple[float, ...] | None:
        """Return the numbers that kernels of a device need for an exchange over tau (ps), None if it is not served.

        `freedom` are the degrees of freedom of translation and of rotation.
        """
        return None


def _gain(bodies: RigidBodies, before: State, after: State) -> float:
    """Return the kinetic energy (kJ/mol) that bodies gained, from momenta along the constraints."""
    gains = (
        np.sum((b[0] - a[0]) * (b[0] + a[0]) / (2.0 * inertia))
        for a, b, inertia in ((before.P, after.P, bodies.mass), (before.m, after.m, bodies.inertia.T))
    )
    return float(sum(gains))


class Noise:
    """The seed of an integrator's noise, and which of its streams is in use.

    The noise of a step depends on both and on the number of the step alone, so that ten calls of ``step(10)`` give the
    bits of ``step(100)``, as does a run that continues from a checkpoint or State in another process. Where a State or
    a step count that is set takes a run elsewhere, as in replica exchange, what follows has a stream of its own; a
    checkpoint has the number of its stream, and brings the noise back.
    """

    def __init__(self) -> None:
        self._drew, self._streams = False, 0

    def set(self, integrator: openmm.CustomIntegrator, seed: int) -> None:
        """Set the seed; with 0 the next step draws one."""
        variables.put(integrator, variables.SEED, seed)
        variables.put(integrator, variables.STREAM, 0)
        self._streams = 0

    def in_use(self, integrator: openmm.CustomIntegrator) -> int:
        """Return the seed: the one that was asked for, else that of a checkpoint or the drawn one; 0 before."""
        return int(integrator.getRandomNumberSeed()) or int(variables.get(integrator, variables.SEED))

    def key(self, integrator: openmm.CustomIntegrator, steps: int) -> int:
        """Return the key of the random numbers of some steps, or of none; a seed is drawn unless one is set."""
        seed = self.in_use(integrator) or 1 + secrets.randbelow(_SEEDS - 1)
        variables.put(integrator, variables.SEED, seed)
        self._drew |= steps > 0
        return seed + _SEEDS * int(variables.get(integrator, variables.STREAM))

    def part(self, integrator: openmm.CustomIntegrator) -> None:
        """Take a stream that nothing had before, where there was noise."""
        if self._drew:
            self._streams = 1 + max(self._streams, int(variables.get(integrator, variables.STREAM)))
            variables.put(integrator, variables.STREAM, self._streams % _STREAMS)


def valid_seed(seed: int) -> int:
    """Return a seed of OpenMM's integrators; ValueError if it is not below 2^31."""
    if seed >= _SEEDS:
        raise ValueError(f"the seed must be below 2^31, not {seed}")
    return seed
