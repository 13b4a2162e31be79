"""Clusters of particles that distance constraints hold together without making them rigid.

They move freely along the geodesics of their constraints: `Clusters.drift` follows these to roundoff, for any time, by
the power series of `openmm_exactrb.kernels.plain.clusters`. Any graph of constraints will do, as long as none of them
follows from the others; its matrix is factorised along a fixed sparse pattern, so that the cost grows with the number
of constraints and not with its cube.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from openmm_exactrb import kernels
from openmm_exactrb.kernels.plain import clusters as plain
from openmm_exactrb.kernels.plain.clusters import Graph
from openmm_exactrb.motion.elimination import eliminated

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Which = Literal["fastest", "numpy", "numba"]

#: Constraints further than this from their lengths, in nm, are refused.
MISFIT = 1e-4
#: Constraints that a cluster may have.
LARGEST = 1000
#: Constraints less independent than this, as `ClusterKind.most_dependent` tells, are refused.
INDEPENDENT = 1e-9
#: Newton's steps onto the constraints: each squares what is left of `MISFIT`.
_NEWTON = 6


class ClusterState(NamedTuple):
    """Places and momenta of the atoms of all clusters, as sums high + low.

    Attributes
    ----------
    x, p : (2, 3, M) arrays
        In nm and amu nm/ps.
    """

    x: Array
    p: Array

    @property
    def high(self) -> ClusterState:
        """The numbers themselves, (3, M)."""
        return ClusterState(self.x[0], self.p[0])


@dataclass(frozen=True)
class ClusterKind:
    """All clusters of one graph, with the same masses and lengths.

    Attributes
    ----------
    particles : (N, n) array
        The n particles of each of the N clusters.
    masses : (n,) array
        In amu.
    pairs : (m, 2) array
        The two members of each constraint, by their places in `particles`.
    lengths : (m,) array
        In nm.

    Raises
    ------
    ValueError
        If arrays do not fit together, a member has no mass, a length is not positive, or a constraint follows from
        the others wherever the members are.
    """

    particles: Indices
    masses: Array
    pairs: Indices
    lengths: Array

    def __post_init__(self) -> None:
        n, m = len(self.masses), len(self.pairs)
        if (
            self.particles.ndim != 2
            or self.particles.shape[1] != n
            or self.pairs.shape != (m, 2)
            or len(self.lengths) != m
        ):
            raise ValueError(
                f"particles {self.particles.shape}, masses {self.masses.shape}, pairs {self.pairs.shape} and lengths "
                f"{self.lengths.shape} do not belong to one kind of clusters"
            )
        self._refuse_numbers()
        if m > LARGEST:
            raise ValueError(
                f"{m} constraints hold {self.name(0)} together, more than {LARGEST}: create the System with "
                "constraints=HBonds, which constrains hydrogens only"
            )
        self._refuse_redundant()

    @property
    def shape(self) -> str:
        """The graph in a word: "pair", "star", "tree" or "general"."""
        n, m = len(self.masses), len(self.pairs)
        if m > n - 1:
            return "general"
        degrees = np.bincount(self.pairs.ravel(), minlength=n)
        return "pair" if n == 2 else "star" if degrees.max() == m else "tree"

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a cluster."""
        return 3 * len(self.masses) - len(self.pairs)

    @cached_property
    def graph(self) -> Graph:
        """What the kernels take, with constraints in an order that keeps the factor sparse."""
        coupling = self.coupling
        order, rows, columns, starts, left, right = eliminated(coupling != 0.0)
        row_of = np.repeat(np.arange(len(order)), np.diff(rows))
        return Graph(
            1.0 / self.masses,
            np.ascontiguousarray(self.pairs[order]),
            self.lengths[order],
            coupling[order[row_of], order[columns]],
            rows,
            columns,
            starts,
            left,
            right,
        )

    @cached_property
    def coupling(self) -> Array:
        """The matrix B_cd = sum_a s_ca s_da / m_a (m, m)."""
        signs = np.zeros((len(self.pairs), len(self.masses)))
        each = np.arange(len(self.pairs))
        signs[each, self.pairs[:, 0]], signs[each, self.pairs[:, 1]] = 1.0, -1.0
        coupling: Array = (signs / self.masses) @ signs.T
        return coupling

    def name(self, cluster: int) -> str:
        """Say which particles a cluster consists of."""
        members = [str(k) for k in self.particles[cluster]]
        shown = members if len(members) < 9 else [*members[:4], "...", *members[-2:]]
        return f"the cluster of particles {', '.join(shown)}"

    def most_dependent(self, x: Array) -> tuple[Array, Indices]:
        """Tell how independent the constraints are at places, and which one depends on others the most.

        Parameters
        ----------
        x : (N, n, 3) array

        Returns
        -------
        independence : (N,) array
            The smallest part of a constraint's gradient, squared, in the mass metric, that those before it in
            `graph` do not have; 0 where it follows from them.
        constraint : (N,) array
            Its number in `graph`.
        """
        r = (x[:, self.graph.pairs[:, 0]] - x[:, self.graph.pairs[:, 1]]).transpose(2, 1, 0)
        r /= np.maximum(np.sqrt((r * r).sum(axis=0)), np.finfo(float).tiny)
        diagonal = self.graph.rows[1:] - 1
        with np.errstate(all="ignore"):
            inverse_roots = np.array(plain.factor(self.graph, r))[diagonal]
            rest = 1.0 / (inverse_roots * inverse_roots * self.graph.weights[diagonal, None])
        rest = np.where(np.isfinite(rest), rest, 0.0)
        return rest.min(axis=0), rest.argmin(axis=0)

    def _refuse_numbers(self) -> None:
        bad = ~((self.masses > 0.0) & np.isfinite(self.masses))
        if bad.any():
            raise ValueError(
                f"particle {self.particles[0, np.argmax(bad)]} of {self.name(0)} has the mass "
                f"{self.masses[np.argmax(bad)]:g}: a constraint needs masses at both ends, give it one or remove its "
                "constraints"
            )
        bad = ~((self.lengths > 0.0) & np.isfinite(self.lengths)) | (self.pairs[:, 0] == self.pairs[:, 1])
        if bad.any():
            i, j = self.particles[0, self.pairs[np.argmax(bad)]]
            raise ValueError(
                f"the constraint of particles {i} and {j} to {self.lengths[np.argmax(bad)]:g} nm cannot be kept: it "
                "needs two particles and a positive length"
            )

    def _refuse_redundant(self) -> None:
        """Refuse a constraint that follows from others wherever members are, as three random places tell."""
        places = np.random.default_rng(0).standard_normal((3, len(self.masses), 3))
        independence, constraint = self.most_dependent(places)
        if independence.max() < INDEPENDENT:
            i, j = self.particles[0, self.graph.pairs[constraint[np.argmax(independence)]]]
            raise ValueError(
                f"the constraint of particles {i} and {j} follows from the others of {self.name(0)}: remove it"
            )


class Clusters:
    """Clusters of several kinds as one set of arrays.

    Atom a of cluster i of a kind is column first + a N + i of state arrays, with N clusters of the kind, whose first
    column is `first`.

    Parameters
    ----------
    kinds : sequence of ClusterKind
    kernel : {"fastest", "numpy", "numba"}, optional
        See `openmm_exactrb.kernels.twins`.

    Raises
    ------
    ModuleNotFoundError
        If "numba" is asked for and not installed.
    """

    def __init__(self, kinds: Sequence[ClusterKind], kernel: Which = "fastest") -> None:
        self.kinds = tuple(kinds)
        sizes = [kind.particles.size for kind in self.kinds]
        self.first = np.cumsum([0, *sizes], dtype=np.int64)
        #: Particles (M,) and masses (M,) of the columns of a state.
        self.particles: Indices = np.concatenate([np.empty(0, np.int64), *(k.particles.T.ravel() for k in self.kinds)])
        self.mass: Array = np.concatenate([np.empty(0), *(np.repeat(k.masses, len(k.particles)) for k in self.kinds)])
        self._kernel = kernels.twins(kernel).clusters

    def __len__(self) -> int:
        """Return the number of clusters."""
        return sum(len(kind.particles) for kind in self.kinds)

    @property
    def degrees_of_freedom(self) -> int:
        """Coordinates less constraints; motions of the whole System are not subtracted."""
        return sum(kind.freedom * len(kind.particles) for kind in self.kinds)

    def drift(self, state: ClusterState, tau: float) -> ClusterState:
        """Return the state after free motion for a time, of any sign.

        The momentum is projected as `tangent` does before it moves. A cluster with a number that is not finite becomes
        nan, its neighbours are not touched.
        """
        moved = ClusterState(np.empty(state.x.shape), np.empty(state.p.shape))
        for kind, first in zip(self.kinds, self.first.tolist(), strict=False):
            self._kernel.drift(*state, tau, first, len(kind.particles), *kind.graph, *moved)
        return moved

    def tangent(self, state: ClusterState) -> ClusterState:
        """Return the state with the part of the momenta removed that no motion along the constraints has."""
        p = np.empty(state.p.shape)
        for kind, first in zip(self.kinds, self.first.tolist(), strict=False):
            self._kernel.project(*state, first, len(kind.particles), *kind.graph, p)
        return state._replace(p=p)

    def kinetic_energy(self, state: ClusterState) -> float:
        """Return the kinetic energy in kJ/mol of momenta that `tangent` has projected."""
        p = state.p[0]
        square = p * p if len(state.p) == 1 else p * (p + 2.0 * state.p[1])
        return 0.5 * float(np.sum(square / self.mass))

    def misfits(self, state: ClusterState) -> Array:
        """Return abs(r_c) - d_c of all constraints in nm, kind by kind."""
        found = [np.empty(0)]
        for kind, first in zip(self.kinds, self.first.tolist(), strict=False):
            n = len(kind.particles)
            x = state.x[:, :, first : first + kind.particles.size].reshape(len(state.x), 3, -1, n)
            i, j = kind.pairs.T
            r = (x[:, :, i] - x[:, :, j]).sum(axis=0)
            found.append((np.sqrt((r * r).sum(axis=0)) - kind.lengths[:, None]).ravel())
        return np.concatenate(found)

    def fit(self, x: ArrayLike, v: ArrayLike) -> ClusterState:
        """Find the state from positions and velocities of all particles, on the constraints to roundoff.

        Parameters
        ----------
        x, v : (n_particles, 3) array_like
            In nm and nm/ps.

        Raises
        ------
        ValueError
            If numbers are not finite, lengths are further than `MISFIT` from those of the constraints, or places are
            such that a constraint follows from others.
        """
        x, v = np.asarray(x, dtype=np.float64), np.asarray(v, dtype=np.float64)
        for kind in self.kinds:
            _check_places(kind, x[kind.particles], v[kind.particles])
        places, momenta = x[self.particles].T, v[self.particles].T * self.mass
        state = ClusterState(*(np.stack([a, np.zeros(a.shape)]) for a in (places, momenta)))
        for _ in range(_NEWTON):
            state = self.drift(state, 0.0)
        return state

    def positions(self, state: ClusterState, out: Array) -> Array:
        """Write the positions of the clusters' particles into `out` (n_particles, 3)."""
        out[self.particles] = state.x[0].T
        return out

    def velocities(self, state: ClusterState, out: Array) -> Array:
        """Write the velocities of the clusters' particles into `out` (n_particles, 3)."""
        out[self.particles] = (state.p[0] / self.mass).T
        return out

    def forces(self, forces: Array) -> Array:
        """Return the forces (3, M) on the columns of a state from those on all particles (n_particles, 3)."""
        return np.ascontiguousarray(forces[self.particles].T)

    def lost(self, state: ClusterState) -> NDArray[np.bool_]:
        """Tell which columns of a state have numbers that are not finite, (M,)."""
        finite = np.isfinite(state.x[0]) & np.isfinite(state.p[0])
        return np.asarray(~finite.all(axis=0))


def find_clusters(masses: ArrayLike, pairs: ArrayLike, lengths: ArrayLike, kernel: Which = "fastest") -> Clusters:
    """Sort constraints into clusters, and clusters into kinds.

    Parameters
    ----------
    masses : (n_particles,) array_like
        In amu.
    pairs : (n_constraints, 2) array_like
        Particles of each constraint.
    lengths : (n_constraints,) array_like
        In nm.
    kernel : {"fastest", "numpy", "numba"}, optional

    Raises
    ------
    ValueError
        As `ClusterKind`.
    """
    masses, lengths = np.asarray(masses, dtype=np.float64), np.asarray(lengths, dtype=np.float64)
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    found: dict[bytes, list[tuple[Indices, Indices, Array]]] = {}
    for members, of_cluster in _connected(len(masses), pairs):
        order = _canonical(members, pairs[of_cluster], lengths[of_cluster], masses)
        ends = np.sort(np.argsort(order)[np.searchsorted(members, pairs[of_cluster])], axis=1)
        by_ends = np.lexsort(ends.T)
        ends, d = ends[by_ends], lengths[of_cluster][by_ends]
        key = b"/".join(a.tobytes() for a in (masses[members[order]], ends, d))
        found.setdefault(key, []).append((members[order], ends, d))
    return Clusters(
        [
            ClusterKind(np.stack([particles for particles, _, _ in same]), masses[same[0][0]], *same[0][1:])
            for same in found.values()
        ],
        kernel,
    )


def _canonical(members: Indices, pairs: Indices, lengths: Array, masses: Array) -> Indices:
    """Return an order of members that is the same for stars with the same rays; else by their numbers."""
    ends, degree = np.unique(pairs, return_counts=True)
    if len(pairs) != len(members) - 1 or degree.max() != len(pairs):
        return np.arange(len(members))
    centre = ends[np.argmax(degree)]
    length = np.zeros(len(members))
    length[np.searchsorted(members, np.where(pairs[:, 0] == centre, pairs[:, 1], pairs[:, 0]))] = lengths
    order: Indices = np.lexsort((members, length, masses[members], members != centre))
    return order


def _connected(n: int, pairs: Indices) -> Iterable[tuple[Indices, Indices]]:
    """Yield the members of each cluster, in ascending order, and the numbers of its constraints."""
    label = np.arange(n)
    while True:  # the smallest number spreads, twice as far each time
        least = label.copy()
        np.minimum.at(least, pairs[:, 0], label[pairs[:, 1]])
        np.minimum.at(least, pairs[:, 1], label[pairs[:, 0]])
        least = least[least]
        if np.array_equal(least, label):
            break
        label = least
    by_cluster = np.argsort(label[pairs[:, 0]], kind="stable")
    heads, starts = np.unique(label[pairs[by_cluster, 0]], return_index=True)
    for of_cluster in np.split(by_cluster, starts[1:]) if len(heads) else []:
        yield np.unique(pairs[of_cluster]), of_cluster


def _check_places(kind: ClusterKind, x: Array, v: Array) -> None:
    bad = ~(np.isfinite(x).all(axis=(1, 2)) & np.isfinite(v).all(axis=(1, 2)))
    if bad.any():
        raise ValueError(
            f"positions or velocities of {kind.name(int(np.argmax(bad)))} are not finite: set finite ones before the "
            "next step"
        )
    distance = np.linalg.norm(x[:, kind.pairs[:, 0]] - x[:, kind.pairs[:, 1]], axis=2)
    misfit = np.abs(distance - kind.lengths).max(axis=1)
    if (misfit > MISFIT).any():
        worst = int(np.argmax(misfit))
        raise ValueError(
            f"a constraint of {kind.name(worst)} is missed by {misfit[worst]:.2g} nm, more than {MISFIT:g} nm: call "
            "context.applyConstraints(1e-6) after setPositions, and do not let a periodic box split molecules"
        )
    independence, constraint = kind.most_dependent(x)
    if (independence < INDEPENDENT).any():
        worst = int(np.argmin(independence))
        i, j = kind.particles[worst, kind.graph.pairs[constraint[worst]]]
        raise ValueError(
            f"{kind.name(worst).capitalize()} is at a singular place, where the constraint of particles {i} and {j} "
            "follows from the others, as for three particles of a triangle on a line: move them, or remove it"
        )
