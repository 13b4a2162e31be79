"""Generalised hybrid Monte Carlo of rigid bodies: the canonical distribution at any step.

A splitting proposes, Metropolis decides, and momenta turn round where the answer is no: A. M. Horowitz (1991),
doi:10.1016/0370-2693(91)90812-5. With a thermostat that keeps the canonical distribution between the proposals the
distribution is right at any step. The splitting must be symmetric in time and keep the volume of phase space.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Unpack

from openmm import unit

from openmm_exactrb.checks import positive, whole
from openmm_exactrb.context import variables
from openmm_exactrb.context.units import gas_constant_times
from openmm_exactrb.mechanics.divergence import IntegrationError
from openmm_exactrb.mechanics.rng import Instant, Purpose
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes import Scheme, thermostatted
from openmm_exactrb.substeps import Substep
from openmm_exactrb.thermostats.face import Options
from openmm_exactrb.thermostats.langevin import ExactRigidBodyLangevinIntegrator, Langevin


class Tally(NamedTuple):
    """How many proposals there were, and how many were taken."""

    accepted: int = 0
    proposed: int = 0

    @property
    def rate(self) -> float:
        """The part that was taken; nan before the first."""
        return self.accepted / self.proposed if self.proposed else math.nan


def accepts(rise: float, kT: float, u: float) -> bool:
    """Return whether Metropolis's rule takes a proposal that raises the total energy so much; u is uniform on (0, 1).

    A rise that is not a number is rejected.
    """
    return bool(rise <= 0.0 or u < math.exp(-rise / kT))


@dataclass(frozen=True)
class Metropolis(Substep):
    """A proposal and Metropolis's decision.

    Parameters
    ----------
    proposal : Scheme
        Symmetric in time.
    temperature : float
        In K.
    """

    proposal: Scheme
    temperature: float

    symbol: ClassVar[str] = "X"

    def bind(self, environment: Any) -> Flow[State]:
        """Return the flow that proposes and decides."""
        kT, numbers = gas_constant_times(self.temperature), environment.numbers
        bodies, forces, clock = environment.bodies, environment.slow, environment.clock
        forces.with_energies()
        propose = environment.flow_of(self.proposal.sequence)

        def energy(state: State) -> float:
            return float(sum(bodies.kinetic_energies(state.rounded)) + forces.energy(state))

        def proposed(state: State, tau: float) -> tuple[State, float]:
            """Return a proposal and its rise of the energy: infinite if it diverges."""
            before = energy(state)
            try:
                new = propose(state, tau)
            except IntegrationError:
                return state, math.inf
            return new, energy(new) - before

        def flow(state: State, tau: float) -> State:
            new, rise = proposed(state, tau)
            u = Instant(environment.key, clock.number, 0).uniform(Purpose.METROPOLIS)
            accepted = accepts(rise, kT, u)
            numbers.present[variables.ACCEPTED] += accepted
            numbers.present[variables.PROPOSED] += 1
            if accepted:
                return new
            environment.positions.version += 1
            return state._replace(P=-state.P, m=-state.m)

        return flow


@dataclass(frozen=True)
class HybridMonteCarlo(Langevin):
    """Langevin's friction and noise between proposals that Metropolis's rule decides on.

    Parameters
    ----------
    temperature, friction, rotationalFriction
        As in `Langevin`; the temperature is above zero.
    stepsPerProposal : int, optional
        Steps of the scheme that a proposal is made of.
    """

    stepsPerProposal: int = 1

    numbers = (variables.ACCEPTED, variables.PROPOSED)
    on_device: ClassVar[bool] = False
    scheme: ClassVar[str] = "S2_2"

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self.temperature, "the temperature of Metropolis's rule", "K")
        whole(self.stepsPerProposal, "stepsPerProposal")

    def steps(self, scheme: Scheme) -> Scheme:
        """Return a proposal between two halves of Langevin's flow."""
        proposal = thermostatted.proposal(scheme, self.stepsPerProposal)
        return thermostatted.with_proposals(scheme, Metropolis(proposal, self.temperature))

    def splitting(self, scheme: Scheme) -> tuple[Scheme, int]:
        """Return the proposal."""
        return thermostatted.proposal(scheme, self.stepsPerProposal), self.stepsPerProposal


class ExactRigidBodyHybridIntegrator(ExactRigidBodyLangevinIntegrator):
    """Exact sampling: the splitting proposes, Metropolis decides, momenta turn round where the answer is no.

    Generalised hybrid Monte Carlo (doi:10.1016/0370-2693(91)90812-5): a step is a proposal between two halves of the
    flow of `ExactRigidBodyLangevinIntegrator`'s thermostat. The distribution is canonical at any step, where the
    potential energy of the platform is exact. Momenta change their sign at refusals, so that it is no dynamics.

    Parameters
    ----------
    temperature, frictionCoeff
        As in `ExactRigidBodyLangevinIntegrator`; the temperature is above zero.
    stepSize : float or Quantity, optional
        Time of a proposal, in ps if it has no unit. Give it or ``forceInterval``.
    scheme, rotor, rotationalFriction, bodies, fast, inner, innerSteps, forceInterval, checkDivergence
        As in `ExactRigidBodyLangevinIntegrator`; the scheme must be symmetric and without a thermostat within it, such
        as the default, "S2_2". The inner steps are those for the time of one step of the scheme.
    stepsPerProposal : int, optional
        Steps of the scheme that a proposal is made of, of the size stepSize/stepsPerProposal.

    Raises
    ------
    ValueError
        As `ExactRigidBodyLangevinIntegrator`, and if the temperature is zero, the scheme or the inner one is not
        symmetric or ``stepsPerProposal`` no whole number above zero.
    """

    _thermostat: HybridMonteCarlo

    def __init__(
        self,
        temperature: float | unit.Quantity,
        frictionCoeff: float | unit.Quantity,
        stepSize: float | unit.Quantity | None = None,
        scheme: str | Scheme | None = None,
        rotor: str | Rotor = "exact",
        rotationalFriction: float | unit.Quantity | None = None,
        stepsPerProposal: int = 1,
        **options: Unpack[Options],
    ) -> None:
        thermostat = HybridMonteCarlo(temperature, frictionCoeff, rotationalFriction, stepsPerProposal)
        super(ExactRigidBodyLangevinIntegrator, self).__init__(thermostat, stepSize, scheme, rotor, **options)
        thermostatted.refuse_lopsided(None if self._fast is None else self._fast.scheme, "inner scheme")

    @property
    def forceEvaluationsPerStep(self) -> int:
        """Force evaluations that a proposal costs; one more after a refusal, and with schemes that begin with a drift.

        The potential energy comes with the forces.
        """
        return self._thermostat.splitting(self._scheme)[0].forces

    def tally(self) -> Tally:
        """Return how many proposals were taken, and how many there were, since `resetTally` or the beginning."""
        return Tally(*(int(variables.get(self, name)) for name in (variables.ACCEPTED, variables.PROPOSED)))

    def acceptanceRate(self) -> float:
        """Return the part of the proposals that was taken; nan before the first."""
        return self.tally().rate

    def resetTally(self) -> None:
        """Count from zero again."""
        for name in (variables.ACCEPTED, variables.PROPOSED):
            variables.put(self, name, 0.0)
