"""Clusters of particles with distance constraints that do not make them rigid.

Without forces, these particles move along the geodesics of their constraints. `Clusters.drift` follows a geodesic to
roundoff, over any time, with the power series of `openmm_exactrb.constraints.geodesics`, by the library if there is
one. Any graph of constraints is supported; redundant constraints are omitted if they are consistent. The matrix of the
constraints is factorised with a fixed sparse pattern, so that the cost for a tree is linear in the number of
constraints.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.constraints import geodesics
from openmm_exactrb.constraints.elimination import Graph, eliminated
from openmm_exactrb.constraints.tables import Group, arrays
from openmm_exactrb.library import functions
from openmm_exactrb.mathematics.compensated import exactly, quotient, times
from openmm_exactrb.support.messages import listed
from openmm_exactrb.support.types import Array, Indices

#: The largest number of constraints in a cluster.
LARGEST = 3000
# Constraints whose independence, as defined by `ClusterKind.most_dependent`, is below this number raise an error.
_INDEPENDENT = 1e-9


@dataclass(frozen=True)
class ClusterKind:
    """Clusters with the same graph of constraints, the same masses and the same lengths."""

    particles: Indices  #: the n particles of each of the N clusters (N, n)
    masses: Array  #: masses in amu (n,)
    pairs: Indices  #: the two members of each constraint, by their indices in `particles` (m, 2)
    lengths: Array  #: lengths in nm (m,)
    #: The members (k, 2) and lengths (k,) of constraints that follow from the others, and thus remove no degree of
    #: freedom.
    implied: Indices = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    implied_lengths: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def freedom(self) -> int:
        """Number of degrees of freedom of a cluster."""
        return 3 * len(self.masses) - len(self.pairs)

    @cached_property
    def graph(self) -> Graph:
        """The graph for the kernels, with constraints in an order that keeps their Cholesky factor sparse."""
        order, rows, columns, starts, left, right = eliminated(self._neighbours())
        row_of = np.repeat(np.arange(len(order)), np.diff(rows))
        return Graph(
            1.0 / self.masses,
            np.ascontiguousarray(self.pairs[order]),
            self.lengths[order],
            self._coupling(order[row_of], order[columns]),
            rows,
            columns,
            starts,
            left,
            right,
        )

    def _coupling(self, c: Indices, d: Indices) -> Array:
        """Return entries B_cd = sum_a s_ca s_da / m_a of the matrix of constraints; s_ca is the sign of atom a in c."""
        (i, j), inverse = self.pairs.T, 1.0 / self.masses
        first = np.where(i[c] == i[d], 1.0, 0.0) - (i[c] == j[d])
        second = np.where(j[c] == j[d], 1.0, 0.0) - (j[c] == i[d])
        coupling: Array = first * inverse[i[c]] + second * inverse[j[c]]
        return coupling

    def _neighbours(self) -> list[set[int]]:
        """Return, for each constraint, the set of other constraints that share an atom with it."""
        of_atom: list[set[int]] = [set() for _ in self.masses]
        for c, ends in enumerate(self.pairs.tolist()):
            for atom in ends:
                of_atom[atom].add(c)
        return [(of_atom[i] | of_atom[j]) - {c} for c, (i, j) in enumerate(self.pairs.tolist())]

    def name(self, cluster: int) -> str:
        """Return a description of a cluster that lists its particles."""
        return f"the cluster of particles {listed(self.particles[cluster])}"

    def missed(self, x: Array) -> Array:
        """Return the errors (N, m + k) of constrained lengths at positions (N, n, 3), in nm, implied ones last."""
        i, j = np.concatenate([self.pairs, self.implied]).T
        apart = np.linalg.norm(x[:, i] - x[:, j], axis=2)
        return np.asarray(np.abs(apart - np.concatenate([self.lengths, self.implied_lengths])))

    def most_dependent(self, x: Array) -> tuple[Array, Indices]:
        """Return the independence of the constraints at positions (N, n, 3), and the most dependent constraint.

        Independence (N,) is the smallest squared norm, in the mass metric, of the part of a constraint's gradient that
        is orthogonal to the gradients of the preceding constraints in `graph`. Independence is 0 if the constraint
        follows from the preceding constraints. The most dependent constraint (N,) is given by its index in `graph`.
        """
        r = (x[:, self.graph.pairs[:, 0]] - x[:, self.graph.pairs[:, 1]]).transpose(2, 1, 0)
        r /= np.maximum(np.sqrt((r * r).sum(axis=0)), np.finfo(float).tiny)
        diagonal = self.graph.rows[1:] - 1
        with np.errstate(all="ignore"):
            inverse_roots = np.array(geodesics.factor(self.graph, r))[diagonal]
            rest = 1.0 / (inverse_roots * inverse_roots * self.graph.weights[diagonal, None])
        rest = np.where(np.isfinite(rest), rest, 0.0)
        return rest.min(axis=0), rest.argmin(axis=0)

    def independent(self) -> NDArray[np.bool_]:
        """Return a mask (m,) of the constraints that do not follow from preceding constraints at generic positions.

        Redundant constraints occur only among members that each have at least four constraints to one another. A member
        with fewer constraints can always be positioned, and is ignored.
        """
        several = np.ones(len(self.masses), dtype=np.bool_)
        few = several
        while few.any():
            among = several[self.pairs].all(axis=1)
            few = several & (np.bincount(self.pairs[among].ravel(), minlength=len(several)) < 4)
            several &= ~few
        kept, x = np.ones(len(self.pairs), dtype=np.bool_), _anywhere(len(several))[0]
        found = np.zeros((0, x.size))
        for c in np.flatnonzero(among):
            i, j = self.pairs[c]
            gradient = np.zeros(x.shape)
            gradient[i] = (x[i] - x[j]) / np.linalg.norm(x[i] - x[j])
            gradient[j] = -gradient[i]
            rest = gradient.ravel()
            for _ in range(2):  # the projection is repeated to reduce roundoff
                rest = rest - found.T @ (found @ rest)
            kept[c] = rest @ rest >= _INDEPENDENT
            if kept[c]:
                found = np.vstack([found, rest / np.linalg.norm(rest)])
        return kept

    def check_kept(self) -> None:
        """Raise ValueError if a member is massless, a length is not positive, or there are too many constraints.

        The error is also raised if a constraint follows from the others at generic positions, which is tested for three
        random configurations.
        """
        bad = ~((self.masses > 0.0) & np.isfinite(self.masses))
        if bad.any():
            raise ValueError(
                f"particle {self.particles[0, np.argmax(bad)]} of {self.name(0)} has the mass "
                f"{self.masses[np.argmax(bad)]:g}, but a constraint can join only particles with mass: set the mass "
                "of this particle, or remove the constraint"
            )
        bad = ~((self.lengths > 0.0) & np.isfinite(self.lengths)) | (self.pairs[:, 0] == self.pairs[:, 1])
        if bad.any():
            i, j = self.particles[0, self.pairs[np.argmax(bad)]]
            raise ValueError(
                f"the constraint of {self.lengths[np.argmax(bad)]:g} nm between particles {i} and {j} is invalid, "
                "because a constraint needs two different particles and a positive length: correct or remove this "
                "constraint"
            )
        if len(self.pairs) > LARGEST:
            raise ValueError(
                f"{len(self.pairs)} constraints hold {self.name(0)} together, but at most {LARGEST} are supported: "
                "create the System with constraints=HBonds, which constrains only bonds to hydrogen"
            )
        independence, constraint = self.most_dependent(_anywhere(len(self.masses)))
        if independence.max() < _INDEPENDENT:
            i, j = self.particles[0, self.graph.pairs[constraint[np.argmax(independence)]]]
            raise ValueError(
                f"the constraint between particles {i} and {j} follows from the others of {self.name(0)}: remove this "
                "constraint"
            )

    def check_singular(self, x: Array, chosen: NDArray[np.bool_]) -> None:
        """Raise ValueError if a constraint of a cluster in the mask (N,) is redundant at the positions (N, n, 3)."""
        independence, constraint = self.most_dependent(x)
        independence = np.where(chosen, independence, 1.0)
        if (independence < _INDEPENDENT).any():
            worst = int(np.argmin(independence))
            i, j = self.particles[worst, self.graph.pairs[constraint[worst]]]
            raise ValueError(
                f"{self.name(worst)} is in a singular configuration, where the constraint between particles {i} and "
                f"{j} follows from the others: if its particles are on a line or in a plane by chance, set other "
                "positions; if a part of the molecule is always straight or flat, remove this constraint, or make "
                "the molecule rigid by constraining all distances or naming the molecule in bodies="
            )


class ClusterState(NamedTuple):
    """Positions (nm) and momenta (amu nm/ps) of the atoms of all clusters, as double-doubles (2, 3, M)."""

    x: Array
    p: Array


class Clusters:
    """Clusters of several kinds as one set of arrays.

    Atom a of cluster i of a kind is in column first + a N + i of the state arrays. Here N is the number of clusters of
    the kind and `first` is its first column.
    """

    def __init__(self, kinds: Sequence[ClusterKind]) -> None:
        self.kinds = tuple(kinds)
        sizes = [kind.particles.size for kind in self.kinds]
        self.first = np.cumsum([0, *sizes], dtype=np.int64)
        #: Particles (M,) and masses (M,) of the columns of a state.
        self.particles: Indices = np.concatenate([np.empty(0, np.int64), *(k.particles.T.ravel() for k in self.kinds)])
        self.mass: Array = np.concatenate([np.empty(0), *(np.repeat(k.masses, len(k.particles)) for k in self.kinds)])

    def __len__(self) -> int:
        """Return the number of clusters."""
        return sum(len(kind.particles) for kind in self.kinds)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates minus number of constraints; overall motions of the System are not subtracted."""
        return sum(kind.freedom * len(kind.particles) for kind in self.kinds)

    def columns(self) -> Iterable[tuple[ClusterKind, Indices]]:
        """Yield each kind with the columns (N, n) of the atoms of its clusters."""
        for kind, first in zip(self.kinds, self.first.tolist(), strict=False):
            count, n = kind.particles.shape
            yield kind, first + np.arange(count)[:, None] + count * np.arange(n)

    def chosen(self, atoms: NDArray[np.bool_], number: Indices) -> Clusters:
        """Return the clusters whose atoms are selected by a mask (M,), with particles renumbered by `number`."""
        kinds = []
        for kind, columns in self.columns():
            own = atoms[columns].all(axis=1)
            if own.any():
                kinds.append(replace(kind, particles=number[kind.particles[own]]))
        return Clusters(kinds)

    def drift(self, state: ClusterState, tau: float) -> ClusterState:
        """Return the state after free motion over a time tau (ps) of any sign.

        Momenta are first projected, as by `tangent`. All results of a cluster with a non-finite number are nan; other
        clusters are not affected.
        """
        return self._advanced(state, tau, moves=True)

    def tangent(self, state: ClusterState) -> ClusterState:
        """Return the state with momenta projected onto the constraints."""
        return state._replace(p=self._advanced(state, 0.0, moves=False).p)

    def _advanced(self, state: ClusterState, tau: float, moves: bool) -> ClusterState:
        """Return the state after free motion over a time or, unless `moves`, only with projected momenta."""
        if self.kinds and moves == (tau != 0.0) and functions.available():
            return self._by_library(state, tau)
        return self.advanced_in_numpy(state, tau, moves)  # also corrects lengths, if clusters move over no time

    def advanced_in_numpy(self, state: ClusterState, tau: float, moves: bool) -> ClusterState:
        """Return the result of `_advanced`, computed by `geodesics`."""
        after = ClusterState(np.empty(state.x.shape), np.empty(state.p.shape))
        for kind, first in zip(self.kinds, self.first.tolist(), strict=False):
            geodesics.advance(*state, tau, moves, first, len(kind.particles), kind.graph, *after)
        return after

    def _by_library(self, state: ClusterState, tau: float) -> ClusterState:
        """Return the state after free motion over a time, or only with projected momenta for ``tau=0.0``."""
        sums = state if len(state.x) == 2 else ClusterState(*map(exactly, (state.x[0], state.p[0])))
        after = ClusterState(np.empty(sums.x.shape), np.empty(sums.p.shape))
        with np.errstate(all="ignore"):  # what is not finite stays in its own cluster
            # The kernel's arrays are (M, 3, 2), ordered by cluster, and velocities have the place of momenta.
            x, v = (np.ascontiguousarray(a[:, :, self._order].T) for a in (sums.x, quotient(sums.p, self.mass)))
            functions.call("move_clusters", len(self), float(tau), *self._tables, x, v)
            after.p[:, :, self._order] = times(self.mass[self._order], (v[..., 0].T, v[..., 1].T))
        after.x[:, :, self._order] = x.T
        return ClusterState(*(a[: len(state.x)] for a in after))

    @cached_property
    def _order(self) -> Indices:
        """The columns of a state (M,), ordered by cluster."""
        return np.concatenate([np.empty(0, np.int64), *(columns.ravel() for _, columns in self.columns())])

    @cached_property
    def _tables(self) -> tuple[NDArray[Any], ...]:
        """The kernel's tables of clusters and graphs, inverse masses and lengths."""
        sizes = np.repeat(*np.array([kind.particles.shape[::-1] for kind in self.kinds]).T)
        groups, first = list[tuple[Group, Indices]](), 0
        for kind in self.kinds:
            groups.append((Group(kind.particles, kind.graph), first + np.arange(len(kind.particles))))
            first += len(kind.particles)
        made, _ = arrays(np.cumsum([0, *sizes])[:-1], sizes, groups, shared=True)
        return made["clusters"], made["graphs"], 1.0 / self.mass[self._order], made["lengths"]


def _anywhere(n: int) -> Array:
    """Return three random configurations (3, n, 3) of n members."""
    return np.random.default_rng(0).standard_normal((3, n, 3))


def sorted_into_kinds(groups: Iterable[ClusterKind]) -> Clusters:
    """Return clusters grouped into kinds; stars that differ only in the order of their atoms form one kind.

    The constraints of a star join one atom to each of the others. Within a kind, clusters are sorted by their first
    particles. A ValueError is raised if constraints cannot be satisfied; see `ClusterKind.check_kept`.
    """
    kinds: dict[bytes, list[ClusterKind]] = {}
    for group in map(_in_canonical_order, groups):
        key = b"/".join(
            a.tobytes() for a in (group.masses, group.pairs, group.lengths, group.implied, group.implied_lengths)
        )
        kinds.setdefault(key, []).append(group)
    joined = []
    for same in kinds.values():
        particles = np.concatenate([kind.particles for kind in same])
        joined.append(replace(same[0], particles=particles[np.argsort(particles.min(axis=1))]))
        joined[-1].check_kept()
    return Clusters(joined)


def _in_canonical_order(group: ClusterKind) -> ClusterKind:
    """Return clusters with the members of a star in canonical order: the centre, then the rays by mass and length.

    The order of the members of other clusters is unchanged. Constraints are sorted by their members.
    """
    m, n = len(group.pairs), len(group.masses)
    order, degree = np.arange(n), np.bincount(group.pairs.ravel(), minlength=n)
    if m == n - 1 and degree.max() == m:
        centre, length = np.argmax(degree), np.zeros(n)
        length[np.where(group.pairs[:, 0] == centre, group.pairs[:, 1], group.pairs[:, 0])] = group.lengths
        order = np.lexsort((length, group.masses, order != centre))
    pairs = np.sort(np.argsort(order)[group.pairs], axis=1)
    by_ends = np.lexsort(pairs.T)
    return replace(
        group,
        particles=group.particles[:, order],
        masses=group.masses[order],
        pairs=pairs[by_ends],
        lengths=group.lengths[by_ends],
    )
