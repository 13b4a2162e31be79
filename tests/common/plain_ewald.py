"""The Ewald sum of point dipoles in a cubic box between conductors, in plain numpy: the reference for truncations."""

import numpy as np
from scipy.special import erfc


def dipole_ewald(R, mu, box, alpha):
    """Return the energy of dipoles mu (N, 3) at R (N, 3), and the field (N, 3) on each, its own images included.

    Leeuw, Perram and Smith, Proc. R. Soc. A 373, 27 (1980). Real space ends at half the box, reciprocal space where
    its Gaussian is as small: about exp(-(alpha box/2)²).
    """
    r = R[:, None] - R[None]
    r -= box * np.rint(r / box)
    d = np.linalg.norm(r, axis=2)
    d[(d == 0.0) | (d > 0.5 * box)] = np.inf
    gauss = 2.0 * alpha / np.pi**0.5 * np.exp(-((alpha * d) ** 2)) / d**2
    B = erfc(alpha * d) / d**3 + gauss
    C = 3.0 * erfc(alpha * d) / d**5 + gauss * (2.0 * alpha**2 + 3.0 / d**2)
    field = np.einsum("ij,ijk->ik", C * np.einsum("ijk,jk->ij", r, mu), r) - B @ mu

    largest = int(np.ceil((alpha * box) ** 2 / (2.0 * np.pi)))
    n = np.mgrid[3 * [slice(-largest, largest + 1)]].reshape(3, -1).T
    n = n[((n**2).sum(axis=1) > 0) & ((n**2).sum(axis=1) <= largest**2)]
    k = 2.0 * np.pi / box * n
    k2 = (k**2).sum(axis=1)
    phase = np.exp(1j * R @ k.T)
    structure = (mu @ k.T * phase).sum(axis=0)
    weight = 4.0 * np.pi / box**3 * np.exp(-k2 / (4.0 * alpha**2)) / k2
    field -= (weight * structure.conj() * phase).real @ k
    field += 4.0 * alpha**3 / (3.0 * np.pi**0.5) * mu
    return -0.5 * np.sum(mu * field), field
