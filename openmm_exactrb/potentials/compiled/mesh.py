"""The Ewald sum of point dipoles in reciprocal space on a mesh, compiled.

Smooth particle mesh Ewald for dipoles (Essmann et al., J. Chem. Phys. 103, 8577 (1995)): the mesh charge is Q = sum
(u.grad) W(r - mesh), where W is a B-spline, and the energy is half the sum of G(k) times the square of Q(k). Forces and
fields are exact derivatives of this energy, and follow from the derivatives of the spline. An evaluation takes one
forward and one inverse Fourier transform.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.polynomial import polynomial

from openmm_exactrb.kernels.build import at_first_call, inner_reordered
from openmm_exactrb.kernels.threads import in_threads
from openmm_exactrb.potentials.compiled.cells import by_cell
from openmm_exactrb.potentials.compiled.ewald import uniform_field
from openmm_exactrb.potentials.compiled.rows import LANES, add_plane, spline_rows, sum_plane
from openmm_exactrb.support.types import Array

Edges = tuple[float, float, float]
Points = tuple[int, int, int]


def reciprocal_space(
    r: Array, u: Array, edges: Edges, alpha: float, points: Points, order: int, dielectric: float, threads: int = 1
) -> tuple[float, Array, Array]:
    """Return the energy of dipoles u (3, n) at r (3, n), the forces and the fields: -dU/dr and -dU/du of this energy U.

    The function corresponds to `ewald.reciprocal_space`, with splines of even `order` on a mesh with given numbers of
    `points`. The mesh moves with the mean of r, so that the energy is invariant under translations, and the forces add
    up to zero. Results are bit-identical for any number of threads.
    """
    C, steps, (nx, ny, nz) = spline(order), tuple(range(order)), points
    base, rest = _places(r, r.mean(axis=1), edges, points)
    heads, dipoles = by_cell(base[:, 0] * ny + base[:, 1], nx * ny)
    scale = np.array([n / edge for n, edge in zip(points, edges, strict=True)])
    mesh = np.empty((nx, ny + order, nz + C.shape[2]))
    each, planes = np.ones(len(dipoles), dtype=np.int64), np.ones(nx, dtype=np.int64)
    in_threads(
        lambda *part: _spread(*part, u, base, rest, scale, heads, dipoles, C, steps, points, mesh), planes, threads
    )
    Q = scipy.fft.rfftn(mesh[:, :ny, :nz], workers=threads)
    influence, energies = influence_function(edges, alpha, points, order), np.empty(nx)
    in_threads(lambda *part: _multiply(*part, influence, Q, nz, energies), planes, threads)
    phi = scipy.fft.irfftn(Q, points, overwrite_x=True, workers=threads, norm="forward")
    in_threads(lambda *part: _pad(*part, phi, mesh), planes, threads)
    forces, fields = np.zeros_like(r), np.zeros_like(u)
    in_threads(
        lambda *part: _gather(*part, u, base, rest, scale, dipoles, C, steps, mesh, forces, fields), each, threads
    )
    forces -= forces.mean(axis=1, keepdims=True)
    uniform = uniform_field(u, edges, alpha, dielectric)
    return float(energies.sum()) - 0.5 * float((uniform * u).sum()), forces, fields + uniform


def fast_size(points: float) -> int:
    """Return the smallest number of mesh points with a fast transform that is at least `points`, up to roundoff."""
    return int(scipy.fft.next_fast_len(math.ceil(points * (1.0 - 1e-9)), real=True))


@lru_cache
def spline(order: int) -> Array:
    """Return the pieces of a B-spline and of its first two derivatives as polynomials.

    The result (3, order, points) contains coefficients of t^(order-1), ..., t, 1 at the points 0, 1, ..., order - 1,
    for a dipole at order/2 - 1 + t. The points are padded with zeros to full vector registers.
    """
    pieces = [np.ones(1)]
    for k in range(2, order + 1):
        low, high = [*pieces, np.zeros(1)], [np.zeros(1), *pieces]
        pieces = [
            polynomial.polyadd(polynomial.polymul([a, 1.0], low[a]), polynomial.polymul([k - a, -1.0], high[a]))
            / (k - 1)
            for a in range(k)
        ]
    C = np.zeros((3, order, -(-order // LANES) * LANES))
    for a, piece in enumerate(reversed(pieces)):
        for d in range(3):
            C[d, d:, a] = polynomial.polyder(piece, d)[::-1]
    return C


@lru_cache(maxsize=2)  # a barostat alternates between two boxes
def influence_function(edges: Edges, alpha: float, points: Points, order: int) -> Array:
    """Return the influence function of the mesh that minimises the errors of the forces on random dipoles.

    The result is G k^6 W²/(sum k² W² sum k^4 W²), with sums over all aliases of k, where G is the influence function of
    the Ewald sum and W the Fourier transform of the spline.
    """
    k = [2.0 * math.pi / edge * scipy.fft.fftfreq(n, 1.0 / n) for edge, n in zip(edges, points, strict=True)]
    k[2] = k[2][: points[2] // 2 + 1]
    k = [np.abs(q).reshape(shape) for q, shape in zip(k, [(-1, 1, 1), (-1, 1), (-1,)], strict=True)]
    k2 = k[0] ** 2 + k[1] ** 2 + k[2] ** 2
    k2[0, 0, 0] = 1.0
    steps = [edge / n for edge, n in zip(edges, points, strict=True)]
    W2, second, fourth = alias_sums(k, steps, order)
    exact = 4.0 * math.pi / math.prod(edges) * np.exp(k2 / (-4.0 * alpha * alpha)) / k2
    G: Array = exact * W2 * k2**3 / np.maximum(second * fourth, 1e-300)
    G[0, 0, 0] = 0.0
    return G


def alias_sums(k, steps, order):
    """Return W(k)², and the sums of k² W² and of k^4 W² over all aliases of k, from its components along the axes."""
    ones, moments = [], []
    for q, h in zip(k, steps, strict=True):
        aliases = q + 2.0 * math.pi / h * np.arange(-3, 4).reshape(-1, *q.ndim * [1])
        W2 = np.sinc(aliases * h / (2.0 * math.pi)) ** (2 * order)
        ones.append(W2[3])
        moments.append([(aliases**e * W2).sum(axis=0) for e in (0, 2, 4)])
    (x0, x2, x4), (y0, y2, y4), (z0, z2, z4) = moments
    second = x2 * y0 * z0 + x0 * y2 * z0 + x0 * y0 * z2
    fourth = x4 * y0 * z0 + x0 * y4 * z0 + x0 * y0 * z4 + 2.0 * (x2 * y2 * z0 + x2 * y0 * z2 + x0 * y2 * z2)
    return ones[0] * ones[1] * ones[2], second, fourth


@at_first_call
def _places(r, origin, edges, points):
    """Return the first mesh point (n, 3) of each dipole, and the distance to it in units of the mesh spacing."""
    base, rest = np.empty((r.shape[1], 3), np.int64), np.empty((r.shape[1], 3))
    for d in range(3):
        n = points[d]
        for i in range(r.shape[1]):
            x = (r[d, i] - origin[d]) * (n / edges[d])
            x -= n * math.floor(x / n)
            inside = (x >= 0.0) & (x < n)  # false for nan, and for n, which roundoff may produce
            base[i, d] = int(x) if inside else 0
            rest[i, d] = x - math.floor(x)
    return base, rest


@inner_reordered
def _weigh(i, rest, scale, C, steps, w):
    """Write the spline and its first two derivatives along each axis, for one dipole, to w (3, 3, order)."""
    for d in range(3):
        spline_rows(C, rest[i, d], scale[d], w, 3 * C.shape[2] * d, steps)


@at_first_call
def _spread(first, last, u, base, rest, scale, heads, dipoles, C, steps, points, mesh):
    """Sum the mesh charge in given planes, and add their margins periodically."""
    nx, ny, nz = points
    order, height, stride = len(steps), mesh.shape[1], mesh.shape[2]
    w = np.empty((3, 3, C.shape[2]))
    mesh[first:last] = 0.0
    for plane in range(first - order + 1, last):
        b = plane % nx * ny
        for q in range(heads[b], heads[b + ny]):
            i = dipoles[q]
            _weigh(i, rest, scale, C, steps, w)
            for a in range(max(0, first - plane), min(order, last - plane)):
                X, dX = w[0, 0, a], w[0, 1, a]
                at = ((plane + a) * height + base[i, 1]) * stride + base[i, 2]
                add_plane(mesh, at, stride, w, u[0, i] * dX, u[1, i] * X, u[2, i] * X, steps)
    for x in range(first, last):
        for y in range(ny, mesh.shape[1]):
            for z in range(stride):
                mesh[x, y - ny, z] += mesh[x, y, z]
        for y in range(ny):
            for z in range(nz, stride):
                mesh[x, y, z - nz] += mesh[x, y, z]


@at_first_call
def _multiply(first, last, influence, Q, nz, energies):
    """Multiply given planes of the half spectrum by the influence function, and sum the energy of the full spectrum."""
    for x in range(first, last):
        energy = 0.0
        for y in range(Q.shape[1]):
            for z in range(Q.shape[2]):
                q, G = Q[x, y, z], influence[x, y, z]
                here = G * (q.real * q.real + q.imag * q.imag)
                energy += here if 0 < 2 * z < nz else 0.5 * here  # k also represents -k, unless they are equal
                Q[x, y, z] = complex(G * q.real, G * q.imag)
        energies[x] = energy


@at_first_call
def _pad(first, last, phi, mesh):
    """Copy given planes of the potential into planes with periodic margins."""
    ny, nz = phi.shape[1:]
    for x in range(first, last):
        for y in range(mesh.shape[1]):
            row, source = mesh[x, y], phi[x, y % ny]
            for z in range(nz):
                row[z] = source[z]
            for z in range(nz, mesh.shape[2]):
                row[z] = source[z % nz]


@at_first_call
def _gather(first, last, u, base, rest, scale, dipoles, C, steps, phi, forces, fields):
    """Compute the forces and fields on given dipoles in the potential on the mesh."""
    nx, height, stride = phi.shape
    w, sums = np.empty((3, 3, C.shape[2])), np.empty((6, C.shape[2]))
    for q in range(first, last):
        i = dipoles[q]
        _weigh(i, rest, scale, C, steps, w)
        sums[:] = 0.0
        for a in range(len(steps)):
            at = ((base[i, 0] + a) % nx * height + base[i, 1]) * stride + base[i, 2]
            sum_plane(phi, at, stride, w, a, sums, steps)
        x = y = z = xx = xy = xz = yy = yz = zz = 0.0
        for a in range(C.shape[2]):
            Z, dZ, ddZ = w[2, 0, a], w[2, 1, a], w[2, 2, a]
            x, y, z = x + sums[1, a] * Z, y + sums[2, a] * Z, z + sums[0, a] * dZ
            xx, xy, xz = xx + sums[3, a] * Z, xy + sums[4, a] * Z, xz + sums[1, a] * dZ
            yy, yz, zz = yy + sums[5, a] * Z, yz + sums[2, a] * dZ, zz + sums[0, a] * ddZ
        ux, uy, uz = u[0, i], u[1, i], u[2, i]
        fields[0, i], fields[1, i], fields[2, i] = -x, -y, -z
        forces[0, i] = -(ux * xx + uy * xy + uz * xz)
        forces[1, i] = -(ux * xy + uy * yy + uz * yz)
        forces[2, i] = -(ux * xz + uy * yz + uz * zz)
