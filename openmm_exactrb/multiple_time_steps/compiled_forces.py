"""The usual bonded forces of an excerpt without OpenMM, whose calls cost more than these few terms."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb import kernels
from openmm_exactrb.context.forces import ContextForces
from openmm_exactrb.context.synchronisation import Positions
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.environment import Force
from openmm_exactrb.kernels.records import Terms
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.multiple_time_steps.bonded import COULOMB, PAIR

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Formulas of OpenMM's CHARMM force fields, without blanks: pairs three bonds apart, and harmonic torsions.
_LENNARD_JONES = re.compile(r"([\d.]+)\*epsilon\*\(\(sigma/r\)\^12-\(sigma/r\)\^6\)")
_HARMONIC = re.compile(r"k\*min\(dtheta,2\*pi-dtheta\)\^2;dtheta=abs\(theta-theta0\);pi=([\d.]+);?")
_PARAMETERS = {_LENNARD_JONES: {"sigma", "epsilon"}, _HARMONIC: {"k", "theta0"}}


#: No terms at all.
NO_TERMS = Terms(
    *(np.zeros((0, 2), np.int64), np.zeros((2, 0))),
    *(np.zeros((0, 3), np.int64), np.zeros((3, 0))),
    *(np.zeros((0, 4), np.int64), np.zeros((2, 0, 0))),
    *(np.zeros((0, 2), np.int64), np.zeros((3, 0))),
    *(np.zeros((0, 4), np.int64), np.zeros((3, 0))),
    *(np.zeros((0, 10), np.int64), np.zeros((0, 4, 4))),
)


class BondedForces(ContextForces):
    """The same as `ContextForces`, by a compiled kernel; energies are OpenMM's."""

    def __init__(self, terms: Terms, positions: Positions, groups: int, timings: Timings, counter: str) -> None:
        super().__init__(positions, groups, timings, counter)
        self.terms, self._sum = terms, kernels.load("bonded").forces

    @property
    def known(self) -> Force | None:
        """A copy of the forces and torques at the present positions, if these are known."""
        if self._version != self.positions.version:
            return None
        force, torque = self._value
        return force.copy(), torque.copy()

    def moved(self, evaluations: int, value: Force | None) -> None:
        """Notice that a kernel moved the bodies, and what forces it left at their new positions if it knows."""
        self._add_evaluations(evaluations)
        self.positions.version += 1
        if value is not None:
            self._version, self._value = self.positions.version, value

    def _evaluated(self, state: State, present: bool) -> Force:
        start = time.perf_counter()
        x = self.positions.placed(state)
        out = np.empty_like(x)
        self._sum(x, self.terms, out)
        found = self.positions.bodies.forces(state.rounded, out)
        self._count(start)
        return found


def terms_of(system: openmm.System, groups: int) -> Terms | None:
    """Return the terms of a System in some groups (bits), None where it has terms of other forms."""
    forces = list(system.getForces())
    if not all(map(_known, forces)):
        return None
    some = [force for force in forces if groups >> force.getForceGroup() & 1]
    bonds, angles, pairs, impropers = (
        _arrays([term for force in some if isinstance(force, kind) for term in terms(force)], particles, numbers)
        for kind, terms, particles, numbers in (
            (openmm.HarmonicBondForce, _bonds, 2, 2),
            (openmm.HarmonicAngleForce, _angles, 3, 3),
            (openmm.CustomBondForce, _pairs, 2, 3),
            (openmm.CustomTorsionForce, _impropers, 4, 3),
        )
    )
    return Terms(*bonds, *angles, *_torsions(some), *pairs, *impropers, *_maps(some))


def unknown(system: openmm.System) -> str | None:
    """Return the name of a force of a System that has terms of other forms, or None."""
    return next((force.getName() for force in system.getForces() if not _known(force)), None)


def _known(force: Any) -> bool:
    if force.usesPeriodicBoundaryConditions():
        return False
    if isinstance(force, openmm.CustomBondForce):
        return force.getEnergyFunction() == PAIR or _has(force, _LENNARD_JONES, force.getPerBondParameterName)
    if isinstance(force, openmm.CustomTorsionForce):
        return _has(force, _HARMONIC, force.getPerTorsionParameterName)
    kinds = openmm.HarmonicBondForce, openmm.HarmonicAngleForce, openmm.PeriodicTorsionForce, openmm.RBTorsionForce
    return isinstance(force, (*kinds, openmm.CMAPTorsionForce))


def _has(force: Any, formula: re.Pattern[str], name: Callable[[int], str]) -> bool:
    """Return whether a force has a formula whose two parameters belong to each term."""
    if force.getNumGlobalParameters() or _number(force, formula) is None:
        return False
    return {name(i) for i in range(2)} == _PARAMETERS[formula]


def _number(force: Any, formula: re.Pattern[str]) -> float | None:
    """Return the number in the formula of a force, None if it is another formula."""
    found = formula.fullmatch(force.getEnergyFunction().replace(" ", ""))
    return None if found is None else float(found[1])


def _bonds(force: openmm.HarmonicBondForce) -> Iterator[tuple[float, ...]]:
    for i, j, length, strength in map(force.getBondParameters, range(force.getNumBonds())):
        yield i, j, length._value, strength._value


def _angles(force: openmm.HarmonicAngleForce) -> Iterator[tuple[float, ...]]:
    for i, j, k, angle, strength in map(force.getAngleParameters, range(force.getNumAngles())):
        yield i, j, k, math.cos(angle._value), math.sin(angle._value), strength._value


def _pairs(force: openmm.CustomBondForce) -> Iterator[tuple[float, ...]]:
    factor = _number(force, _LENNARD_JONES)
    names = [force.getPerBondParameterName(i) for i in range(force.getNumPerBondParameters())]
    for i, j, values in map(force.getBondParameters, range(force.getNumBonds())):
        of_pair = dict(zip(names, values, strict=True))
        if factor is None:
            yield i, j, COULOMB * of_pair["charges"], of_pair["sigma"], of_pair["epsilon"]
        else:
            yield i, j, 0.0, of_pair["sigma"], 0.25 * factor * of_pair["epsilon"]


def _impropers(force: openmm.CustomTorsionForce) -> Iterator[tuple[float, ...]]:
    half_circle = _number(force, _HARMONIC)
    assert half_circle is not None  # `_known`
    names = [force.getPerTorsionParameterName(i) for i in range(2)]
    for *four, values in map(force.getTorsionParameters, range(force.getNumTorsions())):
        of_torsion = dict(zip(names, values, strict=True))
        yield *four, of_torsion["theta0"], of_torsion["k"], 2.0 * half_circle


def _maps(forces: list[Any]) -> tuple[Indices, Array]:
    """Return particles, first patch and patches per direction (M, 10), and the coefficients of patches (., 4, 4)."""
    rows: list[tuple[int, ...]] = []
    patches = [np.zeros((0, 4, 4))]
    for force in forces:
        if isinstance(force, openmm.CMAPTorsionForce):
            of_maps = [force.getMapParameters(i) for i in range(force.getNumMaps())]
            first = np.cumsum([sum(map(len, patches)), *(size * size for size, _ in of_maps)]).tolist()
            patches += [_patches(size, np.array(energy._value)) for size, energy in of_maps]
            for number, *eight in map(force.getTorsionParameters, range(force.getNumTorsions())):
                rows.append((*eight, first[number], of_maps[number][0]))
    return np.array(rows, dtype=np.int64).reshape(-1, 10), np.concatenate(patches)


def _patches(size: int, energy: Array) -> Array:
    """Return the coefficients (size², 4, 4), highest powers first, of the periodic bicubic spline of a map (size²,).

    The energy of the first angle i and the second angle j is at i + size j, in units of the circle's parts.
    """
    from scipy.interpolate import CubicSpline  # here, for a short import of the package

    at = np.linspace(0.0, 2.0 * np.pi, size + 1)
    closed = np.pad(energy.reshape(size, size).T, ((0, 1), (0, 1)), mode="wrap")
    of_first = CubicSpline(at, closed, axis=0, bc_type="periodic").c  # (4, size, size + 1)
    of_both = CubicSpline(at, of_first, axis=2, bc_type="periodic").c  # (4, size, 4, size)
    return np.ascontiguousarray(of_both.transpose(3, 1, 2, 0).reshape(size * size, 4, 4))


def _arrays(terms: list[tuple[float, ...]], particles: int, numbers: int) -> tuple[Indices, Array]:
    """Return particles (n, particles) and numbers (numbers, n)."""
    rows = np.array(terms, dtype=np.float64).reshape(len(terms), particles + numbers)
    return rows[:, :particles].astype(np.int64), np.ascontiguousarray(rows[:, particles:].T)


def _torsions(forces: list[Any]) -> tuple[Indices, Array]:
    """Return particles (T, 4) and coefficients (2, N, T) of cosines and sines; all terms of four particles are one."""
    series: dict[tuple[int, ...], list[tuple[int, float, float]]] = {}
    for force in forces:
        if isinstance(force, openmm.PeriodicTorsionForce):
            for *four, n, phase, strength in map(force.getTorsionParameters, range(force.getNumTorsions())):
                k, delta = strength._value, phase._value
                series.setdefault(tuple(four), []).append((n, k * np.cos(delta), k * np.sin(delta)))
        elif isinstance(force, openmm.RBTorsionForce):  # a polynomial in cos(phi - pi)
            for *four, c0, c1, c2, c3, c4, c5 in map(force.getTorsionParameters, range(force.getNumTorsions())):
                of_cosines = np.polynomial.chebyshev.poly2cheb([c._value for c in (c0, c1, c2, c3, c4, c5)])
                terms = [(n, (-1) ** n * a, 0.0) for n, a in enumerate(of_cosines.tolist()) if n]
                series.setdefault(tuple(four), []).extend(terms)
    highest = max((n for terms in series.values() for n, *_ in terms), default=0)
    coefficients = np.zeros((2, highest, len(series)))
    for row, terms in enumerate(series.values()):
        for n, a, b in terms:
            if n:  # a constant has no force
                coefficients[:, n - 1, row] += a, b
    return np.array(list(series), dtype=np.int64).reshape(-1, 4), coefficients
