"""Inner steps of multiple time stepping in numpy: drifts and kicks by bonded forces."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from openmm_exactrb.kernels.plain import bonded, clusters, exact
from openmm_exactrb.kernels.plain.bodies import advance as add_scaled
from openmm_exactrb.kernels.plain.bodies import collect, place
from openmm_exactrb.kernels.records import Bodies, Graph, Particles, Terms
from openmm_exactrb.mathematics.compensated import add
from openmm_exactrb.support.types import Array, Indices


def advance(
    kicks: Indices,
    parts: Array,
    t: float,
    hottest: float,
    known: int,
    bodies: Bodies,
    particles: Particles,
    kinds: Indices,
    graph: Graph,
    terms: Terms,
    R: Array,
    P: Array,
    q: Array,
    m: Array,
    x: Array,
    forces: Array,
    total: Array,
    torque: Array,
    found: Array,
) -> None:
    """Perform a sequence of kicks, where `kicks` (k,) is nonzero, and drifts, over `parts` (k,) of the time t.

    The arguments are those of the compiled function of this name.
    """
    found[:] = 0.0
    for kick, part in zip(kicks, parts * t, strict=True):
        if not kick:
            _drift(R, P, q, m, part, bodies, kinds, graph)
            known = 0
            continue
        if not known:
            place(R[0], q[0], particles, x)
            bonded.forces(x, terms, forces)
            collect(q[0], particles, forces, total, torque)
            found[0] += 1.0
            known = 1
        add_scaled(P, total, part, P)
        add_scaled(m, torque, part, m)
        twice = (P[0] ** 2 / bodies.mass).sum() + (m[0] ** 2 / bodies.moments).sum()
        found[1] = 0.5 * twice / P.shape[2]
        if not found[1] <= hottest:
            return


def _drift(R: Array, P: Array, q: Array, m: Array, t: float, bodies: Bodies, kinds: Indices, graph: Graph) -> None:
    """Advance bodies, single atoms and clusters by free motion."""
    if m.size:
        exact.advance(bodies.constants, q, m, np.array([t]), q, m)
    for single in (slice(0, kinds[0, 0]), slice(kinds[-1, 0], None)):
        R[:, :, single] = add(R[:, :, single], t * (P[0, :, single] / bodies.mass[single]))
    for first, count, own in _clusters(kinds, graph):
        clusters.advance(R, P, t, 1, first, count, own, R, P)


def _clusters(kinds: Indices, graphs: Graph) -> Iterator[tuple[int, int, Graph]]:
    """Yield the first column of each kind, its number of clusters, and its part of the concatenated graphs."""
    for (first, count, n, m, e, r, s, p), (_, _, n1, m1, e1, r1, s1, p1) in pairwise(kinds):
        of_atoms, of_pairs, of_entries, of_products = slice(n, n1), slice(m, m1), slice(e, e1), slice(p, p1)
        yield (
            first,
            count,
            Graph(
                graphs.inverse[of_atoms],
                graphs.pairs[of_pairs],
                graphs.lengths[of_pairs],
                graphs.weights[of_entries],
                graphs.rows[r:r1],
                graphs.columns[of_entries],
                graphs.starts[s:s1],
                graphs.left[of_products],
                graphs.right[of_products],
            ),
        )
