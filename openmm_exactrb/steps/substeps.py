"""Substeps: the parts of a step, with their flows and properties.

A scheme is a sequence of substeps, each with its fraction of the step. A substep defines its flow, its force
evaluations, whether it commutes with other substeps, its matrix for a harmonic oscillator, and its moves in kernels.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from openmm_exactrb.mathematics.compensated import add, exactly
from openmm_exactrb.mathematics.quaternions import exponential, matrix, multiply
from openmm_exactrb.mechanics.free_motion import Kinetic
from openmm_exactrb.mechanics.state import Flow, Force, State
from openmm_exactrb.steps.environment import Environment, Forces
from openmm_exactrb.steps.moves import Move, Op
from openmm_exactrb.support.descriptions import Described, own_methods
from openmm_exactrb.support.types import Array

#: Matrix of a linear map of (q, p): ((dq/dq, dq/dp), (dp/dq, dp/dp)).
Matrix = tuple[tuple[Any, Any], tuple[Any, Any]]


@dataclass(frozen=True)
class Substep(Described):
    """A part of a step.

    To define a custom substep, derive a frozen dataclass from this class, and use instances of it in the sequence of a
    `Scheme`. The class need not be registered. Substeps are compared by value. A class that overrides `bind` inherits
    neither `kernel_moves` nor `oscillator`, because these describe the flow of its base class. For the same reason, a
    class that overrides `kernel_moves` does not inherit `bind`.

    Attributes
    ----------
    symbol : str
        Symbol for display.
    moves : bool
        Whether the substep may change positions, the box or parameters, so that forces must be evaluated again.
    kicks : bool
        Whether the substep changes momenta by forces at the present positions. Such substeps commute.
    additive : bool
        Whether two successive substeps equal one substep over the sum of their times, which is the case for every exact
        flow.
    displaced_forces : int
        Number of force evaluations at displaced positions.
    """

    symbol: ClassVar[str] = "?"
    moves: ClassVar[bool] = True
    kicks: ClassVar[bool] = False
    additive: ClassVar[bool] = False
    displaced_forces: ClassVar[int] = 0

    def __init_subclass__(cls) -> None:
        """Keep the comparison of this class, which `dataclass` would replace."""
        super().__init_subclass__()
        cls.__eq__ = Substep.__eq__  # type: ignore[method-assign]

    def __eq__(self, other: object) -> bool:
        """Return whether the other substep has the same class, the same values and the same methods of its own."""
        if type(other) is not type(self):
            return NotImplemented
        names = [field.name for field in fields(self) if field.compare]
        mine, theirs = ([getattr(some, name) for name in names] for some in (self, other))
        return mine == theirs and own_methods(self) == own_methods(other)

    def bind(self, environment: Environment) -> Flow[State]:
        """Return ``flow(state, tau) -> state``, the motion of an `openmm_exactrb.mechanics.state.State` over tau (ps).

        Parameters
        ----------
        environment : openmm_exactrb.steps.environment.Environment
        """
        raise NotImplementedError(f"{type(self).__name__} must define bind(), which returns its flow")

    def oscillator(self, tau: Any) -> Matrix:
        """Return the matrix of the substep for the oscillator q'' = -q, whose angular frequency is 1."""
        raise ValueError(
            f"the substep {self!r} has no matrix for a harmonic oscillator: define its method oscillator()"
        )

    def kernel_moves(self, part: float) -> tuple[Move, ...] | None:
        """Return the moves over a fraction of the step, or None if no kernel performs the substep."""
        return None

    def __str__(self) -> str:
        """Return the symbol."""
        return self.symbol


@dataclass(frozen=True)
class Drift(Substep):
    """The flow of the kinetic energy: free translation and rotation.

    Parameters
    ----------
    bodies : {"all", "inner", "others"}, optional
        The bodies that move: all bodies, those with inner steps, or those without.
    """

    bodies: str = "all"

    symbol: ClassVar[str] = "A"
    additive: ClassVar[bool] = True

    def bind(self, environment: Environment) -> Flow[State]:
        """Return the flow of the free motion of these bodies, including fast forces."""
        kinetic = environment.kinetic
        return kinetic.drift if self.bodies == "all" else kinetic.split[self.bodies]

    def oscillator(self, tau: Any) -> Matrix:
        """Return the matrix of the flow of q' = p."""
        return (1.0, tau), (0.0, 1.0)

    def kernel_moves(self, part: float) -> tuple[Move, ...]:
        """Return the move of the drift."""
        return (Move(Op.DRIFT, part, bodies=self.bodies),)


@dataclass(frozen=True)
class Kick(Substep):
    """The flow of the potential energy: forces change momenta at fixed positions.

    The next drift projects the momenta of constrained clusters onto the constraints.

    Parameters
    ----------
    group : int, optional
        The force group; by default, all forces that are not integrated within the drifts.
    """

    group: int | None = None

    symbol: ClassVar[str] = "B"
    moves: ClassVar[bool] = False
    kicks: ClassVar[bool] = True
    additive: ClassVar[bool] = True

    def bind(self, environment: Environment) -> Flow[State]:
        """Return the flow that adds tau F to P, and tau N to m."""
        return kick(environment.forces(self.group), environment.divergence.finite_momenta)

    def oscillator(self, tau: Any) -> Matrix:
        """Return the matrix of the flow of p' = -q."""
        return (1.0, 0.0), (-tau, 1.0)

    def kernel_moves(self, part: float) -> tuple[Move, ...]:
        """Return the move of the kick, with the bits of its force groups."""
        return (Move(Op.KICK, part, groups=-1 if self.group is None else 1 << self.group),)

    def __str__(self) -> str:
        """Return the symbol B, followed by the number of the force group if there is one."""
        return self.symbol if self.group is None else f"{self.symbol}{self.group}"


@dataclass(frozen=True)
class GradientKick(Substep):
    """A kick with a force-gradient term, by forces at displaced positions.

    Over tau, the kick is the flow of V - (strength/2) tau² f . M^-1 f up to higher orders of tau, where f is the
    generalised force and M the mass matrix. For a body with centre R, orientation q, force F and torque N, forces are
    evaluated at R + d and q exp(e I^-1 N), where d = e F/M and e = strength tau². The torque of the kick is about R and
    along the axes of q: the torque about the displaced centre plus d x F, rotated from the displaced axes. The term d x
    F and this rotation change the torque only to second order in e, except for the first-order commutator of the body
    axes, e (I^-1 N) x N. The kick is time-reversible, and symplectic up to higher orders of tau. The kick conserves the
    linear momentum, and also the angular momentum if all particles belong to bodies that rotate about three axes. For
    single particles and linear bodies, which cannot absorb a torque about every axis, the angular momentum is conserved
    only up to higher orders of tau. For single particles, the kick is the Hessian-free kick of K. Schäfers, J.
    Finkenrath, M. Günther and F. Knechtli, Comput. Phys. Commun. 309, 109478 (2025). Constrained atoms are displaced
    along the geodesic of F, and the force at the displaced positions is projected onto the constraints. To first order
    in e, the projected force gives the covariant derivative of F along itself.

    Parameters
    ----------
    strength : float
        Dimensionless strength of the force-gradient term.
    """

    strength: float

    symbol: ClassVar[str] = "C"
    moves: ClassVar[bool] = False
    kicks: ClassVar[bool] = True
    displaced_forces: ClassVar[int] = 1

    def bind(self, environment: Environment) -> Flow[State]:
        """Return the flow of the kick by the forces at displaced positions."""
        kinetic, inertia = environment.kinetic, environment.inertia
        return gradient_kick(environment.forces(), kinetic, inertia, self.strength, environment.divergence.finite)

    def oscillator(self, tau: Any) -> Matrix:
        """Return the matrix of the kick by the exact gradient, for which f . M^-1 f is q²."""
        return (1.0, 0.0), (-tau * (1.0 - self.strength * tau * tau), 1.0)

    def kernel_moves(self, part: float) -> tuple[Move, ...]:
        """Return the moves: the displacement, and the kick by the forces at the displaced positions."""
        e = self.strength * part * part
        return Move(Op.DISPLACE, e, groups=-1), Move(Op.DISPLACED_KICK, part, groups=-1, weights=(e,))


@dataclass(frozen=True)
class LastForcesKick(Substep):
    """A kick by a weighted sum of the stored forces of the last kicks, for output only and without a force evaluation.

    Parameters
    ----------
    weights : tuple of float
        Weights of the last forces, with the most recent one first.
    differences : tuple of float, optional
        Weights of the last force-gradient terms, which are displaced forces minus undisplaced forces.
    """

    weights: tuple[float, ...]
    differences: tuple[float, ...] = ()

    symbol: ClassVar[str] = "L"
    moves: ClassVar[bool] = False

    def bind(self, environment: Environment) -> Flow[State]:
        """Return the flow that adds tau sum_k w_k F_k to P, and tau sum_k w_k N_k to m."""
        own = environment.forces()

        def flow(state: State, tau: float) -> State:
            memory = own.memory
            terms = [*zip(self.weights, memory.forces, strict=False)]
            terms += zip(self.differences, memory.differences, strict=False)
            force, torque = (np.asarray(sum(w * value[i] for w, value in terms)) for i in (0, 1))
            return state._replace(P=add(state.P, tau * force), m=add(state.m, tau * torque))

        return flow

    def kernel_moves(self, part: float) -> tuple[Move, ...]:
        """Return the move of the kick, whose `number` is the number of weights of forces."""
        return (Move(Op.LAST_KICK, part, len(self.weights), weights=(*self.weights, *self.differences)),)


@dataclass(frozen=True)
class HeatExchange(Substep):
    """The substep of a thermostat.

    Parameters
    ----------
    number : int, optional
        Index of the exchange within the step. Each heat exchange has its own random numbers.
    """

    number: int = 0

    symbol: ClassVar[str] = "O"
    moves: ClassVar[bool] = False
    additive: ClassVar[bool] = True

    def bind(self, environment: Environment) -> Flow[State]:
        """Return the flow of the integrator's thermostat."""
        return environment.exchange_of(self.number)

    def oscillator(self, tau: Any) -> Matrix:
        """Return the identity, because the thermostat is ignored."""
        return (1.0, 0.0), (0.0, 1.0)

    def kernel_moves(self, part: float) -> tuple[Move, ...]:
        """Return the move of the heat exchange, whose number selects its random numbers."""
        return (Move(Op.EXCHANGE, part, self.number),)


#: Pairs of a substep and its fraction of the step, in order of execution.
Sequence = tuple[tuple[Substep, float], ...]
DRIFT, KICK, HEAT_EXCHANGE = Drift(), Kick(), HeatExchange()


def of_symbol(symbol: str) -> Substep:
    """Return the substep of a symbol: drift "A", kick "B", kick by force group 3 "B3", or heat exchange "O"."""
    found = {str(substep): substep for substep in (DRIFT, KICK, HEAT_EXCHANGE)}.get(symbol)
    group = re.fullmatch(r"B(\d+)", symbol)
    if group and int(group[1]) < 32:
        found = Kick(int(group[1]))
    if found is None:
        raise ValueError(
            f"the substep {symbol!r} is unknown: choose A, B, B0 to B31 or O, or use a Substep in the sequence"
        )
    return found


# -- the flows of kicks -----------------------------------------------------------------------------------------------


def _unchecked(state: State) -> None:
    pass


def kick(forces: Callable[[State], Force], check: Callable[[State], Any] = _unchecked) -> Flow[State]:
    """Return the flow of the potential energy of `forces`; `check` raises an error if momenta are not finite."""

    def flow(state: State, tau: float) -> State:
        force, torque = forces(state)
        after = State(state.R, add(state.P, tau * force), state.q, add(state.m, tau * torque))
        check(after)
        return after

    return flow


def gradient_kick(
    forces: Forces, kinetic: Kinetic, inertia: Array, strength: float, check: Callable[[State], Any] = _unchecked
) -> Flow[State]:
    """Return the flow of `GradientKick`; all arguments except `strength` are taken from the environment."""

    def flow(state: State, tau: float) -> State:
        e = strength * tau * tau
        force, torque = forces(state)
        turn = exponential(e * torque / inertia)
        q = multiply(state.q[0], turn)
        displaced = kinetic.displaced(state, e * force)._replace(q=exactly(q))
        check(displaced)
        force_there, torque_there = forces.at(displaced)
        force_there = kinetic.tangent(displaced._replace(P=exactly(force_there))).P[0]
        turning = slice(torque.shape[1])
        arm = (displaced.R[0] - state.R[0])[:, turning]
        about = np.einsum("jin,jn->in", matrix(state.q[0]), np.cross(arm, force_there[:, turning], axis=0))
        torque_there = np.einsum("ijn,jn->in", matrix(turn), torque_there) + about
        torque_there = np.where(np.isfinite(inertia), torque_there, 0.0)
        forces.memory.add_difference((force_there - force, torque_there - torque))
        after = state._replace(P=add(state.P, tau * force_there), m=add(state.m, tau * torque_there))
        check(after)
        return after

    return flow
