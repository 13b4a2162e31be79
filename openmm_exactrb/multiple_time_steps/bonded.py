"""The bonded forces of a System: their types, their groups, and their terms as arrays."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.openmm_access import parameters
from openmm_exactrb.openmm_access.units import COULOMB
from openmm_exactrb.support.types import Array, Indices

#: The types of bonded forces.
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
#: The formula of exceptions of a NonbondedForce, and the names of their numbers.
PAIR, _OF_PAIR = f"{COULOMB!r}*charges/r + 4*epsilon*((sigma/r)^12 - (sigma/r)^6)", ("charges", "sigma", "epsilon")
# Names of parameters that the formula of exceptions with offsets can contain.
_USABLE = re.compile(r"(?!(charges|sigma|epsilon)\d*$|r$)[A-Za-z_]\w*", re.ASCII)
#: The formula of pairs three bonds apart in OpenMM's CHARMM force fields, without blanks.
LENNARD_JONES = re.compile(r"([\d.]+)\*epsilon\*\(\(sigma/r\)\^12-\(sigma/r\)\^6\)")
# The integers of a term that are particles, for forces with further integers.
_PARTICLES = {openmm.PeriodicTorsionForce: slice(0, 4), openmm.CMAPTorsionForce: slice(1, 9)}
# The lists of terms in the XML of a force; maps are listed as torsions.
_LISTS = re.compile(r"<(Bonds|Angles|Torsions)>.*?</\1>", re.DOTALL)
# Forces of these types act between steps and exert no forces on atoms.
_NO_FORCES = ("AndersenThermostat", "CMMotionRemover")
_GROUPS = 32
_CUSTOM = openmm.CustomBondForce, openmm.CustomAngleForce, openmm.CustomTorsionForce


def separate_bonded(system: openmm.System) -> int:
    """Move the bonded forces of a System to a separate force group, for OpenMM's ``MTSIntegrator`` and for ``fast=``.

    Bonded forces are HarmonicBondForce, HarmonicAngleForce, PeriodicTorsionForce, RBTorsionForce, CMAPTorsionForce,
    CustomBondForce, CustomAngleForce and CustomTorsionForce. Energies and forces do not change. Call this function
    before the Context is created.

    Parameters
    ----------
    system : openmm.System
        The System, which is modified: its bonded forces are moved to the first group that contains no other force.

    Returns
    -------
    int
        The number of this force group.

    Raises
    ------
    ValueError
        If the argument is not a System, or if every force group contains forces that are not bonded.
    """
    if not isinstance(system, openmm.System):
        raise ValueError(
            f"separate_bonded() takes an openmm.System, not {type(system).__name__}: pass the System, before you "
            "create a Simulation with it"
        )
    others = {
        group for force in system.getForces() if not isinstance(force, BONDED_FORCES) for group in groups_of(force)
    }
    free = [group for group in range(_GROUPS) if group not in others]
    if not free:
        raise ValueError(
            "all 32 force groups contain forces other than bonded forces, which need a group of their own: put two of "
            "the other forces into the same group with force.setForceGroup"
        )
    for force in system.getForces():
        if isinstance(force, BONDED_FORCES):
            force.setForceGroup(free[0])
    return free[0]


class Bonded(NamedTuple):
    """Some or all of the bonds, angles or torsions of a force, with its functional form and force group.

    Attributes
    ----------
    force : openmm.Force
    whole : (n, k) array
        Integers of each term, including its particles, in OpenMM's order.
    numbers : (n, m) array
    """

    force: Any
    whole: Indices
    numbers: Array

    @classmethod
    def of(cls, force: Any) -> Bonded:
        """Return the terms of a bonded force."""
        return cls(force, *parameters.terms(force))

    @property
    def particles(self) -> Indices:
        """The particles of each term."""
        return self.whole[:, _PARTICLES.get(type(self.force), slice(None))]

    def chosen(self, which: NDArray[np.bool_]) -> Bonded:
        """Return the terms that a mask (n,) selects."""
        return self._replace(whole=self.whole[which], numbers=self.numbers[which])

    def numbered(self, number: NDArray[Any]) -> Bonded:
        """Return the terms with renumbered particles; `number` maps old numbers to new ones."""
        there = self._replace(whole=self.whole.copy())
        there.particles[:] = number[self.particles]
        return there

    def made(self) -> Any:
        """Return an OpenMM force that has only these terms."""
        force = openmm.XmlSerializer.deserialize(_LISTS.sub(r"<\1/>", openmm.XmlSerializer.serialize(self.force)))
        add = next(getattr(force, name) for name in ("addBond", "addAngle", "addTorsion") if hasattr(force, name))
        custom = isinstance(force, _CUSTOM)
        for whole, numbers in zip(self.whole.tolist(), self.numbers.tolist(), strict=True):
            add(*whole, *([numbers] if custom else numbers))
        return force


class BondedNumbers:
    """The numbers of bonded forces and exceptions that join different bodies, which a user may change between steps.

    The numbers are those of the System. They need not yet be those of the Context, because the kicks apply the forces
    of the Context minus the fast forces.
    """

    def __init__(self, system: openmm.System, joining: Sequence[int]) -> None:
        self._joining, self._count = joining, system.getNumForces()
        self._numbers = self._read(system)

    @classmethod
    def of(cls, system: openmm.System, owner: Indices) -> BondedNumbers | None:
        """Return the numbers of a System whose particles belong to bodies `owner`, or None if no such force exists."""
        joining = [k for k, force in enumerate(system.getForces()) if _joins(force, owner)]
        return cls(system, joining) if joining else None

    def changed(self, system: openmm.System) -> bool:
        """Return whether any number has changed since this method was last called."""
        if system.getNumForces() != self._count:  # the Context needs `reinitialize` first
            return False
        before, self._numbers = self._numbers, self._read(system)
        same = len(before) == len(self._numbers) and all(map(np.array_equal, before, self._numbers))
        return not same

    def _read(self, system: openmm.System) -> list[NDArray[Any]]:
        numbers: list[NDArray[Any]] = []
        for force in map(system.getForce, self._joining):
            numbers.append(_terms(force)[1])
            if isinstance(force, openmm.NonbondedForce) and force.getNumExceptionParameterOffsets():
                numbers += map(np.asarray, parameters.exception_offsets(force))
        return numbers


def _terms(force: Any) -> parameters.TermRows:
    """Return the terms of a bonded force, or the exceptions of a NonbondedForce."""
    return parameters.exceptions(force) if isinstance(force, openmm.NonbondedForce) else parameters.terms(force)


def _joins(force: Any, owner: Indices) -> bool:
    """Return whether a force has terms or exceptions between particles of different bodies."""
    if not isinstance(force, (*BONDED_FORCES, openmm.NonbondedForce)):
        return False
    whole = _terms(force)[0]
    if isinstance(force, BONDED_FORCES):
        whole = Bonded(force, whole, np.zeros(0)).particles
    bodies = owner[whole]
    return bool((bodies != bodies[:, :1]).any())


def interacting_exceptions(force: openmm.NonbondedForce) -> list[Bonded]:
    """Return the interacting exceptions of a force as bonds in its group: those without and those with offsets.

    Bonds have the formula `PAIR`. With offsets, the numbers in the formula depend on parameters of the Context. Offsets
    by a parameter whose name no formula can contain are omitted.
    """
    (whole, numbers), (names, place, scales) = parameters.exceptions(force), parameters.exception_offsets(force)
    usable = np.array([bool(_USABLE.fullmatch(name)) for name in names], dtype=bool)
    given = sorted({name for name, is_usable in zip(names, usable, strict=True) if is_usable})
    offsets = np.zeros((len(given), len(whole), 3))
    for name, exception, of in zip(np.array(names)[usable], place[usable], scales[usable], strict=True):
        offsets[given.index(name), exception] += of
    changing = np.asarray(offsets.any(axis=(0, 2)))
    fixed = ~changing & ((numbers[:, 0] != 0.0) | (numbers[:, 2] != 0.0))
    if not force.getIncludeDirectSpace():  # OpenMM omits exceptions
        fixed, changing = fixed & False, changing & False
    found = [Bonded(_pair_force(force, []), whole[fixed], numbers[fixed])]
    if given:
        every = np.concatenate([numbers, *offsets], axis=1)
        found.append(Bonded(_pair_force(force, given), whole[changing], every[changing]))
    return found


def _pair_force(force: openmm.NonbondedForce, offsets: Sequence[str]) -> openmm.CustomBondForce:
    """Return a force without terms, with the functional form and the group of the exceptions of a NonbondedForce.

    The numbers of a term are followed by their offsets for each of some parameters.
    """
    sums = [" + ".join([f"{own}0", *(f"{name}*{own}{i}" for i, name in enumerate(offsets, 1))]) for own in _OF_PAIR]
    definitions = [f"; {own} = {value}" for own, value in zip(_OF_PAIR, sums, strict=True)]
    apart = openmm.CustomBondForce(PAIR + ("".join(definitions) if offsets else ""))
    for i in range(len(offsets) + 1):
        for own in _OF_PAIR:
            apart.addPerBondParameter(f"{own}{i}" if offsets else own)
    for name in offsets:
        apart.addGlobalParameter(name, _default(force, name))
    cut = force.getNonbondedMethod() != openmm.NonbondedForce.NoCutoff  # without a cutoff, OpenMM ignores the next flag
    apart.setUsesPeriodicBoundaryConditions(cut and force.getExceptionsUsePeriodicBoundaryConditions())
    apart.setName(f"exceptions of {force.getName()}")
    apart.setForceGroup(force.getForceGroup())
    return apart


def _default(force: openmm.NonbondedForce, parameter: str) -> float:
    """Return the default value of a parameter."""
    names = [force.getGlobalParameterName(i) for i in range(force.getNumGlobalParameters())]
    return float(force.getGlobalParameterDefaultValue(names.index(parameter)))


def acting(system: openmm.System) -> list[Any]:
    """Return the forces of a System that act on particles within a step."""
    return [force for force in system.getForces() if acts(force)]


def acts(force: Any) -> bool:
    """Return whether a force acts on particles within a step, unlike thermostats and barostats."""
    name = type(force).__name__
    return name not in _NO_FORCES and "Barostat" not in name


def others(system: openmm.System) -> bool:
    """Return whether a System has forces on particles other than bonded forces."""
    return any(not isinstance(force, BONDED_FORCES) for force in acting(system))


def groups_of(force: Any) -> set[int]:
    """Return the force groups of a force: two if the reciprocal part of an Ewald sum has a separate group."""
    own = getattr(force, "getReciprocalSpaceForceGroup", lambda: -1)()
    return {force.getForceGroup()} | ({own} if own >= 0 else set())
