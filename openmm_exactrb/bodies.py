"""Rigid bodies in an OpenMM System: where they are, and their state as particle positions and velocities.

The state of N bodies is one set of component-first float64 arrays. Bodies of one kind are neighbours, and kinds that
turn come before single particles, which have no attitude.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb import kernels
from openmm_exactrb.quaternions import from_matrix, matrix

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# A body whose extent along an axis, squared, is less than this part of the largest is flat or linear.
_FLAT = 1e-10
# A body whose places about its centre changed by less than this, in nm, was shifted and not turned.
_SHIFTED = 1e-9
#: Positions further than this from a rigid body, in nm, are refused.
RIGIDITY = 1e-4
#: The speed of light in nm/ps. A body above it is not finite in any useful sense.
LIGHT = 299_792.458


class BodyState(NamedTuple):
    """Positions and momenta of N bodies, the first K of which turn.

    Attributes
    ----------
    R, P : (3, N) arrays
        Centres of mass (nm) and linear momenta (amu nm/ps).
    q : (4, K) array
        Attitudes, scalar first, from the principal axes of the body into space.
    m : (3, K) array
        Angular momenta in the principal axes of the body (amu nm²/ps).
    """

    R: Array
    P: Array
    q: Array
    m: Array

    @property
    def high(self) -> BodyState:
        """The numbers themselves, where arrays are sums (2, ...) of `openmm_exactrb.sums`."""
        return BodyState(*(x[0] for x in self))


@dataclass(frozen=True)
class Kind:
    """All bodies of one shape.

    Attributes
    ----------
    particles : (n, k) array
        The k particles with mass of each of the n bodies.
    bodies : slice
        Where they stand among all bodies.
    masses : (k,) array
    sites : (k, 3) array
        Places of the particles in the principal axes of the body, about the centre of mass.
    mass : float
    inertia : (3,) array
        Principal moments; in ascending order; the first is 0 for a linear body, all are for a single particle.
    """

    particles: Indices
    bodies: slice
    masses: Array
    sites: Array
    mass: float
    inertia: Array

    @cached_property
    def _stride(self) -> int | None:
        """Particles from one body to the next, where all bodies stand in line; else None."""
        n, k = self.particles.shape
        stride = int(self.particles[1, 0] - self.particles[0, 0]) if n > 1 else k
        line = self.particles[0, 0] + stride * np.arange(n)[:, None] + np.arange(k)
        return stride if stride >= k and np.array_equal(line, self.particles) else None

    def _view(self, array: Array) -> Array | None:
        """Return (n, k, 3) of a particle array without a copy, where bodies stand in line."""
        n, k = self.particles.shape
        if self._stride is None or not array.flags.c_contiguous:
            return None
        rows, step = array[self.particles[0, 0] :], array.strides[0]
        return np.lib.stride_tricks.as_strided(rows, (n, k, 3), (self._stride * step, step, array.strides[1]))

    def gather(self, array: Array) -> Array:
        """Return the rows (n, k, 3) of the bodies' particles."""
        view = self._view(array)
        return array[self.particles] if view is None else view

    def scatter(self, rows: Array, out: Array) -> None:
        """Write rows (n, k, 3) to the bodies' particles."""
        view = self._view(out)
        if view is None:
            out[self.particles] = rows
        else:
            view[:] = rows

    @property
    def turns(self) -> bool:
        """Whether the bodies have an attitude: all but single particles."""
        return len(self.sites) > 1

    @property
    def linear(self) -> bool:
        """Whether all sites lie on axis 1."""
        return self.turns and bool(self.inertia[0] == 0.0)


class RigidBodies:
    """The rigid bodies of a System and their free particles, as one set of arrays.

    Parameters
    ----------
    kinds : sequence of Kind
    n_particles : int
        Particles of the System, virtual sites included.
    """

    def __init__(self, kinds: Sequence[Kind], n_particles: int) -> None:
        self.kinds = tuple(kinds)
        self._place, self._collect = _particle_kernels()
        self.n_particles = n_particles
        self.n_turning = sum(len(kind.particles) for kind in kinds if kind.turns)
        self.mass: Array = np.concatenate([np.full(len(kind.particles), kind.mass) for kind in kinds])
        self.first_particle: Indices = np.concatenate([kind.particles[:, 0] for kind in kinds])
        turning = [kind for kind in kinds if kind.turns]
        moments = [np.where(kind.linear, kind.inertia[2], kind.inertia) for kind in turning]
        # A linear body turns as a sphere does whose momentum has no component along the axis.
        #: Moments for the rotor: (1, 3) if all bodies that turn are of one kind, else (K, 3).
        self.inertia: Array = (
            moments[0][None]
            if len(turning) == 1
            else np.concatenate(
                [np.tile(i, (len(kind.particles), 1)) for i, kind in zip(moments, turning, strict=True)]
            )
        )

    @property
    def rotational_freedom(self) -> int:
        """Rotational degrees of freedom."""
        return sum((3 - kind.linear) * len(kind.particles) for kind in self.kinds if kind.turns)

    def __len__(self) -> int:
        """Return the number of bodies, single particles included."""
        return len(self.mass)

    def positions(self, state: BodyState, out: Array) -> Array:
        """Write the positions of all particles with mass into `out` (n_particles, 3)."""
        for kind in self.kinds:
            if kind.turns:
                self._place(kind, state, out)
            else:
                kind.scatter(state.R.T[kind.bodies, None], out)
        return out

    def velocities(self, state: BodyState, out: Array) -> Array:
        """Write the velocities of all particles with mass into `out` (n_particles, 3)."""
        Q = matrix(state.q)
        V = (state.P / self.mass).T
        omega = state.m.T / self.inertia
        for kind in self.kinds:
            velocity = V[kind.bodies, None]
            if kind.turns:
                relative = np.cross(omega[kind.bodies, None], kind.sites)
                velocity = velocity + np.einsum("ijn,nsj->nsi", Q[:, :, kind.bodies], relative)
            kind.scatter(velocity, out)
        return out

    def forces(self, state: BodyState, forces: Array) -> tuple[Array, Array]:
        """Return total forces (3, N) and body-frame torques (3, K) from forces on the particles (n_particles, 3)."""
        total, torque = np.empty((3, len(self))), np.empty((3, self.n_turning))
        for kind in self.kinds:
            if kind.turns:
                self._collect(kind, state, forces, total, torque)
            else:
                total[:, kind.bodies] = kind.gather(forces)[:, 0].T
        return total, torque

    def fit(self, x: Array, v: Array) -> BodyState:
        """Find the state of bodies from the positions and velocities of their particles.

        Parameters
        ----------
        x, v : (n_particles, 3) arrays

        Raises
        ------
        ValueError
            If positions are not finite, or further than `RIGIDITY` from a rigid body.
        """
        every = np.arange(len(self))
        nowhere = np.zeros((3, len(self)))
        start = BodyState(nowhere, nowhere, np.ones((4, self.n_turning)), nowhere[:, : self.n_turning])
        return self.refit(start, x, v, every, every)

    def refit(self, known: BodyState, x: Array, v: Array, moved: Indices, pushed: Indices) -> BodyState:
        """Find the state of some bodies again from their particles.

        Parameters
        ----------
        known : BodyState
            The state of the others.
        x, v : (n_particles, 3) arrays
        moved, pushed : arrays of int
            Bodies whose positions or velocities changed. One that was only shifted keeps attitude and momenta.

        Raises
        ------
        ValueError
            As `fit`.
        """
        R, P, q, m = (a.copy() for a in known)
        for kind in self.kinds:
            bodies, particles = self._of_kind(kind, moved)
            X = x[particles]
            self._check_finite(bodies, X)
            R[:, bodies] = np.einsum("s,nsi->in", kind.masses / kind.mass, X)
            if kind.turns and len(bodies):
                relative = X - R.T[bodies, None]
                turned = (
                    np.abs(relative - _turned(_attitude_matrices(q, bodies), kind.sites)).max(axis=(1, 2)) > _SHIFTED
                )
                bodies, relative = bodies[turned], relative[turned]
                pushed = np.union1d(pushed, bodies)
                q[:, bodies] = _best_attitudes(kind, relative)
                self._check_rigid(bodies, relative - _turned(_attitude_matrices(q, bodies), kind.sites))
        for kind in self.kinds:
            bodies, particles = self._of_kind(kind, pushed)
            V = v[particles]
            self._check_finite(bodies, V)
            P[:, bodies] = np.einsum("s,nsi->in", kind.masses, V)
            if kind.turns and len(bodies):
                # Only the momentum about the centre: m = Q^T sum m_s (Q b_s) x v_s = sum m_s b_s x Q^T v_s.
                in_body = np.einsum("nji,nsj->nsi", _attitude_matrices(q, bodies), V)
                m[:, bodies] = np.einsum("s,nsi->in", kind.masses, np.cross(kind.sites, in_body))
                if kind.linear:
                    m[0, bodies] = 0.0
        return BodyState(R, P, q, m)

    def _of_kind(self, kind: Kind, bodies: Indices) -> tuple[Indices, Indices]:
        """Return those of the bodies that are of this kind, and their particles."""
        chosen = bodies[(bodies >= kind.bodies.start) & (bodies < kind.bodies.stop)]
        return chosen, kind.particles[chosen - kind.bodies.start]

    def closest(self, state: BodyState) -> tuple[tuple[int, int], float]:
        """Return the two bodies whose centres are closest, and their distance in nm."""
        if len(self) < 2:
            return (0, 0), np.inf
        from scipy.spatial import cKDTree  # here, for a short import of the package

        distances, neighbours = map(np.asarray, cKDTree(state.R.T).query(state.R.T, k=2))
        body = int(np.argmin(distances[:, 1]))
        return (body, int(neighbours[body, 1])), float(distances[body, 1])

    def kinetic_energies(self, state: BodyState) -> tuple[float, float]:
        """Return the translational and rotational kinetic energies in kJ/mol."""
        translational = 0.5 * float(np.sum(state.P * state.P / self.mass))
        return translational, 0.5 * float(np.sum(state.m * state.m / self.inertia.T))

    def lost(self, state: BodyState) -> NDArray[np.bool_]:
        """Tell which bodies have numbers without finite squares, or are faster than light, (N,)."""
        found = np.asarray(~np.isfinite(state.R * state.R).all(axis=0))
        found |= ~((state.P * state.P).sum(axis=0) <= (LIGHT * self.mass) ** 2)  # so that nan is lost
        for x in (state.q, state.m):
            found[: self.n_turning] |= ~np.isfinite(x * x).all(axis=0)
        return found

    def name(self, body: int) -> str:
        """Say which particles a body consists of."""
        for kind in self.kinds:
            if kind.bodies.start <= body < kind.bodies.stop:
                return f"body {body} (particles {', '.join(map(str, kind.particles[body - kind.bodies.start]))})"
        raise IndexError(f"there is no body {body}")

    def _check_finite(self, bodies: Indices, values: Array) -> None:
        bad = ~np.isfinite(values).all(axis=(1, 2))
        if bad.any():
            raise ValueError(
                f"positions or velocities of {self.name(int(bodies[np.argmax(bad)]))} are not finite: "
                "set finite ones before the next step"
            )

    def _check_rigid(self, bodies: Indices, misfit: Array) -> None:
        distance = np.sqrt((misfit**2).sum(axis=2).max(axis=1, initial=0.0))
        if (distance > RIGIDITY).any():
            worst = int(np.argmax(distance))
            raise ValueError(
                f"{self.name(int(bodies[worst]))} is {distance[worst]:.2g} nm away from its rigid shape, more than "
                f"{RIGIDITY:g} nm: call context.applyConstraints(1e-6) after setPositions, and do not let a periodic "
                "box split molecules"
            )


def find_bodies(system: openmm.System, positions: Array, bodies: Sequence[Sequence[int]] | None = None) -> RigidBodies:
    """Find the rigid bodies of a System: clusters of particles that constraints hold rigid.

    Parameters
    ----------
    system : openmm.System
    positions : (n_particles, 3) array
        In nm. They tell a body from its mirror image, and give the shape where constraints do not.
    bodies : sequence of sequences of int, optional
        Particles of further bodies, whose shape is that of the positions. Their virtual sites may be named or not.

    Raises
    ------
    ValueError
        If there is no rigid body, constraints do not fix a cluster fully or lead out of a body, a body is named
        wrongly, or the System has Drude particles.
    """
    masses = np.array([system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(system.getNumParticles())])
    _refuse_drude_particles(system)
    given = _named_bodies(system, masses, bodies or [])
    groups: dict[tuple[bytes, bytes], list[Indices]] = {}
    for particles, distances in _clusters(system, masses, given):
        groups.setdefault((masses[particles].tobytes(), distances.tobytes()), []).append(particles)
    shapes: list[Kind] = []
    for (mass_bytes, distance_bytes), members in groups.items():
        body_masses = np.frombuffer(mass_bytes)
        distances = np.frombuffer(distance_bytes).reshape(len(body_masses), -1)
        make = _kinds_from_positions if np.isnan(distances).any() else _kinds_from_distances
        shapes += make(np.stack(members), body_masses, distances, positions)
    if not any(shape.turns for shape in shapes):
        raise ValueError(
            "the System has no rigid bodies: constrain all distances within each molecule, for example with "
            "createSystem(rigidWater=True), or name them with bodies=[[0, 1, 2], ...]"
        )
    kinds, start = [], 0
    for shape in sorted(shapes, key=lambda shape: not shape.turns):
        stop = start + len(shape.particles)
        kinds.append(replace(shape, bodies=slice(start, stop)))
        start = stop
    return RigidBodies(kinds, len(masses))


def _refuse_drude_particles(system: openmm.System) -> None:
    for force in system.getForces():
        if isinstance(force, openmm.DrudeForce) and force.getNumParticles():
            names = ", ".join(str(force.getParticleParameters(i)[0]) for i in range(min(3, force.getNumParticles())))
            raise ValueError(
                f"the System has Drude particles ({names}, ...), which need an integrator of their own: use a force "
                "field without them"
            )


def _named_bodies(system: openmm.System, masses: Array, bodies: Sequence[Sequence[int]]) -> list[Indices]:
    """Return the particles with mass of the bodies that a user named."""
    seen: dict[int, int] = {}
    named = []
    for number, body in enumerate(bodies):
        particles = np.array(sorted(body), dtype=np.intp)
        for particle in map(int, particles):
            if not 0 <= particle < len(masses):
                raise ValueError(f"body {number} names particle {particle}, but the System has {len(masses)} particles")
            if particle in seen:
                raise ValueError(f"particle {particle} is named twice, in bodies {seen[particle]} and {number}")
            if masses[particle] == 0.0 and not system.isVirtualSite(particle):
                raise ValueError(f"particle {particle} of body {number} has no mass: a rigid body needs masses")
            seen[particle] = number
        massive = particles[masses[particles] > 0.0]
        if not len(massive):
            raise ValueError(f"body {number} has no particle with mass")
        named.append(massive)
    return named


def _clusters(system: openmm.System, masses: Array, given: list[Indices]) -> Iterable[tuple[Indices, Array]]:
    """Yield the particles of each body, and those of their distances that constraints give (nan elsewhere)."""
    from scipy.sparse import coo_array  # here, for a short import of the package
    from scipy.sparse.csgraph import connected_components

    n, count = len(masses), system.getNumConstraints()
    pairs, lengths = np.empty((count, 2), dtype=np.intp), np.empty(count)
    for i in range(count):
        p, q, length = system.getConstraintParameters(i)
        pairs[i], lengths[i] = (p, q), length.value_in_unit(unit.nanometer)
    owner = np.full(n, -1)
    for number, particles in enumerate(given):
        owner[particles] = number
    leading_out = owner[pairs[:, 0]] != owner[pairs[:, 1]]
    if leading_out.any():
        p, q = pairs[np.argmax(leading_out)]
        raise ValueError(f"the constraint between particles {p} and {q} leads out of a rigid body: remove it")
    links = [pairs, *(np.column_stack([np.full(len(b), b[0]), b]) for b in given)]
    rows, columns = np.concatenate(links).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    order = np.argsort(label, kind="stable")
    place = np.empty(n, dtype=np.intp)
    bounds = np.flatnonzero(np.diff(label[order], prepend=-1, append=n))
    for start, stop in itertools.pairwise(bounds):
        place[order[start:stop]] = np.arange(stop - start)
    of_cluster = np.argsort(label[pairs[:, 0]], kind="stable")
    limits = np.searchsorted(label[pairs[of_cluster, 0]], np.arange(len(bounds)))
    for cluster, (start, stop) in enumerate(itertools.pairwise(bounds)):
        particles = order[start:stop]
        if len(particles) == 1 and masses[particles[0]] == 0.0:
            continue
        distances = np.full((len(particles), len(particles)), np.nan)
        np.fill_diagonal(distances, 0.0)
        constraints = of_cluster[limits[cluster] : limits[cluster + 1]]
        i, j = place[pairs[constraints]].T
        distances[i, j] = distances[j, i] = lengths[constraints]
        if owner[particles[0]] >= 0:
            distances[~np.eye(len(particles), dtype=bool)] = np.nan
        yield particles, distances


def _kinds_from_distances(particles: Indices, masses: Array, distances: Array, positions: Array) -> list[Kind]:
    """Return the kind of bodies all of whose distances are known, or it and its mirror image."""
    kind = _kind(particles, masses, distances)
    if not kind.sites.any(axis=0).all():
        return [kind]
    X = positions[particles]
    relative = X - np.einsum("s,nsi->ni", masses / kind.mass, X)[:, None]
    mirrored = np.linalg.det(np.einsum("s,nsi,sj->nij", masses, relative, kind.sites)) < 0.0
    image = replace(kind, sites=kind.sites * (-1.0, 1.0, 1.0))
    return [
        replace(k, particles=particles[chosen]) for k, chosen in ((kind, ~mirrored), (image, mirrored)) if chosen.any()
    ]


def _kinds_from_positions(particles: Indices, masses: Array, distances: Array, positions: Array) -> list[Kind]:
    """Return the kinds of bodies of these masses whose shape is that of their positions.

    Bodies whose shapes agree within `RIGIDITY` are of one kind, the shape of the first.
    """
    X = positions[particles]
    if not np.isfinite(X).all():
        raise ValueError("positions are not finite: set them before the first step")
    _refuse_floppy(particles[0], distances, X[0])
    kinds = []
    while len(particles):
        apart = np.linalg.norm(X[0][:, None] - X[0][None], axis=2)
        kind = _kinds_from_distances(particles[:1], masses, apart, positions)[0]
        relative = X - np.einsum("s,nsi->ni", masses / kind.mass, X)[:, None]
        fitted = _turned(matrix(_best_attitudes(kind, relative)).transpose(2, 0, 1), kind.sites)
        same = np.sqrt(((relative - fitted) ** 2).sum(axis=2).max(axis=1)) <= RIGIDITY
        same[0] = True
        kinds.append(replace(kind, particles=particles[same]))
        particles, X = particles[~same], X[~same]
    return kinds


def _refuse_floppy(particles: Indices, distances: Array, x: Array) -> None:
    """Refuse constraints that leave a cluster a motion beside those of a rigid body."""
    i, j = np.nonzero(np.triu(~np.isnan(distances), 1))
    if not len(i):  # named by the user
        return
    rows = np.zeros((len(i), len(x), 3))
    direction = x[i] - x[j]
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), np.finfo(float).tiny)
    rows[np.arange(len(i)), i], rows[np.arange(len(i)), j] = direction, -direction
    rank = np.linalg.matrix_rank(rows.reshape(len(i), -1), tol=1e-6)
    if rank < 3 * len(x) - 6:
        raise ValueError(
            f"the constraints between particles {', '.join(map(str, particles))} do not hold them rigid: constrain "
            "every distance between them, or none, or name them with bodies="
        )


def _kind(particles: Indices, masses: Array, distances: Array) -> Kind:
    """Place the particles of a body in its principal axes, from all their distances."""
    mass = float(masses.sum())
    if len(masses) == 1:
        return Kind(particles, slice(0), masses, np.zeros((1, 3)), mass, np.zeros(3))
    # Classical scaling about the centre of mass: the weighted Gram matrix has the moments of second order as its
    # eigenvalues and the places as its eigenvectors.
    weights = masses / mass
    square = distances**2
    to_centre = square @ weights
    gram = 0.5 * (to_centre[:, None] + to_centre[None, :] - weights @ to_centre - square)
    root = np.sqrt(masses)
    moments, vectors = np.linalg.eigh(root[:, None] * gram * root)
    spread = np.zeros(3)
    axes = np.zeros((len(masses), 3))
    found = min(3, len(masses))
    spread[:found] = np.maximum(moments[::-1][:found], 0.0)
    axes[:, :found] = vectors[:, ::-1][:, :found]
    spread[spread < _FLAT * spread[0]] = 0.0
    sites = axes * np.sqrt(spread) / root[:, None]
    misfit = np.abs(np.linalg.norm(sites[:, None] - sites[None, :], axis=2) - distances).max()
    if misfit > 1e-5 * distances.max() or not spread[0] > 0.0:
        raise ValueError(
            f"the constraints between particles {', '.join(map(str, particles[0]))} fit no body in space: "
            f"a distance is missed by {misfit:.2g} nm"
        )
    # The largest spread comes first: moments ascend, and a linear body lies on axis 1.
    return Kind(particles, slice(0), masses, sites, mass, spread.sum() - spread)


def _place(kind: Kind, state: BodyState, out: Array) -> None:
    """Write the positions of the particles of all bodies of a kind."""
    Q = matrix(state.q[:, kind.bodies]).transpose(2, 0, 1)
    kind.scatter(state.R.T[kind.bodies, None] + _turned(Q, kind.sites), out)


def _collect(kind: Kind, state: BodyState, forces: Array, total: Array, torque: Array) -> None:
    """Sum the forces on the particles of all bodies of a kind to forces and body-frame torques."""
    F = kind.gather(forces)
    n, k, _ = F.shape
    by_site = np.ascontiguousarray(F.transpose(1, 2, 0))
    total[:, kind.bodies] = by_site.sum(axis=0)
    # Moment D = sum over sites of b F^T, space components second; the torque is sum_c D_c x (Q^T e_c).
    D = (kind.sites.T @ by_site.reshape(k, 3 * n)).reshape(3, 3, n)
    E = matrix(state.q[:, kind.bodies]).swapaxes(0, 1)
    out = torque[:, kind.bodies]
    out[0] = 0.0 if kind.linear else (D[1] * E[2] - D[2] * E[1]).sum(axis=0)
    out[1] = (D[2] * E[0] - D[0] * E[2]).sum(axis=0)
    out[2] = (D[0] * E[1] - D[1] * E[0]).sum(axis=0)


def _particle_kernels() -> tuple[Callable[..., None], Callable[..., None]]:
    """Return `_place` and `_collect`, compiled where numba is installed."""
    if not kernels.available():
        return _place, _collect
    compiled = kernels.load("bodies_compiled")

    def place(kind: Kind, state: BodyState, out: Array) -> None:
        compiled.place(state.R, state.q, kind.particles, kind.sites, kind.bodies.start, out)

    def collect(kind: Kind, state: BodyState, forces: Array, total: Array, torque: Array) -> None:
        compiled.collect(state.q, kind.particles, kind.sites, kind.bodies.start, total, torque, forces)

    return place, collect


def _turned(Q: Array, sites: Array) -> Array:
    """Return Q b for attitudes (n, 3, 3) and sites (k, 3), as (n, k, 3)."""
    n = len(Q)
    return (Q.reshape(3 * n, 3) @ sites.T).reshape(n, 3, len(sites)).swapaxes(1, 2)


def _attitude_matrices(q: Array, bodies: Indices) -> Array:
    """Return the rotation matrices (n, 3, 3) of some bodies."""
    return np.ascontiguousarray(matrix(q[:, bodies]).transpose(2, 0, 1))


def _best_attitudes(kind: Kind, relative: Array) -> Array:
    """Return the attitudes (4, n) that fit sites to places about the centre best (doi:10.1107/S0567739476001873)."""
    correlation = np.einsum("s,nsi,sj->nij", kind.masses, relative, kind.sites)
    U, _, Vt = np.linalg.svd(correlation)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    return from_matrix((U @ Vt).transpose(1, 2, 0))
