"""The sum over uniaxial ellipsoids with the Gay-Berne potential, mu = 2 and nu = 1."""

import numpy as np

from openmm_exactrb.kernels.build import at_first_call, inlined, inner
from openmm_exactrb.potentials.compiled.pair import switched
from openmm_exactrb.potentials.compiled.vectors import difference, dot


@inner
def _anisotropy(a, b, c, chi):
    """Return H = 1 - chi (a² + b² - 2 chi a b c)/(1 - chi² c²) and its derivatives with respect to a, b and c."""
    f = chi / (1.0 - chi * chi * c * c)
    N = a * a + b * b - 2.0 * chi * a * b * c
    Ha, Hb = -2.0 * f * (a - chi * b * c), -2.0 * f * (b - chi * a * c)
    return 1.0 - f * N, Ha, Hb, 2.0 * f * chi * (a * b - f * c * N)


@inner
def _pair(r, a, b, c, chi, chi_prime, sigma, shift, scale):
    """Return the energy of a pair and its derivatives with respect to r, a, b and c; nan if the ellipsoids overlap.

    Here a = u.r/r, b = v.r/r and c = u.v.
    """
    H, Ha, Hb, Hc = _anisotropy(a, b, c, chi)
    K, Ka, Kb, Kc = _anisotropy(a, b, c, chi_prime)
    width = sigma / np.sqrt(H)
    R = (r - width) / shift + 1.0
    if R <= 0.0:  # beyond the pole of the formula, the force would be attractive
        return np.nan, np.nan, np.nan, np.nan, np.nan
    i = 1.0 / R
    i6 = (i * i * i) * (i * i * i)
    D = 1.0 - chi * chi * c * c
    strength = scale / np.sqrt(D)
    W, dW = i6 * i6 - i6, (6.0 - 12.0 * i6) * i6 * i
    U = strength * K * K * W
    slope = strength * K * K * dW / shift
    by_H = 0.5 * slope * width / H  # the width decreases as H increases
    by_K = 2.0 * strength * K * W
    return U, slope, by_H * Ha + by_K * Ka, by_H * Hb + by_K * Kb, by_H * Hc + by_K * Kc + U * chi * chi * c / D


@inlined
def _nearest(x, i, j, box):
    """Return the vector from particle j to the nearest image of particle i."""
    a, b, c = difference(x, i, j)
    return a - box[0] * np.rint(a / box[0]), b - box[1] * np.rint(b / box[1]), c - box[2] * np.rint(c / box[2])


@at_first_call
def gay_berne(x, box, law, forces, energy):
    """Write the forces (kJ/mol/nm) on ellipsoids in a box and their energy (1,) (kJ/mol).

    x contains the centre of each ellipsoid and a point on its axis, and `box` the edges (nm). `law` (7,) contains chi,
    chi', the diameter and the shift (nm), 4 epsilon (kJ/mol), and the cutoff and the start of the switching function
    (nm).
    """
    n = len(x) // 2
    chi, chi_prime, sigma, shift, scale, cutoff, begin = law
    end, rate = cutoff * cutoff, 1.0 / (cutoff * cutoff - begin * begin)
    axes, lengths, pulls = np.empty((n, 3)), np.empty(n), np.zeros((n, 3))
    for i in range(n):
        u = difference(x, 2 * i + 1, 2 * i)
        lengths[i] = np.sqrt(dot(u, u))
        for k in range(3):
            axes[i, k] = u[k] / lengths[i]
    forces[:] = 0.0
    total = 0.0
    for i in range(n):
        u = axes[i]
        for j in range(i):
            v, e = axes[j], _nearest(x, 2 * i, 2 * j, box)
            r2 = dot(e, e)
            if r2 >= end:
                continue
            r = np.sqrt(r2)
            e = e[0] / r, e[1] / r, e[2] / r
            a, b, c = dot(u, e), dot(v, e), dot(u, v)
            U, slope, Ua, Ub, Uc = _pair(r, a, b, c, chi, chi_prime, sigma, shift, scale)
            if r2 > begin * begin:
                S, dS = switched(r2, end, rate)
                U, slope, Ua, Ub, Uc = S * U, S * slope + 2.0 * r * dS * U, S * Ua, S * Ub, S * Uc
            total += U
            along = slope - (a * Ua + b * Ub) / r
            for k in range(3):
                push = along * e[k] + (Ua * u[k] + Ub * v[k]) / r
                forces[2 * i, k] -= push
                forces[2 * j, k] += push
                pulls[i, k] -= Ua * e[k] + Uc * v[k]
                pulls[j, k] -= Ub * e[k] + Uc * u[k]
    for i in range(n):  # keep the component that rotates the axis, and remove the one that would stretch it
        u, stretch = axes[i], dot(pulls[i], axes[i])
        for k in range(3):
            forces[2 * i + 1, k] = (pulls[i, k] - stretch * u[k]) / lengths[i]
            forces[2 * i, k] -= forces[2 * i + 1, k]
    energy[0] = total
