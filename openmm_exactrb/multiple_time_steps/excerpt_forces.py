"""The common bonded forces of an excerpt, by the library's kernels or in NumPy."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context.forces import ContextForces
from openmm_exactrb.context.synchronisation import Positions
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.library import functions
from openmm_exactrb.mechanics.state import Force, State
from openmm_exactrb.multiple_time_steps import bonded_forces
from openmm_exactrb.multiple_time_steps.bonded import LENNARD_JONES, PAIR, Bonded
from openmm_exactrb.multiple_time_steps.terms import Terms, kinds_of
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.openmm_access.units import COULOMB
from openmm_exactrb.support.types import Array, Indices

# Formulas of harmonic torsions in OpenMM's CHARMM force fields, without blanks. The difference of angles is periodic in
# the second formula only.
_HARMONIC = re.compile(
    r"k\*\(theta-theta0\)\^2|k\*min\(dtheta,2\*pi-dtheta\)\^2;dtheta=abs\(theta-theta0\);pi=([\d.]+);?"
)
_PARAMETERS = {LENNARD_JONES: {"sigma", "epsilon"}, _HARMONIC: {"k", "theta0"}}
# The period that represents a difference without periodicity, so long that no difference reaches half of it.
_LINE = 1e9


class BondedForces(ContextForces):
    """`ContextForces` that kernels or NumPy evaluate; energies are evaluated by OpenMM."""

    def __init__(self, terms: Terms, positions: Positions, groups: int, timings: Timings, counter: str) -> None:
        super().__init__(positions, groups, timings, counter)
        self._sum = by_library(terms) if functions.available() else partial(bonded_forces.forces, terms=terms)

    def _evaluated(self, state: State, present: bool) -> Force:
        start = time.perf_counter()
        x = self.positions.placed(state)
        out = np.empty_like(x)
        self._sum(x, out=out)
        found = self.positions.bodies.forces(state.rounded, out)
        self._count(start)
        return found


def terms_of(forces: Sequence[Bonded], groups: int) -> Terms | None:
    """Return the terms of forces in given groups (bits), or None unless all forces have one of the known forms."""
    if not all(has_known_form(of.force) for of in forces):
        return None
    some = [force for force in forces if groups >> force.force.getForceGroup() & 1]
    bonds, angles, pairs, impropers = (
        _joined([(of.particles, numbers(of)) for of in some if isinstance(of.force, kind)], width, count)
        for kind, numbers, width, count in (
            (openmm.HarmonicBondForce, _of_bonds, 2, 2),
            (openmm.HarmonicAngleForce, _of_angles, 3, 3),
            (openmm.CustomBondForce, _of_pairs, 2, 3),
            (openmm.CustomTorsionForce, _of_impropers, 4, 3),
        )
    )
    return Terms(*bonds, *angles, *_torsions(some), *pairs, *impropers, *_maps(some))


def by_library(terms: Terms) -> Callable[..., None]:
    """Return a function that writes forces like `bonded_forces.forces`."""
    kinds = [
        (name, len(kind.particles), np.ascontiguousarray(members.T, np.int32), np.ascontiguousarray(kind.numbers))
        for name, kind in kinds_of(terms, np.float64).items()
        if len(members := np.concatenate([kind.particles.T, kind.others]).T)
    ]
    patches, harmonics = np.ascontiguousarray(terms.patches), terms.of_torsions.shape[1]

    def forces(x: Array, out: Array) -> None:
        state = np.stack([x, np.zeros(x.shape)], axis=-1)
        out[:] = 0.0
        for name, count, members, numbers in kinds:
            functions.call("add_forces", name, count, len(x), harmonics, state, members, numbers, patches, out)

    return forces


def has_known_form(force: Any) -> bool:
    """Return whether a bonded force has a form for which there is a kernel, without periodic boundary conditions."""
    if force.usesPeriodicBoundaryConditions():
        return False
    if not hasattr(force, "getEnergyFunction"):  # a force of OpenMM with a fixed form
        return True
    if force.getNumGlobalParameters():
        return False
    if isinstance(force, openmm.CustomBondForce):
        return force.getEnergyFunction() == PAIR or _has(force, LENNARD_JONES, force.getPerBondParameterName)
    return isinstance(force, openmm.CustomTorsionForce) and _has(force, _HARMONIC, force.getPerTorsionParameterName)


def _has(force: Any, formula: re.Pattern[str], name: Callable[[int], str]) -> bool:
    """Return whether a force has a given formula, with two parameters per term."""
    return _number(force, formula) is not None and {name(i) for i in range(2)} == _PARAMETERS[formula]


def _number(force: Any, formula: re.Pattern[str]) -> float | None:
    """Return the number in the formula of a force, or None if the formula differs."""
    found = formula.fullmatch(force.getEnergyFunction().replace(" ", ""))
    return None if found is None else float(found[1] or 0.5 * _LINE)


def _joined(some: list[tuple[Indices, list[Array]]], width: int, count: int) -> tuple[Indices, Array]:
    """Return the particles (n, width) and numbers (count, n) of terms of one kind."""
    particles = np.concatenate([np.zeros((0, width), np.int64), *(rows for rows, _ in some)])
    return particles, np.concatenate([np.zeros((count, 0)), *(np.stack(numbers) for _, numbers in some)], axis=1)


def _of_bonds(bonds: Bonded) -> list[Array]:
    return list(bonds.numbers.T)


def _of_angles(angles: Bonded) -> list[Array]:
    angle, strength = angles.numbers.T
    return [np.cos(angle), np.sin(angle), strength]


def _of_pairs(pairs: Bonded) -> list[Array]:
    force, factor = pairs.force, _number(pairs.force, LENNARD_JONES)
    names = [force.getPerBondParameterName(i) for i in range(force.getNumPerBondParameters())]
    own = dict(zip(names, pairs.numbers.T, strict=True))
    if factor is None:
        return [COULOMB * own["charges"], own["sigma"], own["epsilon"]]
    return [np.zeros(len(pairs.whole)), own["sigma"], 0.25 * factor * own["epsilon"]]


def _of_impropers(torsions: Bonded) -> list[Array]:
    half_circle = _number(torsions.force, _HARMONIC)
    assert half_circle is not None  # ensured by `has_known_form`
    own = {torsions.force.getPerTorsionParameterName(i): torsions.numbers[:, i] for i in range(2)}
    return [own["theta0"], own["k"], np.full(len(torsions.whole), 2.0 * half_circle)]


def _maps(forces: list[Bonded]) -> tuple[Indices, Array]:
    """Return particles, first patch and patches per direction (M, 10), and coefficients of all patches (., 4, 4)."""
    rows, patches = [np.zeros((0, 10), np.int64)], [np.zeros((0, 4, 4))]
    for of in forces:
        if isinstance(of.force, openmm.CMAPTorsionForce):
            of_maps = [of.force.getMapParameters(i) for i in range(of.force.getNumMaps())]
            sizes = np.array([size for size, _ in of_maps], dtype=np.int64)
            first = sum(map(len, patches)) + np.cumsum([0, *sizes**2])[:-1]
            patches += [_patches(size, np.array(energy._value)) for size, energy in of_maps]
            number = of.whole[:, 0]
            rows.append(np.column_stack([of.particles, first[number], sizes[number]]))
    return np.concatenate(rows), np.concatenate(patches)


def _patches(size: int, energy: Array) -> Array:
    """Return the coefficients (size², 4, 4), highest powers first, of the periodic bicubic spline of a map (size²,).

    The entry i + size j of the map is the energy at the angles 2 pi i/size and 2 pi j/size.
    """
    from scipy.interpolate import CubicSpline  # imported here, so that the package is imported faster

    at = np.linspace(0.0, 2.0 * np.pi, size + 1)
    closed = np.pad(energy.reshape(size, size).T, ((0, 1), (0, 1)), mode="wrap")
    of_first = CubicSpline(at, closed, axis=0, bc_type="periodic").c  # (4, size, size + 1)
    of_both = CubicSpline(at, of_first, axis=2, bc_type="periodic").c  # (4, size, 4, size)
    return np.ascontiguousarray(of_both.transpose(3, 1, 2, 0).reshape(size * size, 4, 4))


def _torsions(forces: list[Bonded]) -> tuple[Indices, Array]:
    """Return particles (T, 4) and coefficients (2, N, T) of cosines and sines, merged for each set of particles."""
    series = [series(of) for of in forces for kind, series in _SERIES.items() if isinstance(of.force, kind)]
    if not series:
        return np.zeros((0, 4), np.int64), np.zeros((2, 0, 0))
    particles, n, cosines, sines = (np.concatenate(arrays) for arrays in zip(*series, strict=True))
    first, row = arrays.alike(particles)
    shape = int(n.max(initial=0)) + 1, len(first)
    places = np.ravel_multi_index((n, row), shape)
    sums = [np.bincount(places, part, math.prod(shape)).reshape(shape)[1:] for part in (cosines, sines)]
    return particles[first], np.stack(sums)  # a constant has no force


def _of_cosines(torsions: Bonded) -> tuple[Indices, Indices, Array, Array]:
    """Return the particles, n, and the coefficients of cos n phi and sin n phi for each term."""
    phase, strength = torsions.numbers.T
    return torsions.particles, torsions.whole[:, 4], strength * np.cos(phase), strength * np.sin(phase)


def _of_polynomials(torsions: Bonded) -> tuple[Indices, Indices, Array, Array]:
    """Return the results of `_of_cosines` for torsions whose energies are polynomials in cos(phi - pi)."""
    as_cosines = np.array([np.polynomial.chebyshev.poly2cheb(row).tolist() + [0.0] * (5 - k) for k, row in _POWERS])
    signs = (-1.0) ** np.arange(6)
    cosines = (torsions.numbers @ as_cosines * signs).ravel()
    return np.repeat(torsions.particles, 6, axis=0), np.tile(np.arange(6), len(torsions.whole)), cosines, 0.0 * cosines


_POWERS = [(k, [0.0] * k + [1.0]) for k in range(6)]
_SERIES: dict[Any, Callable[[Bonded], tuple[Indices, Indices, Array, Array]]] = {
    openmm.PeriodicTorsionForce: _of_cosines,
    openmm.RBTorsionForce: _of_polynomials,
}
