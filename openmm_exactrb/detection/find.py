"""The rigid bodies and constrained clusters of an OpenMM System."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import openmm

from openmm_exactrb.detection.shapes import (
    RESIDUAL,
    held_rigid,
    kinds_from_distances,
    kinds_from_positions,
    on_constraints,
)
from openmm_exactrb.detection.whole import whole_positions
from openmm_exactrb.mechanics.bodies import Kind, RigidBodies
from openmm_exactrb.mechanics.clusters import ClusterKind, Clusters, sorted_into_kinds
from openmm_exactrb.mechanics.fit import ShapeWarning
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.openmm_access.parameters import Rows
from openmm_exactrb.support import checks
from openmm_exactrb.support.messages import listed
from openmm_exactrb.support.types import Array, Indices
from openmm_exactrb.support.warn import warn


def find_bodies(
    system: openmm.System,
    positions: Array,
    bodies: Sequence[Sequence[int]] | None = None,
    box: Array | None = None,
    pairs: bool = False,
) -> RigidBodies:
    """Find the rigid bodies of a System, defined by constraints or by `bodies`, and its other particles.

    The other particles are free, or belong to clusters that constraints do not hold rigid.

    Parameters
    ----------
    system : openmm.System
    positions : (n_particles, 3) array
        Positions in nm, which distinguish a body from its mirror image, and define the shape if constraints do not.
    bodies : sequence of sequences of int, optional
        Particles of further bodies, whose shapes are taken from the positions. Their virtual sites may be included or
        omitted.
    box : (3, 3) array, optional
        Vectors of the periodic box in nm. Bodies that the box has split are joined; see `whole_positions`.
    pairs : bool, optional
        Whether two particles joined by a constraint form a cluster instead of a linear body.

    Raises
    ------
    ValueError
        If nothing can move, redundant constraints contradict each other, a constraint joins a named body to another
        particle, a named body is invalid, or the System has Drude particles.
    """
    masses = parameters.masses(system)
    _check_drude_particles(system)
    given = _named_bodies(system, masses, bodies or [])
    held = parameters.constraints(system)
    whole = whole_positions(system, positions, masses, given, box, held)
    shapes: list[Kind] = []
    flexible: list[ClusterKind] = []
    for particles, distances in _clusters(held, masses, given):
        body_masses = masses[particles[0]]
        pair = pairs and len(distances) == 2 and not np.isnan(distances).any()
        if pair or not held_rigid(distances, whole[particles[0]]):
            flexible.append(_flexible(particles, body_masses, distances, whole))
            continue
        if not np.isnan(distances).any():
            shapes += kinds_from_distances(particles, body_masses, distances, whole)
        else:
            shapes += kinds_from_positions(
                particles, body_masses, on_constraints(particles, body_masses, distances, whole)
            )
    clusters = sorted_into_kinds(flexible)
    turning, single = ([shape for shape in shapes if shape.turns is turns] for turns in (True, False))
    kinds, start = [], 0
    for shape in (*turning, *_atoms_of(clusters), *single):
        stop = start + len(shape.particles)
        kinds.append(replace(shape, bodies=slice(start, stop)))
        start = stop
    if not kinds:
        raise ValueError(
            "the System contains no particle with mass, so nothing can move: set masses with setParticleMass"
        )
    return RigidBodies(kinds, len(masses), clusters)


def _flexible(particles: Indices, masses: Array, distances: Array, positions: Array) -> ClusterKind:
    """Return clusters with given constrained distances (n, n); unconstrained distances are nan.

    Redundant constraints are stored as `ClusterKind.implied`. If there are any, all lengths are those of the best fit
    to all constraints.
    """
    pairs = np.argwhere(np.triu(~np.isnan(distances), 1))
    kind = ClusterKind(particles, masses, pairs, distances[pairs[:, 0], pairs[:, 1]])
    kept = kind.independent()
    if kept.all():
        return kind
    without = distances.copy()
    without[tuple(pairs[~kept].T)] = without[tuple(pairs[~kept, ::-1].T)] = np.nan
    x = on_constraints(particles, masses, without, positions)[particles]
    missed = kind.missed(x).max(axis=0)
    if missed.max() > RESIDUAL * kind.lengths.max():
        worst = int(np.argmax(missed))
        i, j = particles[0, pairs[worst]]
        raise ValueError(
            f"the constraint of {kind.lengths[worst]:g} nm between particles {i} and {j} contradicts the other "
            f"constraints of {kind.name(0)} by {missed[worst]:.2g} nm: correct or remove this constraint"
        )
    x = on_constraints(particles[:1], masses, distances, positions)[particles[:1]]
    lengths = np.linalg.norm(x[0, pairs[:, 0]] - x[0, pairs[:, 1]], axis=1)
    return ClusterKind(particles, masses, pairs[kept], lengths[kept], pairs[~kept], lengths[~kept])


def _atoms_of(clusters: Clusters) -> Iterable[Kind]:
    """Yield the particles of clusters as single particles, in the order of the clusters, grouped by mass."""
    starts = np.flatnonzero(np.diff(clusters.mass, prepend=np.nan) != 0.0)
    for particles, mass in zip(np.split(clusters.particles, starts[1:]), clusters.mass[starts], strict=False):
        yield Kind(particles[:, None], slice(0), np.array([mass]), np.zeros((1, 1, 3)), float(mass), np.zeros((1, 3)))


def _check_drude_particles(system: openmm.System) -> None:
    for force in system.getForces():
        if isinstance(force, openmm.DrudeForce) and force.getNumParticles():
            names = listed(force.getParticleParameters(i)[0] for i in range(force.getNumParticles()))
            raise ValueError(
                f"the System contains Drude particles ({names}), which need one of OpenMM's Drude integrators: "
                "use a force field without Drude particles"
            )


def _named_bodies(system: openmm.System, masses: Array, bodies: Sequence[Sequence[int]]) -> list[Indices]:
    """Return the massive particles of the bodies that a user named."""
    owner = checks.owners(bodies, len(masses))
    for particle in map(int, np.flatnonzero((owner >= 0) & (masses == 0.0))):
        if not system.isVirtualSite(particle):
            raise ValueError(
                f"particle {particle} of body {owner[particle]} has no mass: set a mass in the System, or omit the "
                "particle from bodies="
            )
    named = []
    for number, body in enumerate(bodies):
        particles = np.array(sorted(body), dtype=np.intp)
        massive = particles[masses[particles] > 0.0]
        if not len(massive):
            raise ValueError(f"body {number} contains no particle with mass: add a particle with mass to this body")
        if len(particles) > 2 * len(massive):
            warn(
                f"{len(particles) - len(massive)} of the {len(particles)} particles of body {number} are virtual sites "
                "and do not contribute to its mass and inertia: if createRigidBodies or set_rigid_bodies made these "
                "sites, create the System without that call, and pass the same bodies in bodies=",
                ShapeWarning,
            )
        named.append(massive)
    return named


def _clusters(held: Rows, masses: Array, given: list[Indices]) -> Iterable[tuple[Indices, Array]]:
    """Return, for each kind of body, the particles (N, n) and the distances (n, n), nan if unconstrained."""
    from scipy.sparse import coo_array  # imported here, because it is slow to import
    from scipy.sparse.csgraph import connected_components

    n, (pairs, _), owner = len(masses), held, checks.owners(given, len(masses))
    leading_out = owner[pairs[:, 0]] != owner[pairs[:, 1]]
    if leading_out.any():
        p, q = pairs[np.argmax(leading_out)]
        raise ValueError(
            f"the constraint between particles {p} and {q} joins a body given in bodies= to a particle outside this "
            "body: put both particles into the same body, or remove this constraint"
        )
    links = [pairs, *(np.column_stack([np.full(len(b), b[0]), b]) for b in given)]
    rows, columns = np.concatenate(links).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    label = connected_components(graph, directed=False)[1].astype(np.intp)
    found = [group for some in _of_one_size(held, label, owner) for group in _alike(masses, *some)]
    return [(particles, distances) for _, particles, distances in sorted(found, key=lambda group: group[0])]


def _of_one_size(held: Rows, label: Indices, owner: Indices) -> Iterable[tuple[Indices, Array]]:
    """Yield, for each size n, the particles (N, n) of clusters with equal labels and their distances (N, n, n)."""
    pairs, lengths = held
    order = np.argsort(label, kind="stable")
    bounds = np.flatnonzero(np.diff(label[order], prepend=-1, append=len(label)))
    sizes, number = np.diff(bounds), label[pairs[:, 0]]
    place = np.empty(len(label), dtype=np.intp)
    place[order] = np.arange(len(label)) - np.repeat(bounds[:-1], sizes)
    row = np.empty(len(sizes), dtype=np.intp)
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        row[which] = np.arange(len(which))
        particles = order[bounds[which][:, None] + np.arange(size)]
        distances = np.full((len(which), size, size), np.nan)
        own = sizes[number] == size
        (i, j), r = place[pairs[own]].T, row[number[own]]
        distances[r, i, j] = distances[r, j, i] = lengths[own]
        distances[owner[particles[:, 0]] >= 0] = np.nan
        distances[:, np.arange(size), np.arange(size)] = 0.0
        yield particles, distances


def _alike(masses: Array, particles: Indices, distances: Array) -> Iterable[tuple[int, Indices, Array]]:
    """Yield clusters grouped by masses and distances: first particle, particles (N, n), distances (n, n)."""
    massive = masses[particles].any(axis=1)  # massless particles are frozen, or virtual sites
    particles, distances = particles[massive], distances[massive]
    if not len(particles):
        return
    rows = np.concatenate([masses[particles], distances.reshape(len(particles), -1)], axis=1)
    group = arrays.alike(rows)[1]
    order = np.argsort(group, kind="stable")
    for members in np.split(order, np.cumsum(np.bincount(group))[:-1]):
        yield int(particles[members[0], 0]), particles[members], distances[members[0]]
