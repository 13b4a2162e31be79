"""Kicks: forces act on momenta for a time, while places stand still."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.compensated import exactly
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.kinetic import Kinetic, advancing
from openmm_exactrb.motion.state import State
from openmm_exactrb.quaternions import exponential, multiply

Array = NDArray[np.float64]

#: forces(state) -> (force (3, N), body-frame torque (3, K)), of the places of a state alone.
Forces = Callable[[State], tuple[Array, Array]]


def kick(forces: Forces) -> Flow[State]:
    """Return the flow of a potential.

    It leaves in the momenta what constraints do not allow: a drift takes that away.
    """
    advance = advancing()

    def flow(state: State, tau: float) -> State:
        force, torque = forces(state)
        return state._replace(P=advance(state.P, force, tau), m=advance(state.m, torque, tau))

    return flow


def gradient_kick(
    forces: Forces, at_displaced: Forces, kinetic: Kinetic, inertia: Array, strength: float
) -> Flow[State]:
    """Return a kick with a force-gradient term, by forces at displaced places.

    Over tau it is the flow of V - (strength/2) tau² f . M^-1 f up to higher orders of tau: the force is taken at
    R + e F/M and at q exp(e I^-1 N), where e = strength tau², and e (I^-1 N) x N is added to the torque, the commutator
    of the body axes. It is time-reversible, and symplectic up to those orders. It keeps the linear momentum, and the
    angular momentum up to those orders. For particles this is the Hessian-free
    kick of K. Schäfers, J. Finkenrath, M. Günther and F. Knechtli, Comput. Phys. Commun. 309, 109478 (2025). Atoms
    under constraints are displaced along the geodesic of F, and the force there, along the constraints, is what acts:
    to first order that is the covariant derivative of F along itself.

    Parameters
    ----------
    forces, at_displaced : callable
        The forces; the second one is asked at displaced places, so that neither forgets the other's.
    kinetic : Kinetic
    inertia : (3, 1) or (3, K) array
    strength : float
    """
    advance = advancing()

    def flow(state: State, tau: float) -> State:
        e = strength * tau * tau
        force, torque = forces(state)
        turn = e * torque / inertia
        q = multiply(state.q[0], exponential(turn))
        displaced = kinetic.displaced(state, e * force)._replace(q=exactly(q))
        force, displaced_torque = at_displaced(displaced)
        force = kinetic.tangent(displaced._replace(P=exactly(force))).P[0]
        twisted = displaced_torque + np.cross(turn, torque, axis=0)
        return state._replace(P=advance(state.P, force, tau), m=advance(state.m, twisted, tau))

    return flow


def exact_gradient_kick(forces: Forces, gradient: Forces, strength: float) -> Flow[State]:
    """Return a kick with a force-gradient term that a problem supplies.

    Over tau it is the flow of V - (strength/2) tau² f . M^-1 f.

    Parameters
    ----------
    forces : callable
        Of V.
    gradient : callable
        Of the potential f . M^-1 f.
    strength : float
    """
    plain, correction = kick(forces), kick(gradient)

    def flow(state: State, tau: float) -> State:
        return correction(plain(state, tau), -0.5 * strength * tau**3)

    return flow
