"""Clusters of particles that distance constraints hold together without making them rigid.

They move freely along the geodesics of their constraints: `Clusters.drift` follows these to roundoff, for any time, by
the power series of `openmm_exactrb.kernels.compiled.clusters`, which needs numba. Any graph of constraints will do, as
long as none of them follows from the others; its matrix is factorised along a fixed sparse pattern, so that the cost of
a tree grows with the number of constraints and not with its cube.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb import kernels
from openmm_exactrb.mechanics.cluster_kind import ClusterKind

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class ClusterState(NamedTuple):
    """Places and momenta of the atoms of all clusters, as sums high + low.

    Attributes
    ----------
    x, p : (2, 3, M) arrays
        In nm and amu nm/ps.
    """

    x: Array
    p: Array


class Clusters:
    """Clusters of several kinds as one set of arrays.

    Atom a of cluster i of a kind is column first + a N + i of state arrays, with N clusters of the kind, whose first
    column is `first`.

    Parameters
    ----------
    kinds : sequence of ClusterKind

    Raises
    ------
    ModuleNotFoundError
        If there are any, and numba is not installed.
    """

    def __init__(self, kinds: Sequence[ClusterKind]) -> None:
        self.kinds = tuple(kinds)
        sizes = [kind.particles.size for kind in self.kinds]
        self.first = np.cumsum([0, *sizes], dtype=np.int64)
        #: Particles (M,) and masses (M,) of the columns of a state.
        self.particles: Indices = np.concatenate([np.empty(0, np.int64), *(k.particles.T.ravel() for k in self.kinds)])
        self.mass: Array = np.concatenate([np.empty(0), *(np.repeat(k.masses, len(k.particles)) for k in self.kinds)])
        if kinds:
            kernels.require("flexible molecules with constraints")
            self._advance = kernels.load("clusters", "numba").advance

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
            self._advance(*state, tau, moves, first, len(kind.particles), *kind.graph, *after)
        return after


def sorted_into_kinds(groups: Iterable[ClusterKind]) -> Clusters:
    """Return clusters sorted into kinds: equal stars are of one kind, in whatever order their particles are numbered.

    Raises
    ------
    ValueError
        If constraints cannot be kept: see `ClusterKind.refuse_unkept`.
    """
    kinds: dict[bytes, list[ClusterKind]] = {}
    for group in map(_in_canonical_order, groups):
        key = b"/".join(a.tobytes() for a in (group.masses, group.pairs, group.lengths))
        kinds.setdefault(key, []).append(group)
    joined = [replace(same[0], particles=_by_number([kind.particles for kind in same])) for same in kinds.values()]
    for kind in joined:
        kind.refuse_unkept()
    return Clusters(joined)


def _in_canonical_order(group: ClusterKind) -> ClusterKind:
    """Return clusters with their members in order: of a star the centre, then rays by mass and length; else as before.

    Constraints come in the order of their members.
    """
    m, n = len(group.pairs), len(group.masses)
    order, degree = np.arange(n), np.bincount(group.pairs.ravel(), minlength=n)
    if m == n - 1 and degree.max() == m:
        centre, length = np.argmax(degree), np.zeros(n)
        length[np.where(group.pairs[:, 0] == centre, group.pairs[:, 1], group.pairs[:, 0])] = group.lengths
        order = np.lexsort((length, group.masses, order != centre))
    pairs = np.sort(np.argsort(order)[group.pairs], axis=1)
    by_ends = np.lexsort(pairs.T)
    return ClusterKind(group.particles[:, order], group.masses[order], pairs[by_ends], group.lengths[by_ends])


def _by_number(particles: Sequence[Indices]) -> Indices:
    """Return the clusters (N, n) of several groups in the order of their first particles."""
    joined = np.concatenate(particles)
    return joined[np.argsort(joined.min(axis=1))]
