"""Inner steps of multiple time stepping, compiled: drifts and kicks by bonded forces in one call.

Bonded atoms are few compared with the solvent, so that calls from Python would take longer than the arithmetic.
"""

import numpy as np

from openmm_exactrb.kernels.build import compiled, inner
from openmm_exactrb.kernels.compiled import bonded, clusters, exact
from openmm_exactrb.kernels.compiled.bodies import advance as add_scaled
from openmm_exactrb.kernels.compiled.bodies import collect, place
from openmm_exactrb.kernels.compiled.formulas import two_sum
from openmm_exactrb.kernels.records import Bodies, Graph, Particles, Terms


@inner
def _move_single(R, P, mass, first, last, t):
    """Advance the centres of the bodies from `first` to `last` - 1 by free motion."""
    for row in range(3):
        for i in range(first, last):
            R[0, row, i], R[1, row, i] = two_sum(R[0, row, i], t * (P[0, row, i] / mass[i]) + R[1, row, i])


@inner
def _mean_energy(P, m, mass, moments):
    """Return the kinetic energy per body (kJ/mol)."""
    energy = 0.0
    for i in range(P.shape[2]):
        energy += 0.5 * (P[0, 0, i] ** 2 + P[0, 1, i] ** 2 + P[0, 2, i] ** 2) / mass[i]
    for row in range(3):
        for i in range(m.shape[2]):
            energy += 0.5 * m[0, row, i] ** 2 / moments[row, i if moments.shape[1] > 1 else 0]
    return energy / P.shape[2]


@inner
def _move_clusters(R, P, t, kinds, graphs):
    """Advance the clusters of all kinds by free motion."""
    for k in range(len(kinds) - 1):
        first, count, n, m, e, r, s, p = kinds[k]
        _, _, n1, m1, e1, r1, s1, p1 = kinds[k + 1]
        graph = Graph(
            graphs.inverse[n:n1],
            graphs.pairs[m:m1],
            graphs.lengths[m:m1],
            graphs.weights[e:e1],
            graphs.rows[r:r1],
            graphs.columns[e:e1],
            graphs.starts[s:s1],
            graphs.left[p:p1],
            graphs.right[p:p1],
        )
        clusters.advance(R, P, t, 1, first, count, graph, R, P)


@compiled("i1 f1 f f i", Bodies, Particles, "i2", Graph, Terms, "F3 F3 F3 F3 F2 F2 F2 F2 F1")
def advance(
    kicks, parts, t, hottest, known, bodies, particles, kinds, graph, terms, R, P, q, m, x, forces, total, torque, found
):
    """Perform a sequence of kicks, where `kicks` (k,) is nonzero, and drifts, over `parts` (k,) of the time t.

    R, P, q and m are changed in place. `kinds` (n + 1, 8) contains, for each kind, its first column, its number of
    clusters, and the start of its part of the concatenated fields of `graph`: atoms, constraints, entries, rows, starts
    and products. x (., 3) and `forces` (., 3) are overwritten. If `known` is true, `total` (3, N) and `torque` (3, K)
    are the forces and torques at the start. The sequence ends early if the kinetic energy per body after a kick exceeds
    `hottest` (kJ/mol). `found` (2,) receives the number of force evaluations and the last kinetic energy per body.
    """
    first = kinds[0, 0]  # first column of the clusters; `last` is the column after them
    last = kinds[len(kinds) - 1, 0]
    time = np.empty(1)
    found[:] = 0.0
    for k in range(len(kicks)):
        part = parts[k] * t
        if kicks[k]:
            if not known:
                place(R[0], q[0], particles, x)
                bonded.forces(x, terms, forces)
                collect(q[0], particles, forces, total, torque)
                found[0] += 1.0
                known = 1
            add_scaled(P, total, part, P)
            add_scaled(m, torque, part, m)
            found[1] = _mean_energy(P, m, bodies.mass, bodies.moments)
            if not found[1] <= hottest:
                return
        else:
            if m.size:
                time[0] = part
                exact.advance(bodies.constants, q, m, time, q, m)
            _move_single(R, P, bodies.mass, 0, first, part)
            _move_single(R, P, bodies.mass, last, len(bodies.mass), part)
            _move_clusters(R, P, part, kinds, graph)
            known = 0
