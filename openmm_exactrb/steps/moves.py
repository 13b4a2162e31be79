"""Moves: the actions of a substep on bodies, which an engine performs in segments between force evaluations."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from openmm_exactrb.steps import constants
from openmm_exactrb.support.descriptions import mismatch

#: exchange(tau) -> the numbers that kernels need for a heat exchange over tau (ps).
ExchangeNumbers = Callable[[float], tuple[float, ...]]


#: Pattern of a move's function in a user's source text; the group is the name of the function.
MOVE = re.compile(r"\bDEVICE\s+(?:inline\s+)?void\s+(\w+)\s*\(\s*Body\s*\*\s*\w+\s*,\s*double\s+\w+\s*\)")


class Op(IntEnum):
    """The kinds of moves; see `openmm_exactrb.steps.constants`."""

    DRIFT = constants.DRIFT
    KICK = constants.KICK
    EXCHANGE = constants.EXCHANGE
    LAST_KICK = constants.LAST_KICK
    REMEMBER = constants.REMEMBER
    DISPLACE = constants.DISPLACE
    DISPLACED_KICK = constants.DISPLACED_KICK
    FAST_KICK = constants.FAST_KICK
    OWN = 16  # number of the first user-defined move


@dataclass(frozen=True)
class Move:
    """A move of the bodies.

    Attributes
    ----------
    op : Op or int
    part : float
        The fraction of the step. For a displacement, the factor of the squared step in e of `GradientKick`.
    number : int
        For a heat exchange, its index in the step. For a move that stores forces, its index among such moves in the
        step. For a kick by stored forces, the number of weights of forces; the remaining weights are for force
        differences.
    groups : int
        Bit mask of the force groups that the move needs: -1 for all, 0 for none.
    weights : tuple of float
        Weights of stored forces. For a kick by displaced forces, the factor of the squared step in e of `GradientKick`.
    bodies : str
        "all", "inner" or "others", as for `openmm_exactrb.steps.substeps.Drift`.
    text : str
        Source of a user's move: a function ``DEVICE inline void NAME(Body* body, double tau)`` in OpenMM's kernel
        dialect. If the text defines several such functions, the last one is the move.
    late : bool
        Whether the move belongs to the next step, in a segment that joins two steps.
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

    def numbers(self, h: float, exchange: ExchangeNumbers | None) -> tuple[float, ...]:
        """Return the numbers that a kernel uses for the move if the step size is h (ps)."""
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
    """Return the moves of a substep over a fraction of the step; raise ValueError if no kernel performs it."""
    moves: tuple[Move, ...] | None = substep.kernel_moves(part)
    if moves is None:
        raise ValueError(f"the substep {substep!r} has no kernel: define its method kernel_moves()")
    if why := mismatch(substep, "kernel_moves", "bind"):
        raise ValueError(why)
    if any(move.op == Op.OWN and not MOVE.search(move.text) for move in moves):
        raise ValueError(
            f"the kernel text of {substep!r} must define `DEVICE inline void NAME(Body* body, double tau)`: correct "
            "the text in its method kernel_moves()"
        )
    return moves
