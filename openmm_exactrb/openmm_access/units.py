"""Conversion of a user's Quantities and plain numbers to plain numbers in a given unit."""

from __future__ import annotations

import math
from typing import Any

from openmm import unit

from openmm_exactrb.support import checks

#: OpenMM's unit of a force.
FORCE = unit.kilojoule_per_mole / unit.nanometer
RATE = unit.picosecond**-1
#: Coulomb's constant in kJ/mol nm/e², from CODATA 2018, as in OpenMM.
COULOMB = 1.602176634e-19**2 * 6.02214076e23 * 1e6 / (4.0 * math.pi * 8.8541878128e-12)


def plain(value: Any, in_unit: unit.Unit, what: str) -> float:
    """Return a value as a finite number in a unit; a plain number is assumed to be in this unit.

    Raises
    ------
    ValueError
        If the value is not a finite number, or has an incompatible unit.
    """
    quantity: Any = value
    if unit.is_quantity(value):
        if not quantity.unit.is_compatible(in_unit):
            raise ValueError(
                f"{value} is not {what}: pass a number in {_symbol(in_unit)}, or a Quantity with compatible units"
            )
        quantity = quantity.value_in_unit(in_unit)
    return checks.number(quantity, what, _symbol(in_unit))


def _symbol(of: unit.Unit) -> str:
    """Return the symbol of a unit, such as 1/ps, for which OpenMM has the symbol /ps."""
    symbol = str(of.get_symbol())
    return f"1{symbol}" if symbol.startswith("/") else symbol


def stripped(value: Any, in_unit: unit.Unit) -> Any:
    """Return a compatible Quantity as a number in the unit, and everything else unchanged, for a later check."""
    fits = unit.is_quantity(value) and value.unit.is_compatible(in_unit)
    return value.value_in_unit(in_unit) if fits else value


def picoseconds(size: float | unit.Quantity | None) -> float:
    """Return a time step in ps; raise ValueError if it is negative, because OpenMM has no backward steps."""
    return not_negative(size, unit.picosecond, "a time step")


def not_negative(value: Any, in_unit: unit.Unit, what: str) -> float:
    """Return a finite number of at least 0 in a unit; see `plain`."""
    number = plain(value, in_unit, what)
    if number < 0.0:
        raise ValueError(f"{what} must be at least 0, not {value}")
    return number


def kelvin(temperature: float | unit.Quantity) -> float:
    """Return a temperature in K; raise ValueError if it is negative."""
    return not_negative(temperature, unit.kelvin, "a temperature")


def gas_constant_times(temperature: float | unit.Quantity) -> float:
    """Return RT in kJ/mol for a temperature, in K if it has no unit."""
    return float((kelvin(temperature) * unit.kelvin * unit.MOLAR_GAS_CONSTANT_R).value_in_unit(unit.kilojoule_per_mole))


def check_first_arguments(step: Any, scheme: Any) -> None:
    """Raise ValueError if the first arguments of ExactRigidBodyIntegrator are a temperature and a friction."""
    warm = unit.is_quantity(step) and step.unit.is_compatible(unit.kelvin)
    if warm or unit.is_quantity(scheme) or isinstance(scheme, (int, float)):
        raise ValueError(
            "ExactRigidBodyIntegrator takes a step size and the name of a scheme, such as "
            "ExactRigidBodyIntegrator(0.004*picoseconds, 'S2_2'), but no temperature or friction: use "
            "ExactRigidBodyLangevinIntegrator for these"
        )
