"""Particles of rigid bodies of one kind, compiled: the twins of `RigidBodies.positions` and `RigidBodies.forces`."""

from __future__ import annotations

from openmm_exactrb.kernels import compiled, inlined


@inlined
def _matrix(w, x, y, z):
    """Return the rows of the rotation matrix of a unit quaternion."""
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    return 1.0 - (yy + zz), xy - wz, xz + wy, xy + wz, 1.0 - (xx + zz), yz - wx, xz - wy, yz + wx, 1.0 - (xx + yy)


@compiled("f2 f2 i2 f2 i F2")
def place(R, q, particles, sites, first, x):
    """Write R + Q b of the sites b (k, 3) of bodies `first` and on into the rows `particles` (n, k) of x."""
    n, k = particles.shape
    for i in range(n):
        body = first + i
        a, b, c, d, e, f, g, h, j = _matrix(q[0, body], q[1, body], q[2, body], q[3, body])
        R0, R1, R2 = R[0, body], R[1, body], R[2, body]
        for s in range(k):
            s0, s1, s2 = sites[s, 0], sites[s, 1], sites[s, 2]
            row = particles[i, s]
            x[row, 0] = R0 + (a * s0 + b * s1 + c * s2)
            x[row, 1] = R1 + (d * s0 + e * s1 + f * s2)
            x[row, 2] = R2 + (g * s0 + h * s1 + j * s2)


@compiled("f2 i2 f2 i F2 F2 f2")
def collect(q, particles, sites, first, force, torque, F):
    """Sum the forces F on the particles into force (3, N) and the body-frame torque (3, K) of bodies `first` and on."""
    n, k = particles.shape
    for i in range(n):
        body = first + i
        a, b, c, d, e, f, g, h, j = _matrix(q[0, body], q[1, body], q[2, body], q[3, body])
        T0 = T1 = T2 = 0.0
        N0 = N1 = N2 = 0.0
        for s in range(k):
            row = particles[i, s]
            F0, F1, F2 = F[row, 0], F[row, 1], F[row, 2]
            T0, T1, T2 = T0 + F0, T1 + F1, T2 + F2
            f0, f1, f2 = a * F0 + d * F1 + g * F2, b * F0 + e * F1 + h * F2, c * F0 + f * F1 + j * F2
            s0, s1, s2 = sites[s, 0], sites[s, 1], sites[s, 2]
            N0, N1, N2 = N0 + (s1 * f2 - s2 * f1), N1 + (s2 * f0 - s0 * f2), N2 + (s0 * f1 - s1 * f0)
        force[0, body], force[1, body], force[2, body] = T0, T1, T2
        torque[0, body], torque[1, body], torque[2, body] = N0, N1, N2
