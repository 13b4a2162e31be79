"""A kind of clusters of particles that distance constraints hold together: its graph, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.kernels.graph import Graph, factor
from openmm_exactrb.mechanics.elimination import eliminated

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Constraints that a cluster may have.
LARGEST = 3000
# Constraints less independent than this, as `ClusterKind.most_dependent` tells, are refused.
_INDEPENDENT = 1e-9


@dataclass(frozen=True)
class ClusterKind:
    """Clusters of one graph, with the same masses and lengths.

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
    """

    particles: Indices
    masses: Array
    pairs: Indices
    lengths: Array

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a cluster."""
        return 3 * len(self.masses) - len(self.pairs)

    @cached_property
    def graph(self) -> Graph:
        """What the kernels take, with constraints in an order that keeps the factor sparse."""
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

    @cached_property
    def coupling(self) -> Array:
        """The matrix B_cd = sum_a s_ca s_da / m_a (m, m)."""
        each = np.arange(len(self.pairs))
        return self._coupling(each[:, None], each)

    def _coupling(self, c: Indices, d: Indices) -> Array:
        """Return B_cd of constraints c and d."""
        (i, j), inverse = self.pairs.T, 1.0 / self.masses
        first = np.where(i[c] == i[d], 1.0, 0.0) - (i[c] == j[d])
        second = np.where(j[c] == j[d], 1.0, 0.0) - (j[c] == i[d])
        coupling: Array = first * inverse[i[c]] + second * inverse[j[c]]
        return coupling

    def _neighbours(self) -> list[set[int]]:
        """Return for each constraint the others that have an atom with it in common."""
        of_atom: list[set[int]] = [set() for _ in self.masses]
        for c, ends in enumerate(self.pairs.tolist()):
            for atom in ends:
                of_atom[atom].add(c)
        return [(of_atom[i] | of_atom[j]) - {c} for c, (i, j) in enumerate(self.pairs.tolist())]

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
            inverse_roots = np.array(factor(self.graph, r))[diagonal]
            rest = 1.0 / (inverse_roots * inverse_roots * self.graph.weights[diagonal, None])
        rest = np.where(np.isfinite(rest), rest, 0.0)
        return rest.min(axis=0), rest.argmin(axis=0)

    def refuse_unkept(self) -> None:
        """Refuse constraints that cannot be kept wherever members are, as three random places tell.

        Raises
        ------
        ValueError
            If a member has no mass, a length is not positive, there are too many constraints, or one follows from the
            others.
        """
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
        if len(self.pairs) > LARGEST:
            raise ValueError(
                f"{len(self.pairs)} constraints hold {self.name(0)} together, more than {LARGEST}: create the System "
                "with constraints=HBonds, which constrains hydrogens only"
            )
        places = np.random.default_rng(0).standard_normal((3, len(self.masses), 3))
        independence, constraint = self.most_dependent(places)
        if independence.max() < _INDEPENDENT:
            i, j = self.particles[0, self.graph.pairs[constraint[np.argmax(independence)]]]
            raise ValueError(
                f"the constraint of particles {i} and {j} follows from the others of {self.name(0)}: remove it"
            )

    def refuse_singular(self, x: Array, chosen: NDArray[np.bool_]) -> None:
        """Refuse places (N, n, 3), of the chosen ones (N,), where a constraint follows from the others; ValueError."""
        independence, constraint = self.most_dependent(x)
        independence = np.where(chosen, independence, 1.0)
        if (independence < _INDEPENDENT).any():
            worst = int(np.argmin(independence))
            i, j = self.particles[worst, self.graph.pairs[constraint[worst]]]
            raise ValueError(
                f"{self.name(worst).capitalize()} is at a singular place, where the constraint of particles {i} and "
                f"{j} follows from the others, as for three particles of a triangle on a line: move them, or remove it"
            )
