"""Atoms of constrained clusters put on their constraints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.compensated import exactly
from openmm_exactrb.mechanics.bodies import Indices, RigidBodies
from openmm_exactrb.mechanics.clusters import ClusterState, refuse_singular

Array = NDArray[np.float64]

#: Newton's steps onto the constraints: each squares what is left, from a fifth of a bond to less than a rounding.
_NEWTON = 8
#: Lengths that are missed by more than this after them, in nm, are not to be reached from there.
_REACHED = 1e-9


def missed(bodies: RigidBodies, R: Array, chosen: Indices) -> tuple[Indices, Array]:
    """Tell how far clusters are from their constraints.

    Parameters
    ----------
    bodies : RigidBodies
    R : (3, N) array
    chosen : array of int
        Bodies whose clusters are looked at.

    Returns
    -------
    bodies : array of int
        The first atom of each of these clusters.
    distance : array
        By how much it misses the length of a constraint at most, in nm.
    """
    found = [(np.zeros(0, dtype=np.intp), np.zeros(0))]
    for kind, columns in bodies.clusters.columns():
        of_kind = columns[_touched(bodies, columns, chosen)] + bodies.clustered.start
        x = R.T[of_kind]
        length = np.linalg.norm(x[:, kind.pairs[:, 0]] - x[:, kind.pairs[:, 1]], axis=2)
        found.append((of_kind[:, 0], np.abs(length - kind.lengths).max(axis=1)))
    first, distance = map(np.concatenate, zip(*found, strict=True))
    return first, distance


def put_on_constraints(bodies: RigidBodies, R: Array, P: Array, chosen: Indices) -> None:
    """Move the clusters of some bodies onto their constraints, and take from their momenta what these do not allow.

    Centres of mass and total momenta stay.

    Parameters
    ----------
    bodies : RigidBodies
    R, P : (3, N) arrays
        Are changed, in the columns of these clusters only.
    chosen : array of int

    Raises
    ------
    ValueError
        If a constraint follows from others at these places, or cannot be reached from them.
    """
    start = bodies.clustered.start
    touched = [columns[_touched(bodies, columns, chosen)] for _, columns in bodies.clusters.columns()]
    if not any(map(len, touched)):
        return
    for (kind, columns), some in zip(bodies.clusters.columns(), touched, strict=True):
        refuse_singular(kind, R.T[start + columns], np.isin(columns[:, 0], some[:, 0]))
    state = ClusterState(*(exactly(np.ascontiguousarray(a[:, bodies.clustered])) for a in (R, P)))
    for _ in range(_NEWTON):
        state = bodies.clusters.drift(state, 0.0)
    reached = np.concatenate([some.ravel() for some in touched])
    R[:, start + reached], P[:, start + reached] = state.x[0][:, reached], state.p[0][:, reached]
    first, distance = missed(bodies, R, start + reached)
    bad = ~(distance <= _REACHED)  # so that nan is bad
    if bad.any():
        raise ValueError(
            f"the constraints of {bodies.name(int(first[np.argmax(bad)]))} cannot be reached from these positions: set "
            "some whose distances are about those of the constraints"
        )


def _touched(bodies: RigidBodies, columns: Indices, chosen: Indices) -> NDArray[np.bool_]:
    """Tell which clusters (N,) of a kind have one of the bodies."""
    return np.asarray(np.isin(columns + bodies.clustered.start, chosen).any(axis=1))
