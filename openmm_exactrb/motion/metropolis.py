"""Exact sampling: a splitting proposes, Metropolis decides, and momenta turn round where the answer is no.

Generalised hybrid Monte Carlo: A. M. Horowitz (1991), doi:10.1016/0370-2693(91)90812-5. With a bath that keeps the
canonical distribution between the proposals the distribution is right at any step. The splitting must be symmetric
in time and keep the volume of phase space.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar

State = TypeVar("State")


class Tally(NamedTuple):
    """How many proposals there were, and how many were taken."""

    accepted: int = 0
    proposed: int = 0

    @property
    def rate(self) -> float:
        """The part that was taken; nan before the first."""
        return self.accepted / self.proposed if self.proposed else math.nan

    def with_one(self, accepted: bool) -> Tally:
        """Return the tally with one more proposal."""
        return Tally(self.accepted + accepted, self.proposed + 1)


def accepts(rise: float, kT: float, u: float) -> bool:
    """Tell whether Metropolis takes a proposal.

    Parameters
    ----------
    rise : float
        Total energy of the proposal less that of the state before. One that is not a number is refused.
    kT : float
        Above zero.
    u : float
        A number of (0, 1).
    """
    return bool(rise <= 0.0 or u < math.exp(-rise / kT))


def decided(
    old: State, new: State, rise: float, kT: float, u: float, tally: Tally, flipped: Callable[[State], State]
) -> tuple[State, Tally]:
    """Return the proposal, or the state before with its momenta turned round, and the tally.

    Parameters
    ----------
    old, new : state
        Before and after the splitting.
    rise, kT, u : float
        See `accepts`.
    tally : Tally
    flipped : callable
        flipped(state) -> the state with all momenta, linear and angular, of the opposite sign.
    """
    taken = accepts(rise, kT, u)
    return new if taken else flipped(old), tally.with_one(taken)
