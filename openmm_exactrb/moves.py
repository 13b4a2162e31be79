"""Moves: the actions of a substep on bodies, which an engine performs in segments between force evaluations."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

#: exchange(tau) -> numbers that kernels need of a heat exchange over tau (ps).
Exchange = Callable[[float], tuple[float, ...]]


#: A move in the text of a user, and its name.
MOVE = re.compile(r"\bDEVICE\s+(?:inline\s+)?void\s+(\w+)\s*\(\s*Body\s*\*\s*\w+\s*,\s*double\s+\w+\s*\)")


class Op(IntEnum):
    """The kinds of moves, with the numbers that kernels/moves.cl uses."""

    DRIFT = 0  # free motion
    KICK = 1  # momenta by the forces here
    EXCHANGE = 2  # heat exchange: numbers are those of the thermostat
    LAST_KICK = 3  # momenta by a weighted sum of remembered forces
    REMEMBER = 4  # the forces here, as those of the most recent place
    DISPLACE = 5  # the particles by the forces here, the body stays; numbers are e
    DISPLACED_KICK = 6  # momenta by the forces at displaced particles; numbers are tau and e
    FAST_KICK = 7  # momenta of bodies with inner steps by the fast forces here
    OWN = 16  # the first of those of users


@dataclass(frozen=True)
class Move:
    """A move of all bodies.

    Attributes
    ----------
    op : Op or int
    part : float
        Fraction of the step; for the number e of a displacement, fraction of its square.
    number : int
        For a heat exchange, its index in the step. For a move that stores forces, its index among those of the step.
        For a kick by stored forces, the number of weights of forces; the other weights are those of differences.
    groups : int
        Bits of the force groups that the move needs: -1 for all, 0 for none.
    weights : tuple of float
        Further numbers.
    bodies : str
        "all", "inner" or "others", as for `openmm_exactrb.substeps.Drift`.
    text : str
        Source of a user's move: a function ``DEVICE inline void NAME(Body* body, double tau)`` in OpenMM's kernel
        dialect; if the text defines several, the last one.
    late : bool
        Whether the move belongs to the next step, if a segment ends a step.
    """

    op: int
    part: float = 0.0
    number: int = 0
    groups: int = 0
    weights: tuple[float, ...] = ()
    bodies: str = "all"
    text: str = ""
    late: bool = False

    @property
    def displaces(self) -> bool:
        """Whether the move changes positions."""
        return self.op in (Op.DRIFT, Op.DISPLACE) or self.op >= Op.OWN

    def numbers(self, h: float, exchange: Exchange | None) -> tuple[float, ...]:
        """Return the factors that a kernel uses for steps of h (ps)."""
        tau = self.part * h
        if self.op == Op.EXCHANGE:
            assert exchange is not None
            return tau, *exchange(tau)
        if self.op == Op.LAST_KICK:
            return tuple(weight * tau for weight in self.weights)
        if self.op == Op.DISPLACE:
            return (self.part * h * h,)
        if self.op == Op.DISPLACED_KICK:
            return tau, self.weights[0] * h * h
        return (tau,)


def of_substep(substep: Any, part: float) -> tuple[Move, ...]:
    """Return the moves of a substep over a fraction of the step; raise ValueError if a device does not support it."""
    moves: tuple[Move, ...] | None = substep.device_moves(part)
    if moves is None:
        raise ValueError(f"the substep {substep!r} has no code for a device: define its method device_moves()")
    if any(move.op == Op.OWN and not MOVE.search(move.text) for move in moves):
        raise ValueError(f"the code of {substep!r} must define `DEVICE inline void NAME(Body* body, double tau)`")
    return moves
