"""The Ewald sum of point dipoles in reciprocal space, compiled.

S. W. de Leeuw, J. W. Perram and E. R. Smith, Proc. R. Soc. A 373, 27 (1980). The waves are standing waves, products of
a cosine or a sine along each axis, so that sums over waves are successive sums along the axes.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.kernels.build import at_first_call
from openmm_exactrb.kernels.threads import in_threads
from openmm_exactrb.support.types import Array

Edges = tuple[float, float, float]


def number_of_waves(edges: Edges, k_max: float) -> float:
    """Return the approximate number of wave vectors, each of which also represents its opposite."""
    return math.prod(edges) * k_max**3 / (12.0 * math.pi**2)


def reciprocal_space(
    r: Array, u: Array, edges: Edges, alpha: float, k_max: float, dielectric: float, threads: int = 1
) -> tuple[float, Array, Array]:
    """Return the energy of dipoles u (3, n) at r (3, n), the forces and the fields: -dU/dr and -dU/du of this energy U.

    Each dipole interacts with the Gaussian clouds (inverse width `alpha`) of all other dipoles and of all periodic
    images in a rectangular box with these `edges`. The sample is surrounded by a medium of relative permittivity
    `dielectric`. Results are bit-identical for any number of threads.
    """
    weights, counts = _spectrum(edges, alpha, k_max)
    kx, ky, kz = (_wave_numbers(edge, k_max) for edge in edges)
    x, y = _differentiated(_standing_waves(r[0], kx), kx), _differentiated(_standing_waves(r[1], ky), ky)
    z = _standing_waves(r[2], kz)
    amplitudes, forces, fields = np.zeros_like(weights), np.zeros_like(u), np.zeros_like(u)
    waves = u, x, y, z, kz, counts
    in_threads(lambda *planes: _amplitudes(*planes, *waves, amplitudes), counts.sum(axis=1), threads)
    factors, each = weights * amplitudes, np.ones(len(u[0]), dtype=np.int64)
    in_threads(lambda *dipoles: _derivatives(*dipoles, *waves, factors, forces, fields), each, threads)
    uniform = uniform_field(u, edges, alpha, dielectric)
    return 0.5 * float((factors * amplitudes).sum() - (uniform * u).sum()), forces, fields + uniform


def uniform_field(u: Array, edges: Edges, alpha: float, dielectric: float) -> Array:
    """Return the fields (3, n) of the surface of the sample, plus the correction for each dipole's own cloud."""
    own = 4.0 * alpha**3 / (3.0 * math.sqrt(math.pi)) * u
    own -= 4.0 * math.pi / ((2.0 * dielectric + 1.0) * math.prod(edges)) * u.sum(axis=1, keepdims=True)
    return own


def _wave_numbers(edge: float, k_max: float) -> Array:
    return 2.0 * math.pi / edge * np.arange(int(k_max * edge / (2.0 * math.pi)) + 1, dtype=np.float64)


@lru_cache(maxsize=2)  # a barostat alternates between two boxes
def _spectrum(edges: Edges, alpha: float, k_max: float) -> tuple[Array, NDArray[np.int64]]:
    """Return the weights of products of waves along x, y, z, and the number of waves along z for each pair along x, y.

    Along an axis, waves alternate between the cosine and the sine of each wave number; each nonzero wave number also
    represents its opposite. The second wave is sin 0 = 0.
    """
    kx, ky, kz = (_wave_numbers(edge, k_max).repeat(2) for edge in edges)
    k2 = kx[:, None, None] ** 2 + ky[:, None] ** 2 + kz**2
    counts = (k2 <= k_max**2).sum(axis=2)
    counts[1] = counts[:, 1] = 0
    k2[(k2 == 0.0) | (k2 > k_max**2)] = np.inf
    images = (1.0 + (kx > 0.0))[:, None, None] * (1.0 + (ky > 0.0))[:, None] * (1.0 + (kz > 0.0))
    weights: Array = 4.0 * math.pi / math.prod(edges) * images * np.exp(k2 / (-4.0 * alpha * alpha)) / k2
    return weights, counts


@at_first_call
def _standing_waves(x, k):
    """Return cos k x and sin k x, alternating, for all wave numbers k (2 len(k), n)."""
    waves = np.empty((2 * len(k), len(x)))
    waves[0], waves[1] = 1.0, 0.0
    for m in range(1, len(k)):
        for i in range(len(x)):
            if m == 1:
                c, s = math.cos(k[1] * x[i]), math.sin(k[1] * x[i])
            else:
                c1, s1, c, s = waves[2, i], waves[3, i], waves[2 * m - 2, i], waves[2 * m - 1, i]
                c, s = c * c1 - s * s1, s * c1 + c * s1
            waves[2 * m, i], waves[2 * m + 1, i] = c, s
    return waves


@at_first_call
def _differentiated(waves, k):
    """Return standing waves and their first and second derivatives (3, 2 len(k), n)."""
    all_three = np.empty((3, waves.shape[0], waves.shape[1]))
    for m in range(len(k)):
        for i in range(waves.shape[1]):
            c, s = waves[2 * m, i], waves[2 * m + 1, i]
            all_three[0, 2 * m, i], all_three[0, 2 * m + 1, i] = c, s
            all_three[1, 2 * m, i], all_three[1, 2 * m + 1, i] = -k[m] * s, k[m] * c
            all_three[2, 2 * m, i], all_three[2, 2 * m + 1, i] = -k[m] * k[m] * c, -k[m] * k[m] * s
    return all_three


@at_first_call
def _amplitudes(first, last, u, x, y, z, kz, counts, amplitudes):
    """Write the sums of u.grad over all dipoles, for the waves in given rows of x."""
    n = u.shape[1]
    across, along = np.empty((2, n))
    for a in range(first, last):
        for b in range(counts.shape[1]):
            if counts[a, b] == 0:
                continue
            for i in range(n):
                across[i] = u[0, i] * x[1, a, i] * y[0, b, i] + u[1, i] * x[0, a, i] * y[1, b, i]
                along[i] = u[2, i] * x[0, a, i] * y[0, b, i]
            for m in range(counts[a, b] // 2):
                across_c = across_s = along_c = along_s = 0.0
                for i in range(n):
                    c, s = z[2 * m, i], z[2 * m + 1, i]
                    across_c += across[i] * c
                    across_s += across[i] * s
                    along_c += along[i] * c
                    along_s += along[i] * s
                amplitudes[a, b, 2 * m] = across_c - kz[m] * along_s
                amplitudes[a, b, 2 * m + 1] = across_s + kz[m] * along_c


@at_first_call
def _derivatives(first, last, u, x, y, z, kz, counts, factors, forces, fields):
    """Compute the forces and fields on given dipoles: derivatives of the sum of factors times u.grad.

    Sums over waves, and their derivatives, are computed along z first, then along y, and finally along x.
    """
    first, last = np.uint64(first), np.uint64(last)  # unsigned, so that the loops are vectorised
    g, gz, gzz, h, hy, hyy, hz, hyz, hzz = np.empty((9, u.shape[1]))
    for a in range(counts.shape[0]):
        h[:] = hy[:] = hyy[:] = hz[:] = hyz[:] = hzz[:] = 0.0
        for b in range(counts.shape[1]):
            if counts[a, b] == 0:
                continue
            g[:] = gz[:] = gzz[:] = 0.0
            for m in range(counts[a, b] // 2):
                C, S, k = factors[a, b, 2 * m], factors[a, b, 2 * m + 1], kz[m]
                for i in range(first, last):
                    c, s = z[2 * m, i], z[2 * m + 1, i]
                    g[i] += C * c + S * s
                    gz[i] += k * (S * c - C * s)
                    gzz[i] -= k * k * (C * c + S * s)
            for i in range(first, last):
                h[i] += y[0, b, i] * g[i]
                hy[i] += y[1, b, i] * g[i]
                hyy[i] += y[2, b, i] * g[i]
            for i in range(first, last):
                hz[i] += y[0, b, i] * gz[i]
                hyz[i] += y[1, b, i] * gz[i]
                hzz[i] += y[0, b, i] * gzz[i]
        for i in range(first, last):
            X, Xx, Xxx = x[:, a, i]
            ux, uy, uz = u[:, i]
            fields[0, i] -= Xx * h[i]
            fields[1, i] -= X * hy[i]
            fields[2, i] -= X * hz[i]
            forces[0, i] -= ux * Xxx * h[i] + uy * Xx * hy[i] + uz * Xx * hz[i]
            forces[1, i] -= ux * Xx * hy[i] + uy * X * hyy[i] + uz * X * hyz[i]
            forces[2, i] -= ux * Xx * hz[i] + uy * X * hyz[i] + uz * X * hzz[i]
