"""The pair sum of soft dipoles in compiled double precision.

Every sphere sums over all others, so that a pair is computed twice: rows are independent, the inner loop is vectorised,
and any number of threads gives the same bits.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from openmm_exactrb.kernels.build import inlined, reordered
from openmm_exactrb.kernels.compiled.ewald import number_of_waves, reciprocal_space
from openmm_exactrb.kernels.threads import cores, in_threads

Array = NDArray[np.float64]
Truncation = tuple[float, float, float, float, float, float]
Ewald = tuple[float, float, float]

# Fewer pairs than this are not worth a second thread. Ten waves of a dipole cost as much as three pairs, and a screened
# pair as much as three others.
_SHARED = 200_000

# Distance in widths of the Gaussian at which a screened dipole ends: exp(-6.5²) is 4e-19.
_FAR = 6.5


def soft_dipoles(
    x: Array,
    repulsion: float,
    coupling: float,
    truncation: Truncation | None = None,
    threads: int | None = None,
    attraction: float | None = None,
    minimum: tuple[float, float] | None = None,
    ewald: Ewald | None = None,
) -> tuple[float, Array]:
    """Return the energy (kJ/mol) and the forces (kJ/mol/nm) of `potentials.soft_dipole_force`.

    Parameters
    ----------
    x : (2 n, 3) array
        Positions (nm): centre and tip of the first arrow, of the second, ...
    repulsion, coupling : float
        4 epsilon sigma^12 and (strength/length)².
    truncation : tuple of six floats, optional
        For periodic boundaries: edges of the box, squared cutoff, 1/(width of the switch in r²), strength of the
        reaction field.
    threads : int, optional
        By default all cores, where the pairs are worth it. Any number gives the same bits.
    attraction : float, optional
        4 epsilon sigma^6.
    minimum : (squared distance, depth), optional
        Where the energy of the spheres ends, raised by the depth (Weeks, Chandler and Andersen).
    ewald : (alpha, k_max, dielectric), optional
        Inverse width of the Gaussians of an Ewald sum, its largest wave number, and relative permittivity outside.
    """
    if ewald and truncation is None:
        raise ValueError("an Ewald sum needs a box")
    n = len(x) // 2
    waves = number_of_waves(truncation[:3], ewald[1]) if ewald and truncation else 0
    threads = threads or (cores() if n * (n + waves / 10) > _SHARED else 1)
    forces, energies = np.empty((2 * n, 3)), np.empty(n)
    alpha = ewald and ewald[0]

    def sum_rows(*rows: int) -> None:
        _rows(*rows, x, repulsion, coupling, attraction, minimum, alpha, truncation, energies, forces)

    in_threads(sum_rows, np.ones(n, dtype=np.int64), threads)
    energy = 0.5 * float(energies.sum())
    if ewald and truncation:
        arrows = _split(x)
        far, pull, field = reciprocal_space(arrows[:3], arrows[3:], truncation[:3], *ewald, threads)
        energy += coupling * far
        forces[0::2] += coupling * (pull - field).T[:n]
        forces[1::2] += coupling * field.T[:n]
    return energy, forces


@reordered
def _split(x):
    """Return centres and arrows (tip minus centre), component-first, padded to full vector registers."""
    n = len(x) // 2
    arrows = np.zeros((6, (n + 7) // 8 * 8))
    for i in range(n):
        for k in range(3):
            arrows[k, i] = x[2 * i, k]
            arrows[3 + k, i] = x[2 * i + 1, k] - x[2 * i, k]
    return arrows


def _polynomial(coefficients):
    highest, *others = map(float, coefficients[::-1])
    rest = np.array(others)

    @inlined
    def polynomial(x):
        value = highest
        for k in range(len(rest)):
            value = value * x + rest[k]
        return value

    return polynomial


def _scaled_erfc(t):  # scipy's would cost its import, which takes half as long as numba's
    x = 2.0 * (1.0 + t) / (1.0 - t)
    return math.exp(x * x) * math.erfc(x)


# Polynomials, because calls of a library would not be vectorised: the 32nd root of exp(-s) in s about its middle, and
# exp(x²) erfc(x) in t = (x - 2)/(x + 2).
_MIDDLE = 0.5 * _FAR**2
_root_of_exp = _polynomial([math.exp(-_MIDDLE / 32.0) / math.factorial(k) for k in range(17)])
_erfcx = _polynomial(
    Chebyshev.interpolate(np.vectorize(_scaled_erfc), 19, [-1.0, (_FAR - 2.0) / (_FAR + 2.0)])
    .convert(kind=Polynomial)
    .coef
)


@inlined
def screened(r2, i, alpha):
    """Return B1, B2 and B3 of a pair with the energy B1 u.v - B2 u.r v.r; the derivative of each is -r the next."""
    s = min(alpha * alpha * r2, _FAR**2)
    x = math.sqrt(s)
    gauss = _root_of_exp((_MIDDLE - s) / 32.0)
    for _ in range(5):
        gauss *= gauss
    slope = 2.0 / math.sqrt(math.pi) * x * gauss
    b1 = gauss * _erfcx((x - 2.0) / (x + 2.0)) + slope
    b2 = 3.0 * b1 + 2.0 * s * slope
    b3 = 5.0 * b2 + 4.0 * s * s * slope
    b = i * math.sqrt(i)
    return b * b1, b * i * b2, b * i * i * b3


@inlined
def pair(r2, uv, ur, vr, repulsion, coupling, attraction=None, minimum=None, alpha=None):
    """Return energy, and a, b, c of the force a r + c (ur v + vr u) on the centre and c vr r - b v on the tip."""
    i = 1.0 / r2
    core = repulsion * (i * i * i) * (i * i * i)
    slope = 12.0 * core
    if attraction is not None:
        i3 = attraction * (i * i * i)
        core -= i3
        slope -= 6.0 * i3
    if minimum is not None:
        core = core + minimum[1] if r2 < minimum[0] else 0.0
        slope = slope if r2 < minimum[0] else 0.0
    if alpha is None:
        b = coupling * i * math.sqrt(i)
        c = 3.0 * b * i
        d = 5.0 * c * i
    else:
        b, c, d = screened(r2, i, alpha)
        b, c, d = coupling * b, coupling * c, coupling * d
    return core + b * uv - c * ur * vr, i * slope + c * uv - d * ur * vr, b, c


@reordered
def truncated(r2, uv, energy, a, b, c, coupling, truncation):
    """Add the reaction field, and multiply by a switch S(r²) that is smooth to the sixth derivative."""
    _, _, _, end, rate, reaction = truncation
    b -= coupling * reaction
    energy -= coupling * reaction * uv
    s = min(1.0, max(0.0, (end - r2) * rate))
    t = 2.0 * s - 1.0
    u = t * t
    odd = 3003.0 - u * (6006.0 - u * (9009.0 - u * (8580.0 - u * (5005.0 - u * (1638.0 - u * 231.0)))))
    S = 0.5 + t * odd / 2048.0
    slope = -12012.0 * rate * (s * (1.0 - s)) ** 6
    return S * energy, S * a - 2.0 * slope * energy, S * b, S * c


@reordered
def _rows(first, last, sites, repulsion, coupling, attraction, minimum, alpha, truncation, energies, forces):
    """Sum twice the energy, and the forces, of some spheres with all others."""
    n, arrows = len(energies), _split(sites)
    for i in range(first, last):
        xi, yi, zi, ux, uy, uz = arrows[:, i]
        energy = fx = fy = fz = gx = gy = gz = turn = 0.0
        for j in range(arrows.shape[1]):
            x, y, z = xi - arrows[0, j], yi - arrows[1, j], zi - arrows[2, j]
            vx, vy, vz = arrows[3, j], arrows[4, j], arrows[5, j]
            if truncation is not None:
                x -= truncation[0] * np.rint(x / truncation[0])
                y -= truncation[1] * np.rint(y / truncation[1])
                z -= truncation[2] * np.rint(z / truncation[2])
            r2 = x * x + y * y + z * z if (j != i) & (j < n) else np.inf
            uv, ur, vr = ux * vx + uy * vy + uz * vz, ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
            e, a, b, c = pair(r2, uv, ur, vr, repulsion, coupling, attraction, minimum, alpha)
            if truncation is not None:
                e, a, b, c = truncated(r2, uv, e, a, b, c, coupling, truncation)
            energy += e
            fx, fy, fz = fx + a * x + c * ur * vx, fy + a * y + c * ur * vy, fz + a * z + c * ur * vz
            gx, gy, gz = gx + c * vr * x - b * vx, gy + c * vr * y - b * vy, gz + c * vr * z - b * vz
            turn += c * vr
        energies[i] = energy
        # The potential moves a centre at a fixed arrow: its particle loses what the tip gets.
        forces[2 * i] = fx + turn * ux - gx, fy + turn * uy - gy, fz + turn * uz - gz
        forces[2 * i + 1] = gx, gy, gz
