"""The dielectric constant of a dilute gas of dipoles, to the second order in its density, by quadrature."""

import numpy as np
from scipy.special import ive


def dielectric_gas(density, kT, mu2, core, closest=0.3, farthest=30.0):
    """Return eps and y of dipoles with a spherical core.

    With y = 4 pi density mu²/(9 kT) and surroundings that conduct,

        eps - 1 = 3 y (1 + y + density J),    J = integral <cos gamma exp(-u/kT)> d³r,

    up to the square of the density: the moment's fluctuation N mu² (1 + (N - 1) <cos gamma>) with the pair's Boltzmann
    factor, whose uniform part gives y. Without J it is the formula of Clausius and Mossotti to this order. J carries
    the second dielectric virial coefficient (A. D. Buckingham and J. A. Pople, Trans. Faraday Soc. 51, 1029 (1955)).

    Parameters
    ----------
    density, kT, mu2 : float
        In units of one kind: mu2/r³ is an energy.
    core : callable
        Energy of the core at distances r (n,).
    closest, farthest : float
        Between which J is summed: nearer there are no pairs, beyond the integrand falls as r^-7.
    """
    y = 4.0 * np.pi * density * mu2 / (9.0 * kT)
    x, weights = np.polynomial.legendre.leggauss(200)
    log_r = 0.5 * np.log(closest * farthest) + 0.5 * np.log(farthest / closest) * x
    r = np.exp(log_r)
    volumes = 0.5 * np.log(farthest / closest) * weights * 4.0 * np.pi * r**3
    J = np.sum(volumes * correlation(mu2 / (kT * r**3), core(r) / kT))
    return 1.0 + 3.0 * y * (1.0 + y + density * J), y


def correlation(a, core):
    """Return <cos gamma exp(-core - a (sin sin cos phi - 2 cos cos))> (n,); phi is integrated by hand."""
    c, w = np.polynomial.legendre.leggauss(40)
    c1, c2, weight = c[:, None], c[None], 0.25 * w[:, None] * w[None]
    ss, cc = np.sqrt((1.0 - c1**2) * (1.0 - c2**2)), c1 * c2
    a, core = a[:, None, None], core[:, None, None]
    boltzmann = np.exp(a * (2.0 * cc + ss) - core)  # ive leaves exp(-a ss) out
    return np.sum(weight * boltzmann * (cc * ive(0, a * ss) - ss * ive(1, a * ss)), axis=(1, 2))
