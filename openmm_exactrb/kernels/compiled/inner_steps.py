"""Inner steps of multiple time stepping, compiled: drifts and kicks by bonded forces in one call.

Molecules with bonds are few compared with their solvent, so that calls from Python would cost more than the arithmetic.
"""

from __future__ import annotations

import numpy as np

from openmm_exactrb.kernels.build import compiled, inlined, inner
from openmm_exactrb.kernels.compiled import bodies, bonded, clusters, exact
from openmm_exactrb.kernels.compiled.formulas import matrix_entries, two_sum


@inner
def _place(R, q, particles, owners, sites, x):
    """Write R + Q b of the sites b of particles (n,) with owners (n,), of which single ones do not turn."""
    turning = q.shape[2]
    for p in range(len(particles)):
        row, body = particles[p], owners[p]
        if body < turning:
            a, b, c, d, e, f, g, h, j = matrix_entries(q[0, 0, body], q[0, 1, body], q[0, 2, body], q[0, 3, body])
            s0, s1, s2 = sites[p]
            x[row, 0] = R[0, 0, body] + (a * s0 + b * s1 + c * s2)
            x[row, 1] = R[0, 1, body] + (d * s0 + e * s1 + f * s2)
            x[row, 2] = R[0, 2, body] + (g * s0 + h * s1 + j * s2)
        else:
            for i in range(3):
                x[row, i] = R[0, i, body]


@inner
def _collect(q, particles, owners, sites, forces, total, torque):
    """Sum the forces on particles to those (3, N) and the torques (3, K) of their owners."""
    turning = q.shape[2]
    total[:] = 0.0
    torque[:] = 0.0
    for p in range(len(particles)):
        row, body = particles[p], owners[p]
        F0, F1, F2 = forces[row, 0], forces[row, 1], forces[row, 2]
        total[0, body] += F0
        total[1, body] += F1
        total[2, body] += F2
        if body < turning:
            a, b, c, d, e, f, g, h, j = matrix_entries(q[0, 0, body], q[0, 1, body], q[0, 2, body], q[0, 3, body])
            f0, f1, f2 = a * F0 + d * F1 + g * F2, b * F0 + e * F1 + h * F2, c * F0 + f * F1 + j * F2
            s0, s1, s2 = sites[p]
            torque[0, body] += s1 * f2 - s2 * f1
            torque[1, body] += s2 * f0 - s0 * f2
            torque[2, body] += s0 * f1 - s1 * f0


@inner
def _move_single(R, P, mass, first, last, t):
    """Let the centres of bodies from `first` to `last` move freely."""
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


@inlined
def _move_clusters(R, P, t, places, graphs):
    """Let the clusters of all kinds move freely."""
    inverse, pairs, lengths, weights, rows, columns, starts, left, right = graphs
    for k in range(len(places) - 1):
        first, count, n, m, e, r, s, p = places[k]
        _, _, n1, m1, e1, r1, s1, p1 = places[k + 1]
        graph = (inverse[n:n1], pairs[m:m1], lengths[m:m1], weights[e:e1], rows[r:r1], columns[e:e1])
        products = (starts[s:s1], left[p:p1], right[p:p1])
        clusters.advance(R, P, t, 1, first, count, *graph, *products, R, P)


@compiled(
    "i1 f1 f f i f1 f2 f2 i1 i1 f2 i2 f1 i2 f1 f1 i1 i1 i1 i1 i1 i2 f2 i2 f2 i2 f3 i2 f2 i2 f2 i2 f3 "
    "F3 F3 F3 F3 F2 F2 F2 F2 F1"
)
def advance(
    kicks,
    parts,
    t,
    hottest,
    known,
    mass,
    moments,
    body,
    particles,
    owners,
    sites,
    places,
    inverse,
    pairs,
    lengths,
    weights,
    rows,
    columns,
    starts,
    left,
    right,
    bonds,
    of_bonds,
    angles,
    of_angles,
    torsions,
    of_torsions,
    bonded_pairs,
    of_pairs,
    impropers,
    of_impropers,
    maps,
    patches,
    R,
    P,
    q,
    m,
    x,
    forces,
    total,
    torque,
    found,
):
    """Make a sequence of kicks and drifts, of which `kicks` (k,) says which is which, over parts (k,) of the time t.

    R to m are changed in place; they, `mass` (N,) and `moments` (3, 1) or (3, K) are those of the bodies, `body` that
    of `exact.advance`. `particles` (n,) have `owners` (n,) and `sites` (n, 3) in them. `places` (kinds + 1, 8) are the
    first column and the number of clusters of each kind, and where its part of the fields of `Graph`, `inverse` to
    `right`, begins: of atoms, constraints, entries, rows, starts and products. `bonds` to `patches` are those of
    `bonded.forces`, at x (., 3), which is overwritten as `forces` (., 3) are. If `known`, `total` (3, N) and `torque`
    (3, K) are those at the start. A kick that leaves more kinetic energy per body (kJ/mol) than the hottest bodies have
    is the last one. `found` (2,) is how often forces were evaluated, and this energy.
    """
    graphs = (inverse, pairs, lengths, weights, rows, columns, starts, left, right)
    terms = (bonds, of_bonds, angles, of_angles, torsions, of_torsions, bonded_pairs, of_pairs)
    others = (impropers, of_impropers, maps, patches)
    first = places[0, 0]  # of the clusters, behind which there are none
    last = places[len(places) - 1, 0]
    time = np.empty(1)
    found[:] = 0.0
    for k in range(len(kicks)):
        part = parts[k] * t
        if kicks[k]:
            if not known:
                _place(R, q, particles, owners, sites, x)
                bonded.forces(x, *terms, *others, forces)
                _collect(q, particles, owners, sites, forces, total, torque)
                found[0] += 1.0
                known = 1
            bodies.advance(P, total, part, P)
            bodies.advance(m, torque, part, m)
            found[1] = _mean_energy(P, m, mass, moments)
            if not found[1] <= hottest:
                return
        else:
            if m.size:
                time[0] = part
                exact.advance(body, q, m, time, q, m)
            _move_single(R, P, mass, 0, first, part)
            _move_single(R, P, mass, last, len(mass), part)
            _move_clusters(R, P, part, places, graphs)
            known = 0
