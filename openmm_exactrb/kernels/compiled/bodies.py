"""Rigid bodies: positions and velocities of particles, sums of forces and torques, and updates of double-doubles."""

from __future__ import annotations

from openmm_exactrb.kernels.build import compiled, inlined
from openmm_exactrb.kernels.compiled.formulas import matrix_entries, two_sum


@inlined
def orientation(q, body):
    """Return the entries of the matrix Q of a body, row by row."""
    return matrix_entries(q[0, body], q[1, body], q[2, body], q[3, body])


@inlined
def turned(Q, b):
    """Return Q b."""
    return (
        Q[0] * b[0] + Q[1] * b[1] + Q[2] * b[2],
        Q[3] * b[0] + Q[4] * b[1] + Q[5] * b[2],
        Q[6] * b[0] + Q[7] * b[1] + Q[8] * b[2],
    )


@inlined
def torque_of(Q, b, F):
    """Return b x (transposed Q) F, the torque in the body of a force F in space."""
    f0 = Q[0] * F[0] + Q[3] * F[1] + Q[6] * F[2]
    f1 = Q[1] * F[0] + Q[4] * F[1] + Q[7] * F[2]
    f2 = Q[2] * F[0] + Q[5] * F[1] + Q[8] * F[2]
    return b[1] * f2 - b[2] * f1, b[2] * f0 - b[0] * f2, b[0] * f1 - b[1] * f0


@compiled("f2 f2 i2 f3 i F2")
def place(R, q, particles, sites, first, x):
    """Write R + Q b, for sites b (1, k, 3) or (n, k, 3) of bodies from `first` on, into the rows `particles` of x."""
    n, k = particles.shape
    own = sites.shape[0] > 1
    for i in range(n):
        body = first + i
        Q = orientation(q, body)
        for s in range(k):
            u = turned(Q, sites[i if own else 0, s])
            for e in range(3):
                x[particles[i, s], e] = R[e, body] + u[e]


@compiled("f2 f2 f2 i2 f3 i F2")
def move(V, omega, q, particles, sites, first, v):
    """Write V + Q (omega x b) of bodies from `first` on into the rows `particles` of v."""
    n, k = particles.shape
    own = sites.shape[0] > 1
    for i in range(n):
        body = first + i
        Q = orientation(q, body)
        w0, w1, w2 = omega[0, body], omega[1, body], omega[2, body]
        for s in range(k):
            b = sites[i if own else 0, s]
            u = turned(Q, (w1 * b[2] - w2 * b[1], w2 * b[0] - w0 * b[2], w0 * b[1] - w1 * b[0]))
            for e in range(3):
                v[particles[i, s], e] = V[e, body] + u[e]


@compiled("f2 i2 f3 i f2 F2 F2")
def collect(q, particles, sites, first, forces, total, torque):
    """Sum the forces on particles to the forces (3, N) and torques (3, K) on bodies from `first` on."""
    n, k = particles.shape
    own = sites.shape[0] > 1
    for i in range(n):
        body = first + i
        Q = orientation(q, body)
        T0 = T1 = T2 = 0.0
        N0 = N1 = N2 = 0.0
        for s in range(k):
            F = forces[particles[i, s]]
            T0, T1, T2 = T0 + F[0], T1 + F[1], T2 + F[2]
            t0, t1, t2 = torque_of(Q, sites[i if own else 0, s], F)
            N0, N1, N2 = N0 + t0, N1 + t1, N2 + t2
        total[0, body], total[1, body], total[2, body] = T0, T1, T2
        torque[0, body], torque[1, body], torque[2, body] = N0, N1, N2


@compiled("f3 f2 f F3")
def advance(x, rate, t, total):
    """Write x + t rate for double-doubles x (2, k, N) and rates (k, N); the result may overwrite x."""
    rows, n = rate.shape
    for row in range(rows):
        for i in range(n):
            step = t * rate[row, i] + x[1, row, i]
            total[0, row, i], total[1, row, i] = two_sum(x[0, row, i], step)
