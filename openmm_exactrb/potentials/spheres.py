"""The cutoff of the spheres of dipole fluids, which is part of the model, and its long-range correction.

The switch of `openmm_exactrb.potentials.switching` takes the energy of a pair smoothly to zero. The correction adds the
mean of the removed energy of all pairs of N spheres with the pair energy u. The pair distribution is assumed to be 0 up
to the diameter sigma of a sphere, since spheres do not overlap, and 1 - 1/N beyond it, since N - 1 other spheres are in
the volume V:

    U = 2 pi N (N - 1)/V integral from sigma to infinity of (u - S (u - u_c)) r² dr,    P = U/V,

with u_c = u(cutoff) for a shifted potential, and 0 otherwise. Energy and pressure then depend only weakly on the
cutoff, and the second virial coefficient is that of the complete potential to first order in the removed energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import openmm

from openmm_exactrb.potentials.boundaries import check_cutoff
from openmm_exactrb.support import checks

#: The customary cutoff, in units of the diameter of a sphere.
CUSTOMARY = 3.0


class SphereCutoff(NamedTuple):
    """The cutoff and the start of the switch of the energy of two spheres, in nm."""

    cutoff: float
    switch: float
    shifted: bool  #: whether the energy at the cutoff is subtracted first


def cutoff_in(
    edges: Sequence[float] | None, sigma: float, cutoff: float | None, switch: float | None, *, shifted: bool
) -> SphereCutoff | None:
    """Return the given or default cutoff in a box with these edges (nm); raise ValueError if the cutoff is too long."""
    if edges is None:
        if cutoff is not None or switch is not None or shifted:
            raise ValueError(
                "sphere_cutoff=, sphere_switch= and shifted= need a periodic box: add boundary=ReactionField() or "
                "boundary=Ewald(), or omit these arguments"
            )
        return None
    half = 0.5 * min(edges)
    end = min(CUSTOMARY * sigma, half) if cutoff is None else checks.positive(cutoff, "sphere_cutoff", "nm")
    check_cutoff(end, edges, "sphere_cutoff")
    begin = 0.75 * end if switch is None else checks.not_negative(switch, "sphere_switch")
    if not begin < end:
        raise ValueError(f"sphere_switch must be below the sphere_cutoff of {end:g} nm, not {begin:g} nm")
    return SphereCutoff(float(end), float(begin), bool(shifted))


def long_range_correction(
    n: int,
    edges: Sequence[float] | None,
    *,
    sigma: float,
    epsilon: float,
    attraction: float,
    wca: bool,
    sphere_cutoff: float | None,
    sphere_switch: float | None,
    shifted: bool,
) -> openmm.CustomVolumeForce:
    """Return a force whose energy is the long-range correction for n spheres, a function of the volume only.

    The arguments and the Context parameters `soft_repulsion` and, with an attraction, `soft_attraction` are those of
    `soft_dipole_force`. A ValueError is raised for spheres without a cutoff, or with a cutoff within their diameter.
    """
    spheres = None if wca else cutoff_in(edges, sigma, sphere_cutoff, sphere_switch, shifted=shifted)
    if spheres is None:
        raise ValueError(
            "long_range_correction needs a periodic box and spheres without wca: omit long_range_correction="
        )
    if not spheres.cutoff > sigma:
        raise ValueError(
            f"a long-range correction needs a sphere_cutoff beyond the diameter of the spheres, {sigma:g} nm, not of "
            f"{spheres.cutoff:g} nm: use more spheres, a lower density or a longer cutoff, or omit "
            "long_range_correction="
        )
    of_repulsion, of_attraction = (2.0 * np.pi * n * (n - 1) * _beyond(spheres, sigma, p) for p in (12, 6))
    attracts = f" - {float(of_attraction)!r}*soft_attraction" if attraction else ""
    force = openmm.CustomVolumeForce(f"({float(of_repulsion)!r}*soft_repulsion{attracts})/v")
    force.addGlobalParameter("soft_repulsion", 4.0 * epsilon * sigma**12)
    if attraction:
        force.addGlobalParameter("soft_attraction", 4.0 * epsilon * sigma**6 * attraction)
    force.setName("LongRangeCorrection")
    return force


def _beyond(spheres: SphereCutoff, sigma: float, p: int) -> float:
    """Return the integral of (u - S (u - u_c)) r² from sigma to infinity for u = r^-p."""
    from scipy.special import betainc  # imported here, because it is slow to import

    cutoff, switch, shifted = spheres
    begin, shift = max(switch, sigma), cutoff ** float(-p) if shifted else 0.0
    x, weights = np.polynomial.legendre.leggauss(60)  # for the integral within the switch
    r = begin + 0.5 * (cutoff - begin) * (1.0 + x)
    taken = betainc(7.0, 7.0, (r**2 - switch**2) / (cutoff**2 - switch**2))  # 1 - S without cancellation
    within = 0.5 * (cutoff - begin) * float(weights @ ((taken * r ** float(-p) + (1.0 - taken) * shift) * r**2))
    before: float = shift * (begin**3 - sigma**3) / 3.0
    beyond: float = cutoff ** (3.0 - p) / (p - 3.0)
    return before + within + beyond
