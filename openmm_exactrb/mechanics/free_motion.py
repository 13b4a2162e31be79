"""The flow of the kinetic energy and related functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from openmm_exactrb.constraints.clusters import ClusterState
from openmm_exactrb.mathematics.compensated import add, exactly
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import Flow, State
from openmm_exactrb.rotors import Rotation, Rotor, rotor_of_sums
from openmm_exactrb.support.types import Array


@dataclass(frozen=True)
class Kinetic:
    """The motion of bodies without forces."""

    #: The flow of the kinetic energy.
    drift: Flow[State]
    #: displaced(state, push) -> the state translated from rest, without rotation, by momenta `push` (3, N) over unit
    #: time.
    displaced: Callable[[State, Array], State]
    #: tangent(state) -> the state with momenta projected onto the constraints. Since a drift begins with this
    #: projection, kicks and noise need the projection only where the energy is evaluated.
    tangent: Callable[[State], State]
    #: The drift "inner" of bodies with inner steps and the drift of the "others", if only some bodies have inner steps.
    split: Mapping[str, Flow[State]] = field(default_factory=dict)
    #: The degrees of freedom of translation and of rotation that constraints other than distances remove.
    lost: tuple[int, int] = (0, 0)


def rigid(mass: Array, rotation: Rotation) -> Kinetic:
    """Return the free motion of rigid bodies with masses (N,).

    `rotation` is a function of (q, m, tau) that returns (q, m) as double-doubles, such as a result of
    `openmm_exactrb.rotors.rotor_of_sums`.
    """

    def drift(state: State, tau: float) -> State:
        q, m = rotation(state.q, state.m, tau) if state.m.size else (state.q, state.m)
        return State(add(state.R, tau * (state.P[0] / mass)), state.P, q, m)

    def displaced(state: State, push: Array) -> State:
        return state._replace(R=exactly(state.R[0] + push / mass))

    return Kinetic(drift, displaced, lambda state: state)


def geodesics(free: Kinetic, bodies: RigidBodies) -> Kinetic:
    """Return the free motion in which atoms of constrained clusters move along the geodesics of their constraints."""
    clusters, columns = bodies.clusters, bodies.clustered
    if not len(clusters):
        return free

    def part(state: State) -> ClusterState:
        return ClusterState(*(np.ascontiguousarray(a[:, :, columns]) for a in (state.R, state.P)))

    def joined(state: State, moved: ClusterState) -> State:
        R, P = state.R.copy(), state.P.copy()
        R[:, :, columns], P[:, :, columns] = moved
        return state._replace(R=R, P=P)

    def drift(state: State, tau: float) -> State:
        return joined(free.drift(state, tau), clusters.drift(part(state), tau))

    def displaced(state: State, push: Array) -> State:
        return joined(free.displaced(state, push), clusters.drift(part(state._replace(P=exactly(push))), 1.0))

    def tangent(state: State) -> State:
        return joined(state, clusters.tangent(part(state)))

    return Kinetic(drift, displaced, tangent)


#: A type of constraint: constrain(free, bodies) -> the free motion that also satisfies the constraint.
Constrain = Callable[[Kinetic, RigidBodies], Kinetic]


def free_motion(bodies: RigidBodies, rotor: str | Rotor, constraints: Iterable[Constrain] = ()) -> Kinetic:
    """Return the motion of bodies without forces: free translation and rotation, subject to constraints.

    The distance constraints of the bodies are applied first, then the given constraints in sequence.
    """
    kinetic = rigid(bodies.mass, rotor_of_sums(rotor, bodies.inertia, checked=False))
    for constrain in (geodesics, *constraints):
        kinetic = constrain(kinetic, bodies)
    return kinetic
