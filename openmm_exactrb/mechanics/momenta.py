"""Momenta of the canonical distribution."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import BodyState


def canonical(
    bodies: RigidBodies, state: BodyState, kT: float, rng: np.random.Generator, at_rest: bool = False
) -> BodyState:
    """Return a state with momenta drawn at a temperature, those of constrained clusters along their constraints.

    The projection that is orthogonal in the metric of the masses leaves the canonical distribution on the constraints.

    Parameters
    ----------
    kT : float
        In kJ/mol.
    at_rest : bool
        Whether the centre of mass of all is to be at rest.
    """
    P = np.sqrt(kT * bodies.mass) * rng.standard_normal(state.P.shape)
    if at_rest:
        P -= bodies.mass * (P.sum(axis=1, keepdims=True) / bodies.mass.sum())
    m = np.sqrt(kT * bodies.inertia.T) * rng.standard_normal(state.m.shape)
    for kind in bodies.kinds:
        if kind.linear:
            m[0, kind.bodies] = 0.0
    return bodies.tangent(state._replace(P=P, m=m))
