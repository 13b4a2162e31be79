"""The rigid bodies and constrained clusters of an OpenMM System."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import openmm

from openmm_exactrb.constraints.clusters import ClusterKind, Clusters, sorted_into_kinds
from openmm_exactrb.detection.shapes import (
    RESIDUAL,
    held_rigid,
    kinds_from_distances,
    kinds_from_positions,
    on_constraints,
)
from openmm_exactrb.detection.whole import whole_positions
from openmm_exactrb.errors import ShapeWarning
from openmm_exactrb.mechanics.bodies import Kind, RigidBodies
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.openmm_access.parameters import TermRows
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
        If nothing can move, the position of a particle with mass is not finite, redundant constraints contradict each
        other, a constraint joins a named body to another particle, a named body is invalid, or the System has Drude
        particles.
    """
    masses = parameters.masses(system)
    _check_drude_particles(system)
    _check_finite(positions, masses)
    given = _named_bodies(system, masses, bodies or [])
    held = parameters.constraints(system)
    whole = whole_positions(system, positions, masses, given, box, held)
    shapes: list[Kind] = []
    flexible: list[ClusterKind] = []
    for group in _groups(held, masses, given):
        particles, held_by, lengths = group
        body_masses = masses[particles[0]]
        pair = pairs and particles.shape[1] == 2 and len(held_by) == 1
        if pair or not (group.named or held_rigid(held_by, whole[particles[0]])):
            flexible.append(_flexible(group, body_masses, whole))
        elif group.complete:
            shapes += kinds_from_distances(particles, body_masses, group.distances, whole)
        else:
            x = whole if group.named else on_constraints(particles, body_masses, held_by, lengths, whole)
            shapes += kinds_from_positions(particles, body_masses, x)
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


class _Group(NamedTuple):
    """Connected particles (N, n) of N molecules with the same masses and constraints.

    Constraints are given by their members (m, 2), as indices of the n particles, and by their lengths (m,). Bodies that
    the user named have none.
    """

    particles: Indices
    pairs: Indices
    lengths: Array

    @property
    def named(self) -> bool:
        return not len(self.pairs) and self.particles.shape[1] > 1

    @property
    def complete(self) -> bool:
        """Whether all distances are constrained."""
        n = self.particles.shape[1]
        return bool(len(self.pairs) == n * (n - 1) // 2)

    @property
    def distances(self) -> Array:
        """The distances (n, n) of a group in which all of them are constrained."""
        distances = np.zeros(2 * self.particles.shape[1:])
        distances[tuple(self.pairs.T)] = distances[tuple(self.pairs[:, ::-1].T)] = self.lengths
        return distances


def _flexible(group: _Group, masses: Array, positions: Array) -> ClusterKind:
    """Return clusters with the constraints of a group.

    Redundant constraints are stored as `ClusterKind.implied`. If there are any, all lengths are those of the best fit
    to all constraints.
    """
    particles, pairs, lengths = group
    kind = ClusterKind(particles, masses, pairs, lengths)
    kept = kind.independent()
    if kept.all():
        return kind
    x = on_constraints(particles, masses, pairs[kept], lengths[kept], positions)[particles]
    missed = kind.missed(x).max(axis=0)
    if missed.max() > RESIDUAL * lengths.max():
        worst = int(np.argmax(missed))
        i, j = particles[0, pairs[worst]]
        raise ValueError(
            f"the constraint of {lengths[worst]:g} nm between particles {i} and {j} contradicts the other "
            f"constraints of {kind.name(0)} by {missed[worst]:.2g} nm: correct or remove this constraint"
        )
    x = on_constraints(particles[:1], masses, pairs, lengths, positions)[particles[:1]]
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


def _check_finite(positions: Array, masses: Array) -> None:
    lost = np.flatnonzero((masses > 0.0) & ~np.isfinite(positions).all(axis=1))
    if len(lost):
        raise ValueError(
            f"the position of particle {lost[0]} is not finite: set finite positions before the first step"
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


def _groups(held: TermRows, masses: Array, given: list[Indices]) -> list[_Group]:
    """Return the groups of connected particles with mass, in the order of their first particles."""
    from scipy.sparse import coo_array  # imported here, because it is slow to import
    from scipy.sparse.csgraph import connected_components

    n, (pairs, lengths), owner = len(masses), held, checks.owners(given, len(masses))
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
    free = owner[pairs[:, 0]] < 0
    found = [group for some in _of_one_size((pairs[free], lengths[free]), label) for group in _alike(masses, *some)]
    return sorted(found, key=lambda group: int(group.particles[0, 0]))


def _of_one_size(held: TermRows, label: Indices) -> Iterable[tuple[Indices, Indices, Array]]:
    """Yield clusters of equally many particles and constraints: particles (N, n), members (N, m, 2), lengths (N, m).

    A cluster consists of the particles with one label.
    """
    order = np.argsort(label, kind="stable")
    bounds = np.flatnonzero(np.diff(label[order], prepend=-1, append=len(label)))
    place = np.empty(len(label), dtype=np.intp)
    place[order] = np.arange(len(label)) - np.repeat(bounds[:-1], np.diff(bounds))
    members, lengths, owner = _sorted_once(place[held[0]], held[1], label[held[0][:, 0]])
    first = np.searchsorted(owner, np.arange(len(bounds)))
    sizes = np.column_stack([np.diff(bounds), np.diff(first)])
    for n, m in np.unique(sizes, axis=0):
        which = np.flatnonzero((sizes == (n, m)).all(axis=1))
        own = first[which][:, None] + np.arange(m)
        yield order[bounds[which][:, None] + np.arange(n)], members[own], lengths[own]


def _sorted_once(members: Indices, lengths: Array, owner: Indices) -> tuple[Indices, Array, Indices]:
    """Return constraints sorted by their clusters and members, each pair once, with the length that was added last."""
    members = np.sort(members, axis=1)
    order = np.lexsort((members[:, 1], members[:, 0], owner))
    members, lengths, owner = members[order], lengths[order], owner[order]
    last = np.append((np.diff(owner) != 0) | np.diff(members, axis=0).any(axis=1), True)[: len(owner)]
    return members[last], lengths[last], owner[last]


def _alike(masses: Array, particles: Indices, members: Indices, lengths: Array) -> Iterable[_Group]:
    """Yield clusters grouped by masses and constraints."""
    massive = masses[particles].any(axis=1)  # massless particles are frozen, or virtual sites
    particles, members, lengths = particles[massive], members[massive], lengths[massive]
    if not len(particles):
        return
    rows = np.concatenate([masses[particles], members.reshape(len(particles), -1), lengths], axis=1)
    group = arrays.alike(rows)[1]
    order = np.argsort(group, kind="stable")
    for same in np.split(order, np.cumsum(np.bincount(group))[:-1]):
        yield _Group(particles[same], members[same[0]], lengths[same[0]])
