"""Generalised hybrid Monte Carlo of rigid bodies: the canonical distribution at any step size.

A splitting generates a proposal, the Metropolis test accepts or rejects the proposal, and momenta are reversed on
rejection: A. M. Horowitz (1991), doi:10.1016/0370-2693(91)90812-5. A thermostat that preserves the canonical
distribution acts between the proposals, so that the sampled distribution is correct at any step size. The splitting
must be symmetric in time and preserve the volume of phase space.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from openmm_exactrb.context import variables
from openmm_exactrb.errors import IntegrationError
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.openmm_access.units import gas_constant_times
from openmm_exactrb.random.rng import Instant, Purpose
from openmm_exactrb.schemes import Scheme, thermostatted
from openmm_exactrb.steps.environment import Environment
from openmm_exactrb.steps.substeps import Substep
from openmm_exactrb.support.checks import positive, whole
from openmm_exactrb.thermostats.langevin import Langevin


def accepts(rise: float, kT: float, u: float) -> bool:
    """Return whether the Metropolis test accepts a given rise of the total energy; u is uniform on (0, 1).

    A proposal with a rise of nan is rejected.
    """
    return bool(rise <= 0.0 or u < math.exp(-rise / kT))


@dataclass(frozen=True)
class Metropolis(Substep):
    """A proposal and its acceptance or rejection by the Metropolis test.

    Parameters
    ----------
    proposal : Scheme
        The scheme of the proposal, which must be symmetric in time.
    temperature : float
        Temperature in K.
    """

    proposal: Scheme
    temperature: float

    symbol: ClassVar[str] = "X"

    def bind(self, environment: Environment) -> Flow[State]:
        """Return the flow of a proposal with its acceptance test."""
        kT, numbers = gas_constant_times(self.temperature), environment.numbers
        bodies, forces, clock = environment.bodies, environment.forces(), environment.clock
        forces.with_energies()
        propose = environment.flow_of(self.proposal.sequence)

        def energy(state: State) -> float:
            return float(sum(bodies.kinetic_energies(state.rounded)) + forces.energy(state))

        def proposed(state: State, tau: float) -> tuple[State, float]:
            """Return a proposal and the rise of the energy, which is infinite if the proposal diverges."""
            before = energy(state)
            try:
                new = propose(state, tau)
            except IntegrationError:
                return state, math.inf
            return new, energy(new) - before

        def flow(state: State, tau: float) -> State:
            new, rise = proposed(state, tau)
            u = float(Instant(environment.key, clock.number, 0).uniforms(Purpose.METROPOLIS, 1)[0])
            accepted = accepts(rise, kT, u)
            numbers.present[variables.ACCEPTED] += accepted
            numbers.present[variables.PROPOSED] += 1
            if accepted:
                return new
            environment.moved()
            return state._replace(P=-state.P, m=-state.m)

        return flow


@dataclass(frozen=True)
class HybridMonteCarlo(Langevin):
    """Friction and noise of Langevin dynamics between proposals, which a Metropolis test accepts or rejects.

    Parameters
    ----------
    temperature, friction, rotationalFriction, flexibleFriction
        As in `Langevin`; the temperature must be positive.
    stepsPerProposal : int, optional
        Number of steps of the scheme in a proposal.
    """

    stepsPerProposal: int = 1

    numbers = (variables.HEAT_OF_FRICTION, variables.ACCEPTED, variables.PROPOSED)
    scheme: ClassVar[str] = "S2_2"

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self.temperature, "the temperature of the Metropolis test", "K")
        whole(self.stepsPerProposal, "stepsPerProposal")

    @property
    def acts(self) -> bool:
        """Return True: the Metropolis test depends on the temperature, even without friction."""
        return True

    def kernel_exchange(self, tau: float, freedom: tuple[int, int]) -> None:  # type: ignore[override]
        """Return None, because the Metropolis test needs energies on the host."""

    def steps(self, scheme: Scheme) -> Scheme:
        """Return a scheme whose step is a proposal between two halves of the heat exchange."""
        proposal = thermostatted.proposal(scheme, self.stepsPerProposal)
        return thermostatted.with_proposals(scheme, Metropolis(proposal, self.temperature))

    def require_inner(self, scheme: Scheme | None) -> None:
        """Raise ValueError if the scheme of inner steps is not symmetric in time."""
        thermostatted.require_symmetric(scheme, "inner scheme")

    def splitting(self, scheme: Scheme) -> tuple[Scheme, int]:
        """Return the scheme of the proposal, and its number of steps."""
        return thermostatted.proposal(scheme, self.stepsPerProposal), self.stepsPerProposal
