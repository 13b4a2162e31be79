"""What integrators with a bath have in common: a temperature, a seed, and the letter O."""

from __future__ import annotations

import math
import secrets
import weakref
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import openmm
from openmm import unit

from openmm_exactrb.baths import words
from openmm_exactrb.checks import whole
from openmm_exactrb.context import account
from openmm_exactrb.context.couplings import refuse_other_baths
from openmm_exactrb.context.host import Host, Plan
from openmm_exactrb.context.letters import Maker, Parts
from openmm_exactrb.context.units import gas_constant_times, kelvin
from openmm_exactrb.device.choice import Engine
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.bath import Bath
from openmm_exactrb.motion.draws import Instant
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.state import State
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.schemes.word import BATH

_SEEDS = 2**31  # those of OpenMM that are not negative
_STREAMS = 2**22  # with the seed they fit into the 53 bits of a variable of OpenMM


class ThermostattedIntegrator(ExactRigidBodyIntegrator):
    """An `ExactRigidBodyIntegrator` whose steps have a heat bath in them.

    The noise of a step depends on the seed and the number of the step alone, so that ten calls of ``step(10)`` give the
    bits of ``step(100)``, as does a run that goes on from a checkpoint or State in another process. The seed and what
    the steps add up travel with it; temperature and friction are settings, which a new process gives again. Where a
    State or a step count that is set takes a run elsewhere, as in replica exchange, what follows has noise of its own;
    a checkpoint brings the noise back.

    Parameters
    ----------
    temperature : float or Quantity
        In K if it has no unit.
    stepSize, scheme, rotor, bodies, fast, inner, innerSteps, engine
        As `ExactRigidBodyIntegrator` takes them; the schemes also those with the bath within them: "W2_3m",
        "BAOA", "BAOAB" and "ABOBA".
    """

    _bath_in_steps: ClassVar[str | None] = "one of your own"

    #: Names of what the steps add up.
    tallies: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self,
        temperature: float | unit.Quantity,
        stepSize: float | unit.Quantity,
        scheme: str | Scheme,
        rotor: str | Rotor,
        bodies: Sequence[Sequence[int]] | None,
        fast: str | Sequence[int] | None,
        inner: str | Scheme | None,
        innerSteps: int | None,
        engine: Engine,
    ) -> None:
        super().__init__(stepSize, words.splitting(scheme), rotor, bodies, fast, inner, innerSteps, engine)
        self.setTemperature(temperature)
        self._around: tuple[State, State] | None = None  # before and after the last bath letter
        self._left: State | None = None  # what the last call of `step` ended with
        self._drew, self._streams = False, 0  # whether there was noise, and the last of its streams

    def getTemperature(self) -> unit.Quantity:
        """Return the temperature of the bath."""
        return self._temperature * unit.kelvin

    def setTemperature(self, temperature: float | unit.Quantity) -> None:
        """Set the temperature of the bath, in K if it has no unit; a barostat has one of its own.

        Raises
        ------
        ValueError
            If it is negative, not finite or has a unit that does not fit.
        """
        self._temperature = kelvin(temperature)

    def setRandomNumberSeed(self, seed: int) -> None:
        """Set the seed of the noise; with 0 the next step draws one, which is then kept.

        Raises
        ------
        ValueError
            If it is no whole number from 0 to 2^31 - 1.
        """
        if whole(seed, "the seed", 0) >= _SEEDS:
            raise ValueError(f"the seed must be below 2^31, not {seed}")
        super().setRandomNumberSeed(int(seed))
        account.write(self, account.SEED, int(seed))
        account.write(self, account.STREAM, 0)
        self._streams = 0

    def getSeedInUse(self) -> int:
        """Return the seed that the noise has: the one that was asked for, else that of a checkpoint or the drawn one.

        0 before it is drawn. ``getRandomNumberSeed`` returns what was asked for.
        """
        return int(self.getRandomNumberSeed()) or int(account.read(self, account.SEED))

    def getBathSettings(self) -> Mapping[str, Any]:
        """Return the settings that decide on the bits of a run, beside those of `ExactRigidBodyIntegrator`."""
        return {"temperature": self._temperature, "seed": self.getRandomNumberSeed() or "random"}

    def step(self, steps: int) -> None:
        """Advance the bodies by this many steps; see `ExactRigidBodyIntegrator.step`."""
        self._around = self._left = None  # so that no steps, or one that fails, leave none
        super().step(steps)
        self._left = None if self._engine.on_device else self._present().session.state

    def temperaturesAroundBath(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and rotational temperatures, each the mean of before and after the last bath letter.

        With "BAOAB" and "ABOBA" the bath stands in the middle of a step, where momenta are nearer to canonical than at
        its end: there `temperatures`, like the velocities of the Context, is biased.

        Raises
        ------
        ValueError
            If the state of the bodies is not the one that a step made here has left.
        """
        host = self._up_to_date()
        if self.getEngine() == "device":
            raise ValueError("on the device nobody looks at momenta within a step: take engine='host' for that")
        if self._around is None or self._left is not host.session.state:
            raise ValueError("there is no bath to take temperatures around: make a step first")
        energies = [host.session.bodies.kinetic_energies(state.rounded) for state in self._around]
        pairs = zip(map(sum, zip(*energies, strict=True)), self.degreesOfFreedom(), strict=True)
        R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
        translational, rotational = (energy / ((freedom or math.nan) * R) * unit.kelvin for energy, freedom in pairs)
        return translational, rotational

    @abstractmethod
    def _exchange(self, parts: Parts) -> Bath:
        """Return what the bath does with momenta."""

    def _steps(self) -> Scheme:
        """Return the scheme with all letters of a step."""
        return words.with_bath(self._scheme)

    def _own_makers(self) -> Mapping[str, Maker]:
        """Return what makes the letters of the bath."""
        return {BATH: self._bath}

    def _arguments(self) -> dict[str, Any]:
        return super()._arguments() | {"temperature": self._temperature}

    def _plan(self, context: openmm.Context) -> Plan:
        refuse_other_baths(context, self._temperature)
        account.write(self, account.SEED, self.getSeedInUse() or 1 + secrets.randbelow(_SEEDS - 1))
        self._drew = True
        makers = {**self._makers, **self._own_makers()}
        kT, tallies = gas_constant_times(self._temperature), account.Account(self, self.tallies)
        return Plan(self._steps(), makers, kT, tallies, self._numbers(), self._key(), self.getScheme())

    def _key(self) -> int:
        """Return what the noise is looked up by beside the step: the seed, and which of its streams."""
        return self.getSeedInUse() + _SEEDS * int(account.read(self, account.STREAM))

    def _part_streams(self) -> None:
        """Have noise that nothing had before, where a State or a step count takes a run elsewhere that had some.

        A checkpoint is what a run goes on from: it has the number of its stream, and brings the noise back.
        """
        if self._drew:
            self._streams = 1 + max(self._streams, int(account.read(self, account.STREAM)))
            account.write(self, account.STREAM, self._streams % _STREAMS)

    def _present(self) -> Host:
        present, reference = super()._present(), weakref.WeakMethod(self._part_streams)

        def part_streams() -> None:
            if (part := reference()) is not None:
                part()

        present.session.taken_elsewhere = part_streams
        return present

    def _numbers(self) -> Mapping[str, float]:
        """Return what a program on a device is told of the bath."""
        return {}

    def _bath(self, parts: Parts, letters: set[str]) -> dict[str, Flow[State]]:
        exchange = self._exchange(parts)
        return {letter: parts.guard.outside(self._bath_flow(parts, exchange, int(letter[1:]))) for letter in letters}

    def _bath_flow(self, parts: Parts, exchange: Bath, place: int) -> Flow[State]:
        key = self._key()

        def flow(state: State, tau: float) -> State:
            along = parts.kinetic.tangent(state)
            P, m = exchange(along.P, along.m, tau, Instant(key, parts.clock.number, place))
            same = P is along.P and m is along.m
            after = state if same else parts.kinetic.tangent(state._replace(P=P, m=m))
            self._around = state, after
            return after

        return flow
