"""Dipole moments and their units."""

from __future__ import annotations

from typing import Any

from openmm import unit

from openmm_exactrb.openmm_access.units import COULOMB
from openmm_exactrb.support import checks

# One debye, 1e-21/c C m, in e nm.
_DEBYE_IN_E_NM = 1e-21 / 299792458.0 / 1.602176634e-19 * 1e9


def dipole_strength(dipole: unit.Quantity | float) -> float:
    """Convert a dipole moment to sqrt(kJ/mol nm³), so that the energy of two dipoles is mu²/r³ times an angular factor.

    Parameters
    ----------
    dipole : Quantity or float
        A moment in units of charge times length (e nm, debye), or a number that is already in sqrt(kJ/mol nm³).

    Raises
    ------
    ValueError
        If the unit is not that of a dipole moment, or the number is not finite.

    Examples
    --------
    >>> from openmm import unit
    >>> round(dipole_strength(2.35 * unit.debye), 4)  # SPC/E water
    0.5767
    """
    quantity: Any = dipole
    if not unit.is_quantity(quantity):
        return checks.number(quantity, "a dipole moment", "sqrt(kJ/mol nm³)")
    if quantity.unit == unit.debye:
        # OpenMM's own factor, 0.0208227 e nm, has a relative error of 1.6e-4.
        debye = checks.number(quantity.value_in_unit(unit.debye), "a dipole moment", "debye")
        return float(debye * _DEBYE_IN_E_NM * COULOMB**0.5)
    try:
        moment = quantity.value_in_unit(unit.elementary_charge * unit.nanometer)
    except TypeError:
        raise ValueError(
            f"{dipole} is not a dipole moment: pass a Quantity in e nm or debye, or a number in sqrt(kJ/mol nm³)"
        ) from None
    return float(checks.number(moment, "a dipole moment", "e nm") * COULOMB**0.5)
