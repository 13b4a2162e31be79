"""The inner steps of a drift, performed by one call of a compiled kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from openmm_exactrb import kernels
from openmm_exactrb.kernels.records import Bodies, Graph
from openmm_exactrb.mechanics.clusters import Clusters
from openmm_exactrb.mechanics.divergence import DivergenceCheck
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.multiple_time_steps.compiled_forces import BondedForces
from openmm_exactrb.rotors.exact import constants
from openmm_exactrb.schemes.sequence import Sequence, repeated
from openmm_exactrb.substeps import KICK
from openmm_exactrb.support.types import Array, Indices


class CompiledInnerSteps:
    """The drift of `inner_drift.inner_steps`, performed with the exact rotor and compiled bonded forces."""

    def __init__(
        self,
        forces: BondedForces,
        sequence: Sequence,
        repetitions: Callable[[float], int],
        divergence: DivergenceCheck,
    ) -> None:
        self._forces, self._sequence, self._repetitions, self._divergence = forces, sequence, repetitions, divergence
        bodies = forces.positions.bodies
        moments = np.ascontiguousarray(bodies.inertia.T)
        own = Bodies(bodies.mass, moments, constants(moments))
        self._constants = own, bodies.particles, *_packed(bodies.clusters, bodies.n_turning), forces.terms
        self._sequences: dict[int, tuple[Indices, Array]] = {}
        self._advance = kernels.load("inner_steps").advance

    def __call__(self, state: State, tau: float) -> State:
        """Return the state after a drift over tau (ps); raise IntegrationError if the drift diverges."""
        forces, n = self._forces, self._repetitions(tau)
        if n not in self._sequences:
            self._sequences[n] = _as_arrays(repeated(self._sequence, n))
        kicks, parts = self._sequences[n]
        x, known = forces.positions.particles, forces.known
        total, torque = known or (np.empty_like(state.P[0]), np.empty_like(state.m[0]))
        after, found = State(*(a.copy() for a in state)), np.empty(2)
        self._advance(
            kicks,
            parts,
            tau / n,
            self._divergence.hottest,
            known is not None,
            *self._constants,
            *after,
            x,
            np.empty_like(x),
            total,
            torque,
            found,
        )
        self._divergence.judge_inner_steps(float(found[1]))
        forces.moved(int(found[0]), (total, torque) if kicks[-1] else None)
        return after


def _as_arrays(sequence: Sequence) -> tuple[Indices, Array]:
    """Return a mask of the substeps that are kicks, and the fractions of all substeps."""
    kicks = np.array([substep == KICK for substep, _ in sequence], dtype=np.int64)
    return kicks, np.array([part for _, part in sequence])


def _packed(clusters: Clusters, first: int) -> tuple[Indices, Graph]:
    """Return the kernel's table of the kinds of clusters, from column `first` on, and their concatenated graphs."""
    graphs = [kind.graph for kind in clusters.kinds]
    begins = [(len(g.inverse), len(g.pairs), len(g.columns), len(g.rows), len(g.starts), len(g.left)) for g in graphs]
    places = np.zeros((len(graphs) + 1, 8), dtype=np.int64)
    places[:, 0] = first + clusters.first
    places[:-1, 1] = [len(kind.particles) for kind in clusters.kinds]
    places[1:, 2:] = np.cumsum(np.array(begins, dtype=np.int64).reshape(-1, 6), axis=0)
    return places, Graph(*map(np.concatenate, zip(_NONE, *graphs, strict=True)))


# A graph without constraints.
_NONE = Graph(
    np.zeros(0),
    np.zeros((0, 2), dtype=np.int64),
    *(np.zeros(0), np.zeros(0)),
    *(np.zeros(0, dtype=np.int64) for _ in range(5)),
)
