"""Potentials between rigid bodies as OpenMM forces; each is one function that returns a Force.

OpenMM's units, amu, nm, ps and kJ/mol, are a consistent set: reduced units map to them one to one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import openmm
from openmm import unit

# Coulomb's constant in kJ/mol nm/e², CODATA 2018, as OpenMM has it.
_COULOMB = 138.93545764438198
# 1 D = 1e-21/c C m, over the elementary charge.
_DEBYE_IN_E_NM = 1e-21 / 299792458.0 / 1.602176634e-19 * 1e9


def dipole_strength(dipole: unit.Quantity | float) -> float:
    """Convert a dipole moment to sqrt(kJ/mol nm³), where the energy of two dipoles is mu²/r³ times an angle's factor.

    Parameters
    ----------
    dipole : Quantity or float
        A moment in units of charge times length (e nm, debye), or a number that already is in sqrt(kJ/mol nm³).

    Raises
    ------
    ValueError
        If the unit is not one of a dipole moment.

    Examples
    --------
    >>> from openmm import unit
    >>> round(dipole_strength(2.35 * unit.debye), 4)  # SPC/E water
    0.5767
    """
    quantity: Any = dipole
    if not unit.is_quantity(quantity):
        return float(quantity)
    if quantity.unit == unit.debye:
        # OpenMM's own factor, 0.0208227 e nm, is off by 1.6e-4.
        quantity = quantity._value * _DEBYE_IN_E_NM * unit.elementary_charge * unit.nanometer
    try:
        return float(quantity.value_in_unit(unit.elementary_charge * unit.nanometer) * _COULOMB**0.5)
    except TypeError:
        raise ValueError(
            f"{dipole} is not a dipole moment: give it in e nm or debye, or as a number in sqrt(kJ/mol nm^3)"
        ) from None


def soft_dipole_force(
    arrows: Sequence[tuple[int, int]],
    *,
    strength: float,
    length: float,
    sigma: float = 1.0,
    epsilon: float = 1.0,
) -> openmm.CustomCompoundBondForce:
    """Soft spheres with a point dipole: 4 epsilon (sigma/r)^12 + mu_i.mu_j/r³ - 3 (mu_i.r)(mu_j.r)/r^5 over all pairs.

    Section 3.4 of the paper.

    Parameters
    ----------
    arrows : sequence of (centre, tip)
        Particles or virtual sites of each body: its centre, and a point at `length` from it along its dipole.
    strength : float
        Dipole moment in sqrt(kJ/mol nm³).
    length : float
        Distance between centre and tip in nm.
    sigma, epsilon : float
        In nm and kJ/mol.

    Returns
    -------
    openmm.CustomCompoundBondForce

    Notes
    -----
    Products of coordinates, one reciprocal and one square root: OpenMM's compiler makes this three times faster than
    the same energy in `distance` or in powers of r.
    """
    force = openmm.CustomCompoundBondForce(
        4,
        "soft_repulsion*i^6 + dipole_coupling*i3*(ux*vx + uy*vy + uz*vz - 3*i*ur*vr);"
        "ur = ux*x + uy*y + uz*z; vr = vx*x + vy*y + vz*z;"
        "i3 = i*sqrt(i); i = 1/(x*x + y*y + z*z);"
        "x = x1 - x3; y = y1 - y3; z = z1 - z3;"
        "ux = x2 - x1; uy = y2 - y1; uz = z2 - z1;"
        "vx = x4 - x3; vy = y4 - y3; vz = z4 - z3",
    )
    force.setName("SoftDipoleForce")
    force.addGlobalParameter("soft_repulsion", 4.0 * epsilon * sigma**12)
    force.addGlobalParameter("dipole_coupling", (strength / length) ** 2)
    for (centre1, tip1), (centre2, tip2) in itertools.combinations(arrows, 2):
        force.addBond([centre1, tip1, centre2, tip2], [])
    return force
