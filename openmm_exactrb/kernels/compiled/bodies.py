"""Rigid bodies: positions and velocities of particles, sums of forces and torques, and updates of double-doubles."""

from openmm_exactrb.kernels.build import compiled, inlined, inner
from openmm_exactrb.kernels.compiled.formulas import matrix_entries, two_sum
from openmm_exactrb.kernels.compiled.vectors import cross
from openmm_exactrb.kernels.records import Particles


@inlined
def orientation(q, body):
    """Return the entries of the rotation matrix Q of a body, row by row."""
    return matrix_entries(q[0, body], q[1, body], q[2, body], q[3, body])


@inlined
def turned(Q, b):
    """Return Q b, the vector b of a body rotated into the space frame."""
    return (
        Q[0] * b[0] + Q[1] * b[1] + Q[2] * b[2],
        Q[3] * b[0] + Q[4] * b[1] + Q[5] * b[2],
        Q[6] * b[0] + Q[7] * b[1] + Q[8] * b[2],
    )


@inlined
def torque_of(Q, b, F):
    """Return b x (transposed Q) F, the body-frame torque of a force F in space."""
    f0 = Q[0] * F[0] + Q[3] * F[1] + Q[6] * F[2]
    f1 = Q[1] * F[0] + Q[4] * F[1] + Q[7] * F[2]
    f2 = Q[2] * F[0] + Q[5] * F[1] + Q[8] * F[2]
    return cross(b, (f0, f1, f2))


@inner
def _put_points(R, turning, particles, x):
    """Write the centres R of bodies without orientations into their particles' rows of x."""
    for body in range(turning, R.shape[1]):
        for p in range(particles.starts[body], particles.starts[body + 1]):
            for e in range(3):
                x[particles.rows[p], e] = R[e, body]


@compiled("f2 f2", Particles, "F2")
def place(R, q, particles, x):
    """Write the positions R + Q b of all particles into their rows of x (., 3)."""
    for body in range(q.shape[1]):
        Q = orientation(q, body)
        for p in range(particles.starts[body], particles.starts[body + 1]):
            u = turned(Q, particles.sites[p])
            for e in range(3):
                x[particles.rows[p], e] = R[e, body] + u[e]
    _put_points(R, q.shape[1], particles, x)


@compiled("f2 f2 f2", Particles, "F2")
def move(V, omega, q, particles, v):
    """Write the velocities V + Q (omega x b) of all particles into their rows of v (., 3)."""
    for body in range(q.shape[1]):
        Q = orientation(q, body)
        w = omega[0, body], omega[1, body], omega[2, body]
        for p in range(particles.starts[body], particles.starts[body + 1]):
            u = turned(Q, cross(w, particles.sites[p]))
            for e in range(3):
                v[particles.rows[p], e] = V[e, body] + u[e]
    _put_points(V, q.shape[1], particles, v)


@compiled("f2", Particles, "f2 F2 F2")
def collect(q, particles, forces, total, torque):
    """Write the sums of the forces (3, N) and the torques (3, K) on bodies, from the forces on their particles."""
    for body in range(q.shape[1]):
        Q = orientation(q, body)
        T0 = T1 = T2 = N0 = N1 = N2 = 0.0
        for p in range(particles.starts[body], particles.starts[body + 1]):
            F = forces[particles.rows[p]]
            T0, T1, T2 = T0 + F[0], T1 + F[1], T2 + F[2]
            t0, t1, t2 = torque_of(Q, particles.sites[p], F)
            N0, N1, N2 = N0 + t0, N1 + t1, N2 + t2
        total[0, body], total[1, body], total[2, body] = T0, T1, T2
        torque[0, body], torque[1, body], torque[2, body] = N0, N1, N2
    for body in range(q.shape[1], total.shape[1]):
        total[:, body] = 0.0
        for p in range(particles.starts[body], particles.starts[body + 1]):
            for e in range(3):
                total[e, body] += forces[particles.rows[p], e]


@compiled("f3 f2 f F3")
def advance(x, rate, t, total):
    """Write x + t rate for double-doubles x (2, k, N) and rates (k, N); the result may overwrite x."""
    rows, n = rate.shape
    for row in range(rows):
        for i in range(n):
            step = t * rate[row, i] + x[1, row, i]
            total[0, row, i], total[1, row, i] = two_sum(x[0, row, i], step)
