"""The bonded forces of a System: which they are, and their groups."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import openmm

#: What the bonded forces of a System are.
BONDED_FORCES = (
    openmm.HarmonicBondForce,
    openmm.HarmonicAngleForce,
    openmm.PeriodicTorsionForce,
    openmm.RBTorsionForce,
    openmm.CMAPTorsionForce,
    openmm.CustomBondForce,
    openmm.CustomAngleForce,
    openmm.CustomTorsionForce,
)
#: Coulomb's constant in kJ nm/mol/e², from the numbers that OpenMM makes its own of.
COULOMB = (1.602176634e-19) ** 2 * 6.02214076e23 * 1e6 / (4.0 * math.pi * 8.8541878128e-12)
#: The formula of exceptions of a NonbondedForce.
PAIR = f"{COULOMB!r}*charges/r + 4*epsilon*((sigma/r)^12 - (sigma/r)^6)"
# What acts between steps has no forces on atoms.
_NO_FORCES = ("AndersenThermostat", "CMMotionRemover")
_GROUPS = 32


def separate_bonded(system: openmm.System) -> int:
    """Move the bonded forces of a System to a separate force group, for OpenMM's ``MTSIntegrator`` and ``fast=(1,)``.

    Bonded forces are HarmonicBondForce, HarmonicAngleForce, PeriodicTorsionForce, RBTorsionForce, CMAPTorsionForce,
    CustomBondForce, CustomAngleForce and CustomTorsionForce. Energies and forces do not change. Call it before the
    Context is created.

    Parameters
    ----------
    system : openmm.System
        The System, which is changed: its bonded forces are moved to the first group that contains no other force.

    Returns
    -------
    int
        That group.

    Raises
    ------
    ValueError
        If it is not a System, or no group is free of other forces.
    """
    if not isinstance(system, openmm.System):
        raise ValueError(
            f"separate_bonded() takes an openmm.System, before it is in a Simulation, not {type(system).__name__}"
        )
    others = {
        group for force in system.getForces() if not isinstance(force, BONDED_FORCES) for group in groups_of(force)
    }
    free = [group for group in range(_GROUPS) if group not in others]
    if not free:
        raise ValueError("the System uses all 32 force groups: put two of its forces into the same group")
    for force in system.getForces():
        if isinstance(force, BONDED_FORCES):
            force.setForceGroup(free[0])
    return free[0]


def interacting_exceptions(force: openmm.NonbondedForce) -> list[tuple[Any, ...]]:
    """Return the exceptions that interact: particles, product of charges, sigma and epsilon of each."""
    if not force.getIncludeDirectSpace():  # where OpenMM has them
        return []
    exceptions = map(force.getExceptionParameters, range(force.getNumExceptions()))
    return [tuple(exception) for exception in exceptions if exception[2]._value or exception[4]._value]


def pairs_by_formula(force: openmm.NonbondedForce, pairs: Iterable[tuple[Any, ...]]) -> openmm.CustomBondForce:
    """Return a force of pairs that interact as exceptions of a NonbondedForce, in its group."""
    apart = openmm.CustomBondForce(PAIR)
    for name in ("charges", "sigma", "epsilon"):
        apart.addPerBondParameter(name)
    cut = force.getNonbondedMethod() != openmm.NonbondedForce.NoCutoff  # without, OpenMM ignores what follows
    apart.setUsesPeriodicBoundaryConditions(cut and force.getExceptionsUsePeriodicBoundaryConditions())
    for i, j, charges, sigma, epsilon in pairs:
        apart.addBond(i, j, [getattr(value, "_value", value) for value in (charges, sigma, epsilon)])
    apart.setName(f"exceptions of {force.getName()}")
    apart.setForceGroup(force.getForceGroup())
    return apart


def acting(system: openmm.System) -> list[Any]:
    """Return the forces of a System that act on particles within a step."""
    return [force for force in system.getForces() if acts(force)]


def acts(force: Any) -> bool:
    """Return whether a force acts on particles within a step: no thermostat or barostat does."""
    name = type(force).__name__
    return name not in _NO_FORCES and "Barostat" not in name


def others(system: openmm.System) -> bool:
    """Return whether a System has forces on particles that are not bonded ones."""
    return any(not isinstance(force, BONDED_FORCES) for force in acting(system))


def groups_of(force: Any) -> set[int]:
    """Return the force groups of a force: two where the reciprocal part of an Ewald sum has its own."""
    own = getattr(force, "getReciprocalSpaceForceGroup", lambda: -1)()
    return {force.getForceGroup()} | ({own} if own >= 0 else set())
