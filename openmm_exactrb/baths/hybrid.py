"""Generalised hybrid Monte Carlo of rigid bodies: the canonical distribution at any step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import openmm
from openmm import unit

from openmm_exactrb import kernels
from openmm_exactrb.baths import words
from openmm_exactrb.baths.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.checks import positive, whole
from openmm_exactrb.context import account
from openmm_exactrb.context.host import Plan
from openmm_exactrb.context.letters import Maker, Parts, flows
from openmm_exactrb.context.units import gas_constant_times, kelvin
from openmm_exactrb.device.choice import Engine
from openmm_exactrb.motion.draws import Draws, Instant, Purpose
from openmm_exactrb.motion.engine import Flow, run
from openmm_exactrb.motion.guard import NonFiniteError
from openmm_exactrb.motion.metropolis import Tally, decided
from openmm_exactrb.motion.state import State
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme


class ExactRigidBodyHybridIntegrator(ExactRigidBodyLangevinIntegrator):
    """Exact sampling: the splitting proposes, Metropolis decides, momenta turn round where the answer is no.

    Generalised hybrid Monte Carlo (doi:10.1016/0370-2693(91)90812-5): a step is a proposal between two halves of the
    bath of `ExactRigidBodyLangevinIntegrator`. The canonical distribution comes out at any step, where the potential
    energy of the platform is exact. Where proposals are refused momenta change their sign, so that it is no dynamics.

    Parameters
    ----------
    temperature : float or Quantity
        In K if it has no unit; above zero.
    frictionCoeff : float or Quantity
        What the bath renews of the momenta between proposals, as friction in 1/ps if it has no unit.
    stepSize : float or Quantity
        Time of a proposal, in ps if it has no unit.
    scheme, rotor, rotationalFriction, bodies, fast, inner, innerSteps
        As in `ExactRigidBodyLangevinIntegrator`; the scheme must be symmetric and without a bath within it. The inner
        steps are those for the time of one step of the scheme.
    stepsPerProposal : int, optional
        Steps of the scheme that a proposal is made of, of the size stepSize/stepsPerProposal.

    Raises
    ------
    ValueError
        As `ExactRigidBodyLangevinIntegrator`, and if the temperature is zero, the scheme or the inner one is not
        symmetric or ``stepsPerProposal`` no whole number above zero.
    """

    _bath_in_steps: ClassVar[str | None] = "hybrid Monte Carlo"
    tallies: ClassVar[tuple[str, ...]] = (account.ACCEPTED, account.PROPOSED)

    def __init__(
        self,
        temperature: float | unit.Quantity,
        frictionCoeff: float | unit.Quantity,
        stepSize: float | unit.Quantity,
        scheme: str | Scheme = "S2_2",
        rotor: str | Rotor = "exact",
        rotationalFriction: float | unit.Quantity | None = None,
        stepsPerProposal: int = 1,
        bodies: Sequence[Sequence[int]] | None = None,
        fast: str | Sequence[int] | None = "auto",
        inner: str | Scheme | None = None,
        innerSteps: int | None = None,
        engine: Engine = "auto",
    ) -> None:
        bath = (temperature, frictionCoeff, stepSize, scheme, rotor, rotationalFriction)
        super().__init__(*bath, bodies, fast, inner, innerSteps, engine)
        self._steps_a_proposal = whole(stepsPerProposal, "stepsPerProposal")
        self._proposal = words.proposal(self._scheme, self._steps_a_proposal)
        words.refuse_lopsided_inner(None if self._nesting is None else self._nesting.scheme)

    def setTemperature(self, temperature: float | unit.Quantity) -> None:
        """Set the temperature, in K if it has no unit; it must be above zero."""
        positive(kelvin(temperature), "the temperature of Metropolis's rule", "K")
        super().setTemperature(temperature)

    def getStepsPerProposal(self) -> int:
        """Return how many steps of the scheme a proposal is made of."""
        return self._steps_a_proposal

    @property
    def forceEvaluationsPerStep(self) -> int:
        """Force evaluations that a proposal costs; one more after a refusal, and with schemes that begin with a drift.

        The potential energy comes with the forces.
        """
        return self._proposal.forces

    def tally(self) -> Tally:
        """Return how many proposals were taken, and how many there were, since `resetTally` or the beginning."""
        return Tally(int(account.read(self, account.ACCEPTED)), int(account.read(self, account.PROPOSED)))

    def acceptanceRate(self) -> float:
        """Return the part of the proposals that was taken; nan before the first."""
        return self.tally().rate

    def resetTally(self) -> None:
        """Count from zero again."""
        for name in self.tallies:
            account.write(self, name, 0.0)

    def getBathSettings(self) -> Mapping[str, Any]:
        """Return the settings that decide on the bits of a run, beside those of `ExactRigidBodyIntegrator`."""
        return {**super().getBathSettings(), "steps a proposal": self._steps_a_proposal}

    def _plan(self, context: openmm.Context) -> Plan:
        return replace(super()._plan(context), splitting=self._proposal, splits=self._steps_a_proposal)

    def _arguments(self) -> dict[str, Any]:
        return {**super()._arguments(), "stepsPerProposal": self._steps_a_proposal}

    def _steps(self) -> Scheme:
        return words.with_proposals(self._scheme)

    def _own_makers(self) -> Mapping[str, Maker]:
        return {**super()._own_makers(), words.PROPOSAL: self._proposals}

    def _proposals(self, parts: Parts, letters: set[str]) -> dict[str, Flow[State]]:
        """Make the flow that proposes and decides."""
        proposal = self._proposal
        parts = replace(parts, scheme=proposal, slow=parts.slow.with_energies())
        word, moves = proposal.word, flows(proposal.word, parts, self._makers)
        kT, key, draws = gas_constant_times(self._temperature), self._key(), Draws(kernels.twins().noise)

        def energy(state: State) -> float:
            return sum(parts.bodies.kinetic_energies(state.rounded)) + parts.slow.potential(state)

        def proposed(state: State, tau: float) -> tuple[State, float]:
            """Return a proposal and its rise of the energy: infinite if it blows up."""
            before = energy(state)
            try:
                new = run(word, moves, state, tau)
            except NonFiniteError:
                return state, math.inf
            return new, energy(new) - before

        def flow(state: State, tau: float) -> State:
            new, rise = proposed(state, tau)
            u = draws.uniform(Instant(key, parts.clock.number, 0), Purpose.METROPOLIS)
            chosen, tally = decided(state, new, rise, kT, u, Tally(), flipped)
            parts.account.add(account.ACCEPTED, tally.accepted)
            parts.account.add(account.PROPOSED, tally.proposed)
            return chosen

        return {words.PROPOSAL: flow}


def flipped(state: State) -> State:
    """Return a state with all momenta of the opposite sign."""
    return state._replace(P=-state.P, m=-state.m)
