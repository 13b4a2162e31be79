"""Inner steps of multiple time stepping, compiled: drifts and kicks by bonded forces in one call.

Molecules with bonds are few compared with their solvent, so that calls from Python would take longer than the
arithmetic.
"""

from __future__ import annotations

import numpy as np

from openmm_exactrb.kernels.build import compiled, inner
from openmm_exactrb.kernels.compiled import bonded, clusters, exact
from openmm_exactrb.kernels.compiled.bodies import advance as add_scaled
from openmm_exactrb.kernels.compiled.bodies import orientation, torque_of, turned
from openmm_exactrb.kernels.compiled.formulas import two_sum
from openmm_exactrb.kernels.graph import Graph
from openmm_exactrb.kernels.records import Bodies, Terms


@inner
def _place(R, q, bodies, x):
    """Write R + Q b of the sites b of all particles, of which single ones do not rotate."""
    for p in range(len(bodies.particles)):
        row, body = bodies.particles[p], bodies.owners[p]
        if body < q.shape[2]:
            u = turned(orientation(q[0], body), bodies.sites[p])
            for e in range(3):
                x[row, e] = R[0, e, body] + u[e]
        else:
            for e in range(3):
                x[row, e] = R[0, e, body]


@inner
def _collect(q, bodies, forces, total, torque):
    """Sum the forces on particles to the forces (3, N) and torques (3, K) on their bodies."""
    total[:] = 0.0
    torque[:] = 0.0
    for p in range(len(bodies.particles)):
        F, body = forces[bodies.particles[p]], bodies.owners[p]
        for e in range(3):
            total[e, body] += F[e]
        if body < q.shape[2]:
            t = torque_of(orientation(q[0], body), bodies.sites[p], F)
            for e in range(3):
                torque[e, body] += t[e]


@inner
def _move_single(R, P, mass, first, last, t):
    """Advance the centres of bodies from `first` to `last` by free motion."""
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
def _move_clusters(R, P, t, places, graphs):
    """Advance the clusters of all kinds by free motion."""
    for k in range(len(places) - 1):
        first, count, n, m, e, r, s, p = places[k]
        _, _, n1, m1, e1, r1, s1, p1 = places[k + 1]
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


@compiled("i1 f1 f f i", Bodies, "i2", Graph, Terms, "F3 F3 F3 F3 F2 F2 F2 F2 F1")
def advance(kicks, parts, t, hottest, known, bodies, places, graph, terms, R, P, q, m, x, forces, total, torque, found):
    """Perform a sequence of kicks, marked by `kicks` (k,), and drifts over fractions (k,) of the time t.

    R to m are changed in place. `places` (kinds + 1, 8) contains the first column and the number of clusters of each
    kind, and the starts of its parts of the concatenated fields of `graph`: of atoms, constraints, entries, rows,
    starts and products. x (., 3) and `forces` (., 3) are overwritten. If `known`, `total` (3, N) and `torque` (3, K)
    are those at the start. The sequence ends after a kick if the kinetic energy per body (kJ/mol) exceeds that of the
    hottest bodies. `found` (2,) receives the number of force evaluations, and this energy.
    """
    first = places[0, 0]  # of the clusters, behind which there are none
    last = places[len(places) - 1, 0]
    time = np.empty(1)
    found[:] = 0.0
    for k in range(len(kicks)):
        part = parts[k] * t
        if kicks[k]:
            if not known:
                _place(R, q, bodies, x)
                bonded.forces(x, terms, forces)
                _collect(q, bodies, forces, total, torque)
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
            _move_clusters(R, P, part, places, graph)
            known = 0
