"""Clusters of particles that distance constraints hold together without making them rigid.

They move freely along the geodesics of their constraints: `Clusters.drift` follows these to roundoff, for any time, by
the power series of `openmm_exactrb.kernels.plain.clusters`. Any graph of constraints will do, as long as none of them
follows from the others; its matrix is factorised along a fixed sparse pattern, so that the cost of a tree grows with
the number of constraints and not with its cube.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from openmm_exactrb import kernels
from openmm_exactrb.motion.cluster_kind import INDEPENDENT, ClusterKind

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Which = Literal["fastest", "numpy", "numba"]

#: Constraints further than this from their lengths, in nm, are refused.
MISFIT = 1e-4
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
        self._twins = kernels.twins(kernel)

    def __len__(self) -> int:
        """Return the number of clusters."""
        return sum(len(kind.particles) for kind in self.kinds)

    @property
    def degrees_of_freedom(self) -> int:
        """Coordinates less constraints; motions of the whole System are not subtracted."""
        return sum(kind.freedom * len(kind.particles) for kind in self.kinds)

    def columns(self) -> Iterable[tuple[ClusterKind, Indices]]:
        """Yield the kinds and, for each, the columns (N, n) of the atoms of its clusters."""
        for kind, first in zip(self.kinds, self.first.tolist(), strict=False):
            count, n = kind.particles.shape
            yield kind, first + np.arange(count)[:, None] + count * np.arange(n)

    def chosen(self, atoms: NDArray[np.bool_], number: Indices) -> Clusters:
        """Return the clusters of some columns (M,), whose particles get other numbers."""
        kinds = []
        for kind, columns in self.columns():
            own = atoms[columns].all(axis=1)
            if own.any():
                kinds.append(replace(kind, particles=number[kind.particles[own]]))
        return Clusters(kinds)

    def drift(self, state: ClusterState, tau: float) -> ClusterState:
        """Return the state after free motion for a time, of any sign.

        The momentum is projected as `tangent` does before it moves. A cluster with a number that is not finite becomes
        nan, its neighbours are not touched.
        """
        return self._advanced(state, tau, True)

    def tangent(self, state: ClusterState) -> ClusterState:
        """Return the state with the part of the momenta removed that no motion along the constraints has."""
        return state._replace(p=self._advanced(state, 0.0, False).p)

    def _advanced(self, state: ClusterState, tau: float, moves: bool) -> ClusterState:
        """Return the state after free motion for a time, or with momenta that are projected alone."""
        after = ClusterState(np.empty(state.x.shape), np.empty(state.p.shape))
        for kind, first in zip(self.kinds, self.first.tolist(), strict=False):
            self._twins.clusters.advance(*state, tau, moves, first, len(kind.particles), *kind.graph, *after)
        return after

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
    refuse_singular(kind, x)


def refuse_singular(kind: ClusterKind, x: Array, chosen: NDArray[np.bool_] | None = None) -> None:
    """Refuse places (N, n, 3) of clusters, or of some (N,) of them, where a constraint follows from the others.

    Raises
    ------
    ValueError
        If there is one.
    """
    independence, constraint = kind.most_dependent(x)
    if chosen is not None:
        independence = np.where(chosen, independence, 1.0)
    if (independence < INDEPENDENT).any():
        worst = int(np.argmin(independence))
        i, j = kind.particles[worst, kind.graph.pairs[constraint[worst]]]
        raise ValueError(
            f"{kind.name(worst).capitalize()} is at a singular place, where the constraint of particles {i} and {j} "
            "follows from the others, as for three particles of a triangle on a line: move them, or remove it"
        )
