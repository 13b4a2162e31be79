"""The base class of thermostats, with the heat exchange that they share, and the noise of an integrator."""

from __future__ import annotations

import secrets
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.random.rng import Instant
from openmm_exactrb.schemes import Scheme, thermostatted
from openmm_exactrb.steps.environment import Environment
from openmm_exactrb.support.descriptions import Described
from openmm_exactrb.support.types import Array

#: exchange(P, m, tau, at) -> (P, m): linear and angular momenta as double-doubles of shape (2, 3, N) and (2, 3, K), in
#: new arrays or in the same arrays.
Exchange = Callable[[Array, Array, float, Instant], tuple[Array, Array]]

_SEEDS = 2**31  # number of non-negative seeds in OpenMM
_STREAMS = 2**22  # a seed and a stream fit into the 53 bits of an OpenMM variable


class Factors(NamedTuple):
    """The kernel that computes the two factors of a heat exchange, a function in thermostats.cl.

    The record contains the name of the kernel and its preprocessor definitions. Its persistent variables are those of
    ``Thermostat.persistent``.
    """

    kernel: str
    defines: tuple[tuple[str, object], ...]


class Thermostat(Described, ABC):
    """A thermostat of an `openmm_exactrb.ExactRigidBodyIntegrator`.

    Derive a frozen dataclass from this class and pass an instance as ``thermostat=``.

    Attributes
    ----------
    temperature : float
        Temperature in K.
    numbers : tuple of str
        Names of the persistent variables of `openmm_exactrb.context.variables` that the thermostat changes.
    heat : str or None
        Name of the persistent variable that accumulates the energy supplied to the bodies.
    factors : Factors, optional
        The kernel that computes the factors, if an exchange multiplies momenta by factors.
    diverged : str
        The message if these factors are not finite.
    flows : tuple of str
        Names of the methods that define the exchange on the host. A class that overrides one of them does not inherit
        `kernel_exchange`, and the reverse.
    scheme : str
        The default scheme of an integrator with the thermostat: "BAOA", the splitting of LangevinMiddleIntegrator,
        which evaluates forces once per step. A deterministic thermostat needs a scheme that is symmetric in time.
    """

    temperature: float
    numbers: ClassVar[tuple[str, ...]] = ()
    heat: ClassVar[str | None] = None
    factors: Factors | None = None
    diverged: str = "the thermostat diverged within a step"
    flows: ClassVar[tuple[str, ...]] = ("bind", "flow")
    scheme: ClassVar[str] = "BAOA"

    @property
    def relaxation(self) -> float | None:
        """The relaxation time of the thermostat in ps, or None.

        A temperature that stays too high for longer than this time indicates that the step is too long.
        """
        return None

    @property
    def acts(self) -> bool:
        """Whether the thermostat ever changes momenta; otherwise, its temperature is irrelevant."""
        return True

    @property
    def own_numbers(self) -> tuple[str, ...]:
        """Names of variables of this thermostat alone. Other thermostats cannot read checkpoints that contain them."""
        return ()

    @property
    def persistent(self) -> tuple[str, ...]:
        """Names of all persistent variables: `numbers`, and then `own_numbers`."""
        return (*self.numbers, *self.own_numbers)

    @abstractmethod
    def bind(self, environment: Environment) -> Exchange:
        """Return the heat exchange as a function of momenta.

        Parameters
        ----------
        environment : openmm_exactrb.steps.environment.Environment
        """

    def flow(self, environment: Environment, number: int) -> Flow[State]:
        """Return the flow of heat exchange `number` of a step, which acts on momenta projected onto the constraints."""
        exchange, tangent = self.bind(environment), environment.kinetic.tangent
        clock, outside = environment.clock, environment.divergence.outside
        bodies, numbers, heat = environment.bodies, environment.numbers, self.heat

        def flow(state: State, tau: float) -> State:
            along = tangent(state)
            P, m = exchange(along.P, along.m, tau, Instant(environment.key, clock.number, number))
            same = P is along.P and m is along.m
            after = state if same else tangent(state._replace(P=P, m=m))
            if heat is not None and not same:
                numbers.present[heat] += kinetic_gain(bodies, along, after)
            outside(state, after)
            environment.last_exchange = state, after
            return after

        return flow

    def steps(self, scheme: Scheme) -> Scheme:
        """Return a scheme with half a heat exchange at each end of a step, unless the step already contains one."""
        return thermostatted.with_thermostat(scheme)

    def splitting(self, scheme: Scheme) -> tuple[Scheme, int]:
        """Return a scheme with the drifts and kicks of a step, and the number of steps of `scheme` that it contains."""
        return scheme, 1

    def require_inner(self, scheme: Scheme | None) -> None:
        """Raise ValueError if a scheme of inner steps, if there is one, is not supported."""

    def settings(self) -> Mapping[str, Any]:
        """Return the settings that determine a run to the last bit."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def kernel_exchange(self, tau: float, freedom: tuple[int, int]) -> tuple[float, ...] | None:
        """Return the numbers that kernels need for an exchange over tau (ps), or None if there is no kernel.

        `freedom` contains the degrees of freedom of translation and of rotation.
        """
        return None


def kinetic_gain(bodies: RigidBodies, before: State, after: State) -> float:
    """Return the kinetic energy (kJ/mol) gained by the bodies, from momenta projected onto the constraints."""
    gains = (
        np.sum((b[0] - a[0]) * (b[0] + a[0]) / (2.0 * inertia))
        for a, b, inertia in ((before.P, after.P, bodies.mass), (before.m, after.m, bodies.inertia.T))
    )
    return float(sum(gains))


class Noise:
    """The seed of an integrator's noise, and the stream in use.

    The noise of a step depends only on seed, stream and step number. A run that continues in another process from a
    checkpoint, or from a State with ``integratorParameters=True``, therefore has the noise of an uninterrupted run. If
    a loaded State or a new step count makes a run branch off, as in replica exchange, the run continues with a new
    stream. Loading a checkpoint restores its stream.
    """

    def __init__(self) -> None:
        self._drew, self._streams = False, 0

    def set(self, integrator: openmm.CustomIntegrator, seed: int) -> None:
        """Set the seed; with 0, the next step draws a seed."""
        variables.put(integrator, variables.SEED, seed)
        variables.put(integrator, variables.STREAM, 0)
        self._streams = 0

    def in_use(self, integrator: openmm.CustomIntegrator) -> int:
        """Return the seed that was set, read from a checkpoint or drawn; 0 before a seed is drawn."""
        return int(integrator.getRandomNumberSeed()) or int(variables.get(integrator, variables.SEED))

    def key(self, integrator: openmm.CustomIntegrator, steps: int) -> int:
        """Return the key of the random numbers of the next steps; draw a seed unless one is set."""
        seed = self.in_use(integrator) or 1 + secrets.randbelow(_SEEDS - 1)
        variables.put(integrator, variables.SEED, seed)
        self._drew |= steps > 0
        return seed + _SEEDS * int(variables.get(integrator, variables.STREAM))

    def part(self, integrator: openmm.CustomIntegrator) -> None:
        """Switch to an unused stream if noise has already been drawn."""
        if self._drew:
            self._streams = 1 + max(self._streams, int(variables.get(integrator, variables.STREAM)))
            variables.put(integrator, variables.STREAM, self._streams % _STREAMS)

    def parting(self, integrator: openmm.CustomIntegrator) -> Callable[[], None]:
        """Return a function without arguments that calls `part` if the integrator still exists."""
        reference = weakref.ref(integrator)

        def part() -> None:
            if (alive := reference()) is not None:
                self.part(alive)

        return part


def valid_seed(seed: int) -> int:
    """Return the seed if OpenMM's integrators accept it; raise ValueError if the seed is not below 2^31."""
    if seed >= _SEEDS:
        raise ValueError(f"the seed must be below 2^31, not {seed}")
    return seed
