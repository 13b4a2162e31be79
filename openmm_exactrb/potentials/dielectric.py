"""The static dielectric constant from the fluctuations of the total dipole moment."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from openmm_exactrb.support import checks

_ASKED = (
    "rows of three numbers in sqrt(kJ/mol nm³), without a unit: moments in e nm times "
    "dipole_strength(1 * elementary_charge * nanometer)"
)
_LARGEST = 1e100  # largest moment, so that squares and their sums stay finite


def reaction(dielectric: float) -> float:
    """Return the factor 2 (eps - 1)/(2 eps + 1) of the reaction field of a medium; raise ValueError if eps < 1."""
    if not (dielectric == np.inf or checks.number(dielectric, "dielectric") >= 1.0):
        raise ValueError(f"dielectric must be at least 1, not {dielectric}")
    return float(2.0 * (1.0 - 1.0 / dielectric) / (2.0 + 1.0 / dielectric))


def dielectric_constant(
    moments: ArrayLike, volume: float, kT: float, *, dielectric: float = np.inf, blocks: int = 20
) -> tuple[float, float]:
    """Return the dielectric constant and its standard error from total dipole moments sampled in equilibrium.

    For a total moment M in a volume V, with x = 4 pi <M²>/(9 V kT) and Q = 2 (eps' - 1)/(2 eps' + 1), where eps' is the
    dielectric constant of the surroundings, the dielectric constant is

        eps = (1 + (Q + 2) x)/(1 + (Q - 1) x).

    The formula holds for every dipole interaction in which a uniform polarisation produces the reaction field of these
    surroundings (Neumann, Mol. Phys. 50, 841 (1983)). In conducting surroundings (an Ewald sum or a reaction field
    with dielectric=inf) the formula reduces to eps = 1 + 3 x, and with eps' = 1 to the Clausius-Mossotti formula.

    Parameters
    ----------
    moments : (n, 3) array_like
        Total dipole moments in sqrt(kJ/mol nm³) at equal intervals of time. Multiply moments in e nm by
        ``dipole_strength(1 * elementary_charge * nanometer)``.
    volume : float
        Volume of the box, in nm³.
    kT : float
        Boltzmann constant times temperature, in kJ/mol.
    dielectric : float
        Dielectric constant eps' of the surroundings, as in the `ReactionField` or `Ewald` of the run.
    blocks : int
        Number of blocks into which the run is divided to estimate the error. Each block should be much longer than the
        correlation time of the moment.

    Returns
    -------
    value : float
        The dielectric constant; infinity if the fluctuations of M exceed the limit of the formula for these
        surroundings.
    error : float
        Standard error, estimated from the block means of Mx², My² and Mz², which are independent and have the same
        expectation.

    Raises
    ------
    ValueError
        If there are fewer moments than blocks or fewer than two blocks, if moments are not finite or have a unit, or if
        a number is out of range.

    Notes
    -----
    Without an external field, <M> is zero. This mean is not estimated from the run, because deviations from the mean of
    a short run underestimate the fluctuations.
    """
    M = checks.array(moments, "moments", _ASKED)
    if M.ndim != 2 or M.shape[1] != 3:
        raise ValueError(f"moments must have the shape (n, 3), with one row for each of n frames, not {M.shape}")
    if not (fine := (np.abs(M) < _LARGEST).all(axis=1)).all():
        row = int(np.argmin(fine))
        raise ValueError(f"moments must be finite numbers below {_LARGEST:g}, but row {row} is {M[row].tolist()}")
    if not 2 <= checks.whole(blocks, "blocks", least=0) <= len(M):
        raise ValueError(f"blocks must be between 2 and the number of moments, {len(M)}, not {blocks}")
    volume, kT = checks.positive(volume, "volume", "nm³"), checks.positive(kT, "kT", "kJ/mol")
    Q = reaction(dielectric)
    means = np.array([np.mean(block**2, axis=0) for block in np.array_split(M, blocks)])
    scale = 4.0 * np.pi / (9.0 * volume * kT)
    x = scale * float(np.sum(np.mean(M**2, axis=0)))
    # Standard error of the sum of three components, each a mean over the blocks.
    spread = scale * 3.0 * float(np.std(means, ddof=1)) / means.size**0.5
    left = 1.0 + (Q - 1.0) * x
    if left <= 0.0:
        return np.inf, np.inf
    return (1.0 + (Q + 2.0) * x) / left, 3.0 * spread / left**2
