"""Operations on vectors of three numbers, which are tuples or rows of arrays, compiled."""

from openmm_exactrb.kernels.build import inlined


@inlined
def dot(u, v):
    """Return u.v."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inlined
def cross(u, v):
    """Return u x v."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@inlined
def total(u, v):
    """Return u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@inlined
def scaled(f, u):
    """Return f u."""
    return f * u[0], f * u[1], f * u[2]


@inlined
def difference(x, i, j):
    """Return row i of x minus row j."""
    return x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
