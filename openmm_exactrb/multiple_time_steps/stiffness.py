"""How fast bonds and angles move atoms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.multiple_time_steps.bonded import PAIR
from openmm_exactrb.openmm_access import arrays

Array = NDArray[np.float64]

# Lengths (nm) among which the minimum of a bond is looked for.
_LENGTHS = np.linspace(0.05, 0.3, 251)


def fastest(system: openmm.System, groups: Sequence[int] = range(32)) -> float:
    """Return the highest of the `frequencies` in 1/ps; 0 where there are none."""
    return max((frequency for frequency, _ in frequencies(system, groups)), default=0.0)


def frequencies(system: openmm.System, groups: Sequence[int] = range(32)) -> Iterable[tuple[float, tuple[int, ...]]]:
    """Estimate the frequencies of harmonic bonds and angles, and bonds of formulas, in some force groups, or all.

    Each bond and angle is treated individually, without those that constraints hold. A bond of a formula counts where
    it has a minimum at the length of a chemical bond.

    Yields
    ------
    frequency : float
        In 1/ps.
    particles : tuple of int
        Two of a bond, three of an angle.
    """
    mass = [system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(system.getNumParticles())]
    held = {
        frozenset((i, j)): d.value_in_unit(unit.nanometer)
        for i, j, d in map(system.getConstraintParameters, range(system.getNumConstraints()))
    }
    every = system.getForces()
    forces = [force for force in every if force.getForceGroup() in groups]
    bonds = [parameters for force in forces for parameters in _bonds(force)]
    others = [parameters for force in every if force not in forces for parameters in _bonds(force)]
    length = held | {frozenset((i, j)): r for i, j, r, _ in (*others, *bonds)}
    for i, j, _, k in bonds:
        if frozenset((i, j)) not in held:
            yield float(np.sqrt(max(k * (_inverse(mass[i]) + _inverse(mass[j])), 0.0))), (i, j)
    for force in forces:
        for i, j, k, angle, strength in _angles(force):
            a, b = length.get(frozenset((i, j))), length.get(frozenset((k, j)))
            if a and b and frozenset((i, k)) not in held:
                middle = 1.0 / a**2 + 1.0 / b**2 - 2.0 * np.cos(angle) / (a * b)
                square = strength * (_inverse(mass[i]) / a**2 + _inverse(mass[k]) / b**2 + _inverse(mass[j]) * middle)
                yield float(np.sqrt(max(square, 0.0))), (i, j, k)


def _bonds(force: Any) -> Iterable[tuple[int, int, float, float]]:
    """Yield the particles, lengths (nm) and strengths (kJ/mol/nm²) of bonds."""
    if isinstance(force, openmm.HarmonicBondForce):
        for i, j, r, k in map(force.getBondParameters, range(force.getNumBonds())):
            yield i, j, r._value, k._value
    # Exceptions are no bonds: where their minima are these pairs never come.
    if isinstance(force, openmm.CustomBondForce) and force.getEnergyFunction() != PAIR:
        yield from _bonds_by_formula(force)


def _bonds_by_formula(force: openmm.CustomBondForce) -> Iterable[tuple[int, int, float, float]]:
    """Yield the same of a force with a formula: where the force changes its sign, and how fast."""
    ends = [force.getBondParameters(number)[:2] for number in range(force.getNumBonds())]
    if not ends:
        return
    forces = _at_lengths(force, _LENGTHS)  # positive ones pull
    turns = (forces[:-1] <= 0.0) & (forces[1:] > 0.0)
    slopes = np.diff(forces, axis=0) / np.diff(_LENGTHS)[:, None]
    for bond in np.flatnonzero(turns.any(axis=0)):
        place = int(np.argmax(turns[:, bond]))
        yield *ends[bond], float(_LENGTHS[place]), float(slopes[place, bond])


def _at_lengths(force: openmm.CustomBondForce, lengths: Array) -> Array:
    """Return dV/dr (lengths, bonds) in kJ/mol/nm of all bonds of a force, each alone with its particles."""
    n = force.getNumBonds()
    alone, system = openmm.XmlSerializer.clone(force), openmm.System()
    alone.setUsesPeriodicBoundaryConditions(False)
    for number in range(n):
        system.addParticle(1.0)
        system.addParticle(1.0)
        alone.setBondParameters(number, 2 * number, 2 * number + 1, force.getBondParameters(number)[2])
    system.addForce(alone)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    x, found = np.zeros((n, 2, 3)), []
    for length in lengths:
        x[:, 1, 0] = length
        context.setPositions(x.reshape(-1, 3))
        found.append(-arrays.forces(context.getState(forces=True)).reshape(n, 2, 3)[:, 1, 0])
    return np.nan_to_num(np.array(found))


def _angles(force: Any) -> Iterable[tuple[int, int, int, float, float]]:
    """Yield the particles, angles and strengths (kJ/mol) of harmonic angles."""
    if isinstance(force, openmm.HarmonicAngleForce):
        for i, j, k, angle, strength in map(force.getAngleParameters, range(force.getNumAngles())):
            yield i, j, k, angle._value, strength._value


def _inverse(mass: float) -> float:
    return 1.0 / mass if mass else 0.0
