"""Estimates of the frequencies of bonds and angles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.multiple_time_steps.bonded import LENNARD_JONES, PAIR, Bonded
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.support.types import Array, Indices

#: The frequency (1/ps) of the fastest motions by slow forces, the librations of water.
LIBRATION = 112.0
# Lengths (nm) at which the energy minimum of a bond is sought.
_LENGTHS = np.linspace(0.05, 0.3, 251)
_SPRINGS = openmm.HarmonicBondForce, openmm.HarmonicAngleForce, openmm.CustomBondForce


def fastest(
    system: openmm.System,
    groups: Sequence[int] = range(32),
    forces: Sequence[Bonded] | None = None,
    masses: Array | None = None,
) -> float:
    """Return the highest of the `frequencies` in 1/ps, or 0 if there are none."""
    return max((float(some.max(initial=0.0)) for some, _ in frequencies(system, groups, forces, masses)), default=0.0)


def frequencies(
    system: openmm.System,
    groups: Sequence[int] = range(32),
    forces: Sequence[Bonded] | None = None,
    masses: Array | None = None,
) -> Iterator[tuple[Array, Indices]]:
    """Estimate the frequencies of harmonic bonds and angles, and of bonds with formulas, in given force groups.

    Each bond and angle is treated individually; constrained ones are ignored. A bond defined by a formula is included
    if its energy has a minimum at the length of a chemical bond. By default, `forces` are the forces of the System, and
    `masses` (n_particles,) its masses, with which virtual sites have no frequency; see `virtual_sites.masses`.

    Yields
    ------
    frequency : (n,) array
        Frequencies in 1/ps.
    particles : (n, 2) or (n, 3) array
        The particles of each bond or angle.
    """
    if forces is None:
        forces = [Bonded.of(force) for force in system.getForces() if isinstance(force, _SPRINGS)]
    bonds = [(of.force.getForceGroup() in groups, *found) for of in forces if (found := _bonds(of)) is not None]
    held = parameters.constraints(system)
    constrained = _Lengths(*held).has
    by_group = sorted(bonds, key=lambda bond: bond[0])  # bonds in the groups come last and override the others
    pairs, lengths = zip(held, *((particles, r) for _, particles, r, _ in by_group), strict=True)
    known = _Lengths(np.concatenate(pairs), np.concatenate(lengths))
    masses = parameters.masses(system) if masses is None else masses
    inverse = np.divide(1.0, masses, out=np.zeros_like(masses), where=masses != 0.0)  # 0 for frozen particles
    for own, particles, _, strength in bonds:
        if own:
            free = ~constrained(particles)
            square = strength * inverse[particles].sum(axis=1)
            yield np.sqrt(np.maximum(square, 0.0))[free], particles[free]
    for of in forces:
        if isinstance(of.force, openmm.HarmonicAngleForce) and of.force.getForceGroup() in groups:
            square = _of_angles(of, known, inverse)
            free = ~constrained(of.particles[:, ::2]) & ~np.isnan(square)
            yield np.sqrt(np.maximum(square[free], 0.0)), of.particles[free]


class _Lengths:
    """Distances of pairs of particles; later entries override earlier ones."""

    def __init__(self, pairs: Indices, lengths: Array) -> None:
        keys = self._keys(pairs)
        order = np.argsort(keys, kind="stable")
        self._sorted, self._values = keys[order], np.append(lengths[order], np.nan)

    @staticmethod
    def _keys(pairs: Indices) -> Indices:
        return np.asarray((pairs.min(axis=1) << 32) + pairs.max(axis=1))

    def of(self, pairs: Indices) -> Array:
        """Return the distances of pairs, or nan for pairs without a known distance."""
        place = np.searchsorted(self._sorted, keys := self._keys(pairs), side="right") - 1
        return np.where(np.append(self._sorted, -1)[place] == keys, self._values[place], np.nan)

    def has(self, pairs: Indices) -> NDArray[np.bool_]:
        """Return a mask of the pairs that have a known distance."""
        return ~np.isnan(self.of(pairs))


def _of_angles(angles: Bonded, known: _Lengths, inverse: Array) -> Array:
    """Return the squared frequencies of angles, or nan if the length of a bond is unknown."""
    (i, j, k), (angle, strength) = angles.particles.T, angles.numbers.T
    a, b = (known.of(angles.particles[:, own]) for own in ([0, 1], [2, 1]))
    a, b = np.where(a == 0.0, np.nan, a), np.where(b == 0.0, np.nan, b)
    middle = 1.0 / a**2 + 1.0 / b**2 - 2.0 * np.cos(angle) / (a * b)
    return np.asarray(strength * (inverse[i] / a**2 + inverse[k] / b**2 + inverse[j] * middle))


def _bonds(bonds: Bonded) -> tuple[Indices, Array, Array] | None:
    """Return the particles, lengths (nm) and strengths (kJ/mol/nm²) of bonds, or None for other forces."""
    if isinstance(bonds.force, openmm.HarmonicBondForce):
        return bonds.particles, *bonds.numbers.T
    # Pairs three bonds apart are not treated as bonds: their distances never reach the minima of their formulas.
    if isinstance(bonds.force, openmm.CustomBondForce):
        formula = bonds.force.getEnergyFunction()
        if formula != PAIR and not LENNARD_JONES.fullmatch(formula.replace(" ", "")):
            return _bonds_by_formula(bonds)
    return None


def _bonds_by_formula(bonds: Bonded) -> tuple[Indices, Array, Array] | None:
    """Return the results of `_bonds` for bonds with a formula, from the zero of the force and its slope there."""
    if not len(bonds.whole):
        return None
    forces = _at_lengths(bonds, _LENGTHS)  # attractive where positive
    turns = (forces[:-1] <= 0.0) & (forces[1:] > 0.0)
    slopes = np.diff(forces, axis=0) / np.diff(_LENGTHS)[:, None]
    found = np.flatnonzero(turns.any(axis=0))
    place = turns.argmax(axis=0)[found]
    return bonds.particles[found], _LENGTHS[place], slopes[place, found]


def _at_lengths(bonds: Bonded, lengths: Array) -> Array:
    """Return dV/dr (lengths, bonds) in kJ/mol/nm of all bonds of a force, each isolated from the others."""
    n, system = len(bonds.whole), openmm.System()
    alone = bonds._replace(whole=np.arange(2 * n).reshape(n, 2)).made()
    alone.setUsesPeriodicBoundaryConditions(False)
    for _ in range(2 * n):
        system.addParticle(1.0)
    system.addForce(alone)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    x, found = np.zeros((n, 2, 3)), []
    for length in lengths:
        x[:, 1, 0] = length
        context.setPositions(x.reshape(-1, 3))
        found.append(-arrays.forces(context.getState(forces=True)).reshape(n, 2, 3)[:, 1, 0])
    return np.nan_to_num(np.array(found))
