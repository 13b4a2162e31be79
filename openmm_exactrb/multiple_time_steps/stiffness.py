"""Frequencies of bonds and angles, individually and coupled."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import openmm

from openmm_exactrb.multiple_time_steps.bonded import LENNARD_JONES, PAIR, Bonded
from openmm_exactrb.multiple_time_steps.normal_modes import OfPairs, Springs, highest
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.support.types import Array, Indices

#: The frequency (1/ps) of the fastest motions by slow forces, the librations of water.
LIBRATION = 112.0
# Lengths (nm) and angles at which the energy minimum of a bond or an angle is sought. Angles beyond pi, by which the
# energies are symmetric, show a minimum there.
_LENGTHS, _ANGLES = np.linspace(0.05, 0.3, 251), np.linspace(0.5, np.pi + 0.005, 266)
_SPRINGS = openmm.HarmonicBondForce, openmm.HarmonicAngleForce, openmm.CustomBondForce, openmm.CustomAngleForce


def fastest(
    system: openmm.System,
    groups: Sequence[int] = range(32),
    forces: Sequence[Bonded] | None = None,
    masses: Array | None = None,
) -> float:
    """Return the highest frequency of the normal modes of bonds and angles in 1/ps, or 0 if there are none.

    Parameters are those of `frequencies`; `normal_modes.highest` describes the approximation.
    """
    springs, distances, inverse = _springs(system, groups, forces, masses)
    return highest(_joined(springs, 2), _joined(springs, 3), distances, inverse)


def frequencies(
    system: openmm.System,
    groups: Sequence[int] = range(32),
    forces: Sequence[Bonded] | None = None,
    masses: Array | None = None,
) -> Iterator[tuple[Array, Indices]]:
    """Estimate the frequencies of harmonic bonds and angles, and of those with formulas, in given force groups.

    Each bond and angle is treated individually; constrained ones are ignored. A bond defined by a formula is included
    if its energy has a minimum at the length of a chemical bond, and an angle if its energy has a minimum. Parameters
    of the Context have their default values. By default, `forces` are the forces of the System, and
    `masses` (n_particles,) its masses, with which virtual sites have no frequency; see `virtual_sites.masses`.

    Yields
    ------
    frequency : (n,) array
        Frequencies in 1/ps.
    particles : (n, 2) or (n, 3) array
        The particles of each bond or angle.
    """
    for springs in _springs(system, groups, forces, masses)[0]:
        yield np.sqrt(np.maximum(springs.square, 0.0)), springs.particles


def _springs(
    system: openmm.System, groups: Sequence[int], forces: Sequence[Bonded] | None, masses: Array | None
) -> tuple[list[Springs], OfPairs, Array]:
    """Return the bonds or angles of each force, the distances of particles, and inverse masses."""
    if forces is None:
        forces = [Bonded.of(force) for force in system.getForces() if isinstance(force, _SPRINGS)]
    bonds = [(of.force.getForceGroup() in groups, *found) for of in forces if (found := _bonds(of)) is not None]
    held = parameters.constraints(system)
    constrained = OfPairs(*held).has
    by_group = sorted(bonds, key=lambda bond: bond[0])  # bonds in the groups come last and override the others
    pairs, lengths = zip(held, *((particles, r) for _, particles, r, _ in by_group), strict=True)
    known = OfPairs(np.concatenate(pairs), np.concatenate(lengths))
    masses = parameters.masses(system) if masses is None else masses
    inverse = np.divide(1.0, masses, out=np.zeros_like(masses), where=masses != 0.0)  # 0 for frozen particles
    springs = []
    for own, particles, length, strength in bonds:
        if own:
            every = Springs(particles, length, strength, strength * inverse[particles].sum(axis=1))
            springs.append(every.chosen(~constrained(particles)))
    for of in forces:
        if of.force.getForceGroup() in groups and (angles := _angles(of)) is not None:
            every = Springs(*angles, _squares(*angles, known, inverse))
            springs.append(every.chosen(~constrained(every.particles[:, ::2]) & ~np.isnan(every.square)))
    return springs, known, inverse


def _joined(springs: Sequence[Springs], width: int) -> Springs:
    """Return all bonds (of 2 particles) or angles (of 3) with a positive squared frequency."""
    none = Springs(np.zeros((0, width), np.intp), *(np.zeros(0) for _ in range(3)))
    some = [of.chosen(of.square > 0.0) for of in springs if of.particles.shape[1] == width]
    return Springs(*map(np.concatenate, zip(none, *some, strict=True)))


def _squares(particles: Indices, angle: Array, strength: Array, known: OfPairs, inverse: Array) -> Array:
    """Return the squared frequencies of angles, or nan if the length of a bond is unknown."""
    i, j, k = particles.T
    a, b = (known.of(particles[:, own]) for own in ([0, 1], [2, 1]))
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
        if not formula.startswith(PAIR) and not LENNARD_JONES.fullmatch(formula.replace(" ", "")):
            return _by_formula(bonds, _LENGTHS, lambda r: ([[0.0] * 3, [r, 0.0, 0.0]], [1.0, 0.0, 0.0]))
    return None


def _angles(angles: Bonded) -> tuple[Indices, Array, Array] | None:
    """Return the particles, angles and strengths (kJ/mol) of angles, or None for other forces."""
    if isinstance(angles.force, openmm.HarmonicAngleForce):
        return angles.particles, *angles.numbers.T
    if isinstance(angles.force, openmm.CustomAngleForce):
        return _by_formula(angles, _ANGLES, _angle)
    return None


def _angle(theta: float) -> tuple[list[list[float]], list[float]]:
    """Return three positions that form an angle, and the derivative of the last one."""
    cosine, sine = np.cos(theta), np.sin(theta)
    return [[1.0, 0.0, 0.0], [0.0] * 3, [cosine, sine, 0.0]], [-sine, cosine, 0.0]


def _by_formula(
    of: Bonded, coordinates: Array, places: Callable[[float], tuple[list[list[float]], list[float]]]
) -> tuple[Indices, Array, Array] | None:
    """Return the particles, the coordinates of the minimum and the second derivatives there, of terms with a formula.

    The function places(coordinate) returns positions of the particles of a term, and the derivative of the last one.
    Terms without a minimum are omitted.
    """
    if not len(of.whole):
        return None
    slopes = _slopes(of, coordinates, places)
    turns = (slopes[:-1] <= 0.0) & (slopes[1:] > 0.0)
    second = np.diff(slopes, axis=0) / np.diff(coordinates)[:, None]
    found = np.flatnonzero(turns.any(axis=0))
    place = turns.argmax(axis=0)[found]
    return of.particles[found], coordinates[place], second[place, found]


def _slopes(of: Bonded, coordinates: Array, places: Callable[[float], tuple[list[list[float]], list[float]]]) -> Array:
    """Return dV/dq (coordinates, terms) of all terms of a force, each isolated from the others."""
    (n, width), system = of.whole.shape, openmm.System()
    alone = of._replace(whole=np.arange(width * n).reshape(n, width)).made()
    alone.setUsesPeriodicBoundaryConditions(False)
    for _ in range(width * n):
        system.addParticle(1.0)
    system.addForce(alone)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    found = []
    for coordinate in coordinates.tolist():
        x, direction = places(coordinate)
        context.setPositions(np.tile(x, (n, 1)))
        forces = arrays.forces(context.getState(forces=True)).reshape(n, width, 3)
        found.append(-forces[:, -1] @ np.array(direction))
    return np.asarray(np.nan_to_num(np.array(found)))
