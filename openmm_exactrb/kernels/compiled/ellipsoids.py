"""The sum over uniaxial ellipsoids with the potential of Gay and Berne, mu = 2 and nu = 1."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.kernels.build import compiled, inner
from openmm_exactrb.kernels.compiled.pair import switched


@inner
def _anisotropy(a, b, c, chi):
    """Return H = 1 - chi (a² + b² - 2 chi a b c)/(1 - chi² c²) and its derivatives by a, b and c."""
    f = chi / (1.0 - chi * chi * c * c)
    N = a * a + b * b - 2.0 * chi * a * b * c
    Ha, Hb = -2.0 * f * (a - chi * b * c), -2.0 * f * (b - chi * a * c)
    return 1.0 - f * N, Ha, Hb, 2.0 * f * chi * (a * b - f * c * N)


@inner
def _pair(r, a, b, c, chi, chi_prime, sigma, shift, scale):
    """Return the energy and its derivatives by r, a = u.r/r, b = v.r/r and c = u.v; nan if the ellipsoids overlap."""
    H, Ha, Hb, Hc = _anisotropy(a, b, c, chi)
    K, Ka, Kb, Kc = _anisotropy(a, b, c, chi_prime)
    width = sigma / np.sqrt(H)
    R = (r - width) / shift + 1.0
    if R <= 0.0:  # beyond the pole the formula attracts
        return np.nan, np.nan, np.nan, np.nan, np.nan
    i = 1.0 / R
    i6 = (i * i * i) * (i * i * i)
    D = 1.0 - chi * chi * c * c
    strength = scale / np.sqrt(D)
    W, dW = i6 * i6 - i6, (6.0 - 12.0 * i6) * i6 * i
    U = strength * K * K * W
    slope = strength * K * K * dW / shift
    by_H = 0.5 * slope * width / H  # the width falls as H grows
    by_K = 2.0 * strength * K * W
    return U, slope, by_H * Ha + by_K * Ka, by_H * Hb + by_K * Kb, by_H * Hc + by_K * Kc + U * chi * chi * c / D


@compiled("f2 f1 f1 F2 F1")
def gay_berne(x, box, law, forces, energy):
    """Write the forces (2 n, 3) (kJ/mol/nm) and the energy (1,) (kJ/mol).

    Parameters
    ----------
    x : (2 n, 3) array
        Positions (nm): centre and a point on the axis of the first ellipsoid, of the second, ...
    box : (3,) array
        Edges (nm) of a rectangular periodic box.
    law : (7,) array
        chi, chi', diameter and shift (nm), 4 epsilon (kJ/mol), cutoff and start of the switch (nm).
    """
    n = len(x) // 2
    chi, chi_prime, sigma, shift, scale, cutoff, begin = law
    end, rate = cutoff * cutoff, 1.0 / (cutoff * cutoff - begin * begin)
    axes, lengths, pulls = np.empty((n, 3)), np.empty(n), np.zeros((n, 3))
    for i in range(n):
        dx, dy, dz = x[2 * i + 1, 0] - x[2 * i, 0], x[2 * i + 1, 1] - x[2 * i, 1], x[2 * i + 1, 2] - x[2 * i, 2]
        lengths[i] = np.sqrt(dx * dx + dy * dy + dz * dz)
        axes[i, 0], axes[i, 1], axes[i, 2] = dx / lengths[i], dy / lengths[i], dz / lengths[i]
    forces[:] = 0.0
    total = 0.0
    for i in range(n):
        ux, uy, uz = axes[i]
        for j in range(i):
            rx, ry, rz = x[2 * i, 0] - x[2 * j, 0], x[2 * i, 1] - x[2 * j, 1], x[2 * i, 2] - x[2 * j, 2]
            rx -= box[0] * np.rint(rx / box[0])
            ry -= box[1] * np.rint(ry / box[1])
            rz -= box[2] * np.rint(rz / box[2])
            r2 = rx * rx + ry * ry + rz * rz
            if r2 >= end:
                continue
            vx, vy, vz = axes[j]
            r = np.sqrt(r2)
            rx, ry, rz = rx / r, ry / r, rz / r
            a, b, c = ux * rx + uy * ry + uz * rz, vx * rx + vy * ry + vz * rz, ux * vx + uy * vy + uz * vz
            U, slope, Ua, Ub, Uc = _pair(r, a, b, c, chi, chi_prime, sigma, shift, scale)
            if r2 > begin * begin:
                S, dS = switched(r2, end, rate)
                U, slope, Ua, Ub, Uc = S * U, S * slope + 2.0 * r * dS * U, S * Ua, S * Ub, S * Uc
            total += U
            along = slope - (a * Ua + b * Ub) / r
            fx = along * rx + (Ua * ux + Ub * vx) / r
            fy = along * ry + (Ua * uy + Ub * vy) / r
            fz = along * rz + (Ua * uz + Ub * vz) / r
            forces[2 * i, 0] -= fx
            forces[2 * i, 1] -= fy
            forces[2 * i, 2] -= fz
            forces[2 * j, 0] += fx
            forces[2 * j, 1] += fy
            forces[2 * j, 2] += fz
            pulls[i, 0] -= Ua * rx + Uc * vx
            pulls[i, 1] -= Ua * ry + Uc * vy
            pulls[i, 2] -= Ua * rz + Uc * vz
            pulls[j, 0] -= Ub * rx + Uc * ux
            pulls[j, 1] -= Ub * ry + Uc * uy
            pulls[j, 2] -= Ub * rz + Uc * uz
    for i in range(n):  # what turns the axis, without what would stretch it
        u = axes[i]
        stretch = pulls[i, 0] * u[0] + pulls[i, 1] * u[1] + pulls[i, 2] * u[2]
        for k in range(3):
            forces[2 * i + 1, k] = (pulls[i, k] - stretch * u[k]) / lengths[i]
            forces[2 * i, k] -= forces[2 * i + 1, k]
    energy[0] = total
