"""Rigid bodies, compiled: the twin of `plain.bodies`."""

from __future__ import annotations

from openmm_exactrb.kernels.build import compiled
from openmm_exactrb.kernels.compiled.formulas import matrix_entries, two_sum


@compiled("f2 f2 i2 f3 i F2")
def place(R, q, particles, sites, first, x):
    """Write R + Q b of the sites b (1, k, 3) or (n, k, 3) of bodies `first` and on into the rows `particles` of x."""
    n, k = particles.shape
    own = sites.shape[0] > 1
    for i in range(n):
        body = first + i
        a, b, c, d, e, f, g, h, j = matrix_entries(q[0, body], q[1, body], q[2, body], q[3, body])
        R0, R1, R2 = R[0, body], R[1, body], R[2, body]
        shape = i if own else 0
        for s in range(k):
            s0, s1, s2 = sites[shape, s, 0], sites[shape, s, 1], sites[shape, s, 2]
            row = particles[i, s]
            x[row, 0] = R0 + (a * s0 + b * s1 + c * s2)
            x[row, 1] = R1 + (d * s0 + e * s1 + f * s2)
            x[row, 2] = R2 + (g * s0 + h * s1 + j * s2)


@compiled("f2 f2 f2 i2 f3 i F2")
def move(V, omega, q, particles, sites, first, v):
    """Write V + Q (omega x b) of bodies `first` and on into the rows `particles` of v."""
    n, k = particles.shape
    own = sites.shape[0] > 1
    for i in range(n):
        body = first + i
        a, b, c, d, e, f, g, h, j = matrix_entries(q[0, body], q[1, body], q[2, body], q[3, body])
        V0, V1, V2 = V[0, body], V[1, body], V[2, body]
        w0, w1, w2 = omega[0, body], omega[1, body], omega[2, body]
        shape = i if own else 0
        for s in range(k):
            s0, s1, s2 = sites[shape, s, 0], sites[shape, s, 1], sites[shape, s, 2]
            u0, u1, u2 = w1 * s2 - w2 * s1, w2 * s0 - w0 * s2, w0 * s1 - w1 * s0
            row = particles[i, s]
            v[row, 0] = V0 + (a * u0 + b * u1 + c * u2)
            v[row, 1] = V1 + (d * u0 + e * u1 + f * u2)
            v[row, 2] = V2 + (g * u0 + h * u1 + j * u2)


@compiled("f2 i2 f3 i f2 F2 F2")
def collect(q, particles, sites, first, forces, total, torque):
    """Sum the forces on the particles to those (3, N) and the torques (3, K) of bodies `first` and on."""
    n, k = particles.shape
    own = sites.shape[0] > 1
    for i in range(n):
        body = first + i
        a, b, c, d, e, f, g, h, j = matrix_entries(q[0, body], q[1, body], q[2, body], q[3, body])
        T0 = T1 = T2 = 0.0
        N0 = N1 = N2 = 0.0
        shape = i if own else 0
        for s in range(k):
            row = particles[i, s]
            F0, F1, F2 = forces[row, 0], forces[row, 1], forces[row, 2]
            T0, T1, T2 = T0 + F0, T1 + F1, T2 + F2
            f0, f1, f2 = a * F0 + d * F1 + g * F2, b * F0 + e * F1 + h * F2, c * F0 + f * F1 + j * F2
            s0, s1, s2 = sites[shape, s, 0], sites[shape, s, 1], sites[shape, s, 2]
            N0, N1, N2 = N0 + (s1 * f2 - s2 * f1), N1 + (s2 * f0 - s0 * f2), N2 + (s0 * f1 - s1 * f0)
        total[0, body], total[1, body], total[2, body] = T0, T1, T2
        torque[0, body], torque[1, body], torque[2, body] = N0, N1, N2


@compiled("f3 f2 f F3")
def advance(x, rate, t, total):
    """Write x + t rate of double-doubles x (2, k, N) and rates (k, N); the total may be x."""
    rows, n = rate.shape
    for row in range(rows):
        for i in range(n):
            step = t * rate[row, i] + x[1, row, i]
            total[0, row, i], total[1, row, i] = two_sum(x[0, row, i], step)
