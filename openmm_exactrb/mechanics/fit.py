"""Calculation of the state of bodies and constrained clusters from positions and velocities of their particles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.constraints.clusters import ClusterKind, ClusterState
from openmm_exactrb.errors import ShapeWarning
from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.mathematics.quaternions import from_matrix, matrix, turned
from openmm_exactrb.mechanics.bodies import Kind, RigidBodies
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.support.types import Array, Indices
from openmm_exactrb.support.warn import warn

#: Larger deviations from a rigid shape, in nm, raise an error, because the positions belong to another molecule or to a
#: split molecule. Smaller ones occur for stretched bonds, as in files with positions from another force field.
REFUSED = 0.06
#: Bodies that agree within this distance, in nm, have the same shape.
RIGIDITY = 1e-4
# Deviations up to the first distance, in nm, are corrected without a warning, because PDB files round positions to
# 1e-4 nm. Those up to the second are usual in files that round to 1e-3 nm, such as .gro.
_ROUNDED, _ROUGHLY_ROUNDED = 2e-4, 2e-3
# A body whose positions relative to its centre changed by less than this distance, in nm, was translated but not
# rotated.
_SHIFTED = 1e-9
# A particle displaced by more than this distance, in nm, is in another periodic image or was not placed at all.
_ELSEWHERE = 0.4
# Number of particles of a body that are examined as the only displaced one.
_SUSPECTS = 8
# Number of Newton steps onto the constraints. Each step squares the relative error, so that this number reduces an
# error of half a bond length to below roundoff.
_NEWTON = 8
# If the error of a length after these steps exceeds this distance, in nm, the constraints cannot be satisfied.
_REACHED = 1e-9


def fit(bodies: RigidBodies, x: Array, v: Array) -> BodyState:
    """Return the state of bodies with given positions (nm) and velocities (nm/ps) of all particles (n_particles, 3).

    A ValueError is raised if numbers are not finite, positions deviate by more than `REFUSED` from a rigid body, or a
    constraint of a cluster is redundant or cannot be satisfied at these positions. The state is that of the best fit,
    which preserves centres and orientations. A ShapeWarning is issued if positions deviate by more than 2e-4 nm. The
    same limits hold for the constraints of nonrigid clusters, whose atoms are moved onto the constraints.
    """
    every = np.arange(len(bodies))
    nowhere = np.zeros((3, len(bodies)))
    start = BodyState(nowhere, nowhere, np.ones((4, bodies.n_turning)), nowhere[:, : bodies.n_turning])
    return refit(bodies, start, x, v, every, every)


def refit(bodies: RigidBodies, known: BodyState, x: Array, v: Array, moved: Indices, pushed: Indices) -> BodyState:
    """Return the state after changes of the positions of bodies `moved` and of the velocities of bodies `pushed`.

    Other arguments and errors are those of `fit`. A body that was only translated keeps its orientation and momenta.
    """
    R, P, q, m = (a.copy() for a in known)
    residuals = [(np.zeros(0, dtype=np.intp), np.zeros(0))]
    for kind in bodies.kinds:
        of_kind, particles, sites = _chosen(kind, moved)
        X = x[particles]
        _check_finite(bodies, of_kind, X)
        R[:, of_kind] = np.einsum("s,nsi->in", kind.masses / kind.mass, X)
        if kind.turns and len(of_kind):
            relative = X - R.T[of_kind, None]
            changed = np.abs(relative - turned(_attitudes(q, of_kind), sites)).max(axis=(1, 2)) > _SHIFTED
            of_kind, relative, sites = of_kind[changed], relative[changed], _some(sites, changed)
            pushed = np.union1d(pushed, of_kind)
            q[:, of_kind] = best_attitudes(kind.weights, sites, relative)
            residual = relative - turned(_attitudes(q, of_kind), sites)
            residuals.append((of_kind, np.sqrt((residual**2).sum(axis=2).max(axis=1, initial=0.0))))
        elif len(kind.masses) > 1:
            residuals.append((of_kind, np.linalg.norm(X - R.T[of_kind, None], axis=2).max(axis=1, initial=0.0)))
    residuals.append(_missed(bodies, R, moved))
    _judge(bodies, x, *map(np.concatenate, zip(*residuals, strict=True)))
    for kind in bodies.kinds:
        of_kind, particles, sites = _chosen(kind, pushed)
        V = v[particles]
        _check_finite(bodies, of_kind, V)
        P[:, of_kind] = np.einsum("s,nsi->in", kind.masses, V)
        if kind.turns and len(of_kind):
            # Compute only the momentum about the centre, m = Q^T sum m_s (Q b_s) x v_s = sum m_s b_s x Q^T v_s.
            in_body = np.einsum("nji,nsj->nsi", _attitudes(q, of_kind), V)
            m[:, of_kind] = np.einsum("s,nsi->in", kind.masses, np.cross(sites, in_body))
            if kind.linear:
                m[0, of_kind] = 0.0
    _put_on_constraints(bodies, R, P, np.union1d(moved, pushed))
    return BodyState(R, P, q, m)


def off_constraints(bodies: RigidBodies, state: BodyState) -> Indices:
    """Return an atom of each cluster that violates its constraints, as in a state that belongs to other constraints."""
    first, distance = _missed(bodies, state.R, np.arange(len(bodies)))
    return first[distance > _REACHED]


def best_attitudes(masses: Array, sites: Array, relative: Array) -> Array:
    """Return the orientations (4, n) that best fit sites to centred positions (doi:10.1107/S0567739476001873)."""
    if len(sites) == 1:
        correlation = np.einsum("s,nsi,sj->nij", masses, relative, sites[0])
    else:
        correlation = np.einsum("s,nsi,nsj->nij", masses, relative, sites)
    U, _, Vt = np.linalg.svd(correlation)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    return from_matrix((U @ Vt).transpose(1, 2, 0))


def congruent(shapes: Array, X: Array, within: float = RIGIDITY) -> NDArray[np.bool_]:
    """Return a mask (n,) of bodies (n, k, 3) that match a shape or its mirror image within a distance (nm).

    The shapes are (n, k, 3), or (1, k, 3) if all bodies have the same.
    """
    sites, relative = (a - a.mean(axis=-2, keepdims=True) for a in (shapes, X))
    found = np.zeros(len(X), dtype=bool)
    for hand in (sites, -sites):
        attitudes = matrix(best_attitudes(np.ones(X.shape[1]), hand, relative)).transpose(2, 0, 1)
        missed = relative - turned(np.ascontiguousarray(attitudes), hand)
        found |= np.sqrt((missed**2).sum(axis=2).max(axis=1)) <= within
    return found


def _chosen(kind: Kind, bodies: Indices) -> tuple[Indices, Indices, Array]:
    """Return the selected bodies of a kind, their particles and their sites."""
    of_kind = bodies[(bodies >= kind.bodies.start) & (bodies < kind.bodies.stop)]
    within = of_kind - kind.bodies.start
    return of_kind, kind.particles[within], _some(kind.sites, within)


def _some(sites: Array, chosen: NDArray[np.generic]) -> Array:
    """Return the sites of selected bodies, or unchanged sites (1, k, 3) if all bodies share them."""
    return sites if len(sites) == 1 else sites[chosen]


def _attitudes(q: Array, bodies: Indices) -> Array:
    """Return the rotation matrices (n, 3, 3) of selected bodies."""
    return np.ascontiguousarray(matrix(q[:, bodies]).transpose(2, 0, 1))


def _check_finite(bodies: RigidBodies, chosen: Indices, values: Array) -> None:
    bad = ~np.isfinite(values).all(axis=(1, 2))
    if bad.any():
        raise ValueError(
            f"positions or velocities of {bodies.name(int(chosen[np.argmax(bad)]))} are not finite: set finite values "
            "before the next step"
        )


def _judge(bodies: RigidBodies, x: Array, chosen: Indices, distance: Array) -> None:
    """Raise ValueError for positions that do not form rigid bodies, and warn of small deviations."""
    if not (distance > _ROUNDED).any():
        return
    worst = int(np.argmax(distance))
    name = bodies.name(int(chosen[worst]))
    if distance[worst] > REFUSED:
        raise ValueError(
            f"the positions of {name} deviate from its shape by {distance[worst]:.2g} nm"
            f"{_cause(bodies, x, int(chosen[worst]), float(distance[worst]))}"
        )
    remedy = "set positions that match the shapes"
    if distance[worst] <= _ROUGHLY_ROUNDED:
        remedy += ", unless these come from a file with three decimals in nm"
    warn(
        "positions deviated from the shapes of bodies and were corrected (bodies affected: "
        f"{(distance > _ROUNDED).sum()}), by up to {distance[worst]:.2g} nm for {name}: {remedy}",
        ShapeWarning,
    )


def _cause(bodies: RigidBodies, x: Array, body: int, distance: float) -> str:
    """Return the cause of a deviation, and a remedy."""
    if body < bodies.n_turning:
        kind = next(kind for kind in bodies.kinds if body < kind.bodies.stop)
        row = body - kind.bodies.start
        particles, sites = kind.particles[row], kind.sites[row % len(kind.sites)]
        if _missed_by(None, kind.weights, -sites, x[particles]).max() <= REFUSED:
            return (
                " and form its mirror image: set positions with the handedness of those that were set "
                "first, or call context.reinitialize(preserveState=True) to make the present positions the shape"
            )
        astray = _astray(kind.weights, sites, x[particles])
        if astray is not None and astray[1] > _ELSEWHERE:
            return (
                f", because of particle {particles[astray[0]]} alone, {astray[1]:.2g} nm from its place relative to "
                "the others: set the position of this particle again, in the periodic image of the others"
            )
    if distance > _ELSEWHERE:
        return (
            ", so that some of its particles are in another periodic image or have no proper position: set positions "
            "in which it is whole"
        )
    return (
        f", more than {REFUSED:g} nm, because bonds are stretched or bent: call context.applyConstraints(1e-6) after "
        "setPositions or, for a body given in bodies=, set the positions that were set first"
    )


def _astray(weights: Array, sites: Array, x: Array) -> tuple[int, float] | None:
    """Return the only particle of a body that is displaced by more than `REFUSED`, and its displacement, or None."""
    suspects = np.argsort(_missed_by(None, weights, sites, x))[-_SUSPECTS:]
    found = []
    for k in map(int, suspects):
        missed = _missed_by(k, weights, sites, x)
        if np.delete(missed, k).max() <= REFUSED:
            found.append((k, float(missed[k])))
    return found[0] if len(found) == 1 else None


def _missed_by(left_out: int | None, weights: Array, sites: Array, x: Array) -> Array:
    """Return the distances (k,) of particles from their positions in a fit that ignores the particle `left_out`."""
    weights = weights.copy()
    weights[[] if left_out is None else left_out] = 0.0
    relative, about = (a - weights @ a / weights.sum() for a in (x, sites))
    attitude = _attitudes(best_attitudes(weights, about[None], relative[None]), np.arange(1))
    return np.asarray(np.linalg.norm(relative - turned(attitude, about[None])[0], axis=1))


def _clusters_of(bodies: RigidBodies, chosen: Indices) -> Iterator[tuple[ClusterKind, Indices, NDArray[np.bool_]]]:
    """Yield each kind of clusters, the bodies (N, n) of its atoms, and a mask (N,) of clusters with chosen atoms."""
    for kind, columns in bodies.clusters.columns():
        atoms = columns + bodies.clustered.start
        yield kind, atoms, np.asarray(np.isin(atoms, chosen).any(axis=1))


def _missed(bodies: RigidBodies, R: Array, chosen: Indices) -> tuple[Indices, Array]:
    """Return the first atom of each cluster with selected bodies, and the largest error of its lengths in nm."""
    found = [(np.zeros(0, dtype=np.intp), np.zeros(0))]
    for kind, atoms, touched in _clusters_of(bodies, chosen):
        found.append((atoms[touched, 0], kind.missed(R.T[atoms[touched]]).max(axis=1)))
    first, distance = map(np.concatenate, zip(*found, strict=True))
    return first, distance


def _put_on_constraints(bodies: RigidBodies, R: Array, P: Array, chosen: Indices) -> None:
    """Move the clusters of selected bodies onto their constraints, and project their momenta.

    Centres of mass and total momenta are unchanged. R and P (3, N) are modified in place, in the columns of these
    clusters.
    """
    clusters = list(_clusters_of(bodies, chosen))
    if not any(touched.any() for _, _, touched in clusters):
        return
    for kind, atoms, touched in clusters:
        kind.check_singular(R.T[atoms], touched)
    state = ClusterState(*(exactly(np.ascontiguousarray(a[:, bodies.clustered])) for a in (R, P)))
    for _ in range(_NEWTON):
        state = bodies.clusters.drift(state, 0.0)
    reached = np.concatenate([atoms[touched].ravel() for _, atoms, touched in clusters])
    columns = reached - bodies.clustered.start
    R[:, reached], P[:, reached] = state.x[0][:, columns], state.p[0][:, columns]
    first, distance = _missed(bodies, R, reached)
    bad = ~(distance <= _REACHED)  # also true for nan
    if bad.any():
        raise ValueError(
            f"the constraints of {bodies.name(int(first[np.argmax(bad)]))} cannot be satisfied from these positions: "
            "set positions close to the constrained distances"
        )
