"""The usual bonded forces of an excerpt without OpenMM, whose calls cost more than these few terms."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb import kernels
from openmm_exactrb.context.bonded import COULOMB, PAIR
from openmm_exactrb.context.forces import ContextForces, Positions
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.substeps import Force

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Terms(NamedTuple):
    """What `kernels.compiled.bonded` takes: particles of terms, and their numbers."""

    bonds: Indices
    of_bonds: Array
    angles: Indices
    of_angles: Array
    torsions: Indices
    of_torsions: Array
    pairs: Indices
    of_pairs: Array


class BondedForces(ContextForces):
    """The same as `ContextForces`, by a compiled kernel; energies are OpenMM's."""

    def __init__(self, terms: Terms, positions: Positions, groups: int, timings: Timings, counter: str) -> None:
        super().__init__(positions, groups, timings, counter)
        self._terms, self._sum = terms, kernels.load("bonded", "numba").forces

    def _evaluated(self, state: State, present: bool) -> Force:
        start = time.perf_counter()
        x = self.positions.placed(state)
        out = np.empty_like(x)
        self._sum(x, *self._terms, out)
        found = self.positions.bodies.forces(state.rounded, out)
        self._count(start)
        return found


def terms_of(system: openmm.System, groups: int) -> Terms | None:
    """Return the terms of a System in some groups (bits), None without numba or where it has terms of other forms."""
    forces = list(system.getForces())
    if not kernels.available() or not all(map(_known, forces)):
        return None
    some = [force for force in forces if groups >> force.getForceGroup() & 1]
    bonds, angles, pairs = (
        _arrays([term for force in some if isinstance(force, kind) for term in terms(force)], particles, numbers)
        for kind, terms, particles, numbers in (
            (openmm.HarmonicBondForce, _bonds, 2, 2),
            (openmm.HarmonicAngleForce, _angles, 3, 2),
            (openmm.CustomBondForce, _pairs, 2, 3),
        )
    )
    return Terms(*bonds, *angles, *_torsions(some), *pairs)


def _known(force: Any) -> bool:
    if force.usesPeriodicBoundaryConditions():
        return False
    if isinstance(force, openmm.CustomBondForce):
        return bool(force.getEnergyFunction() == PAIR)
    kinds = openmm.HarmonicBondForce, openmm.HarmonicAngleForce, openmm.PeriodicTorsionForce, openmm.RBTorsionForce
    return isinstance(force, kinds)


def _bonds(force: openmm.HarmonicBondForce) -> Iterator[tuple[float, ...]]:
    for i, j, length, strength in map(force.getBondParameters, range(force.getNumBonds())):
        yield i, j, length._value, strength._value


def _angles(force: openmm.HarmonicAngleForce) -> Iterator[tuple[float, ...]]:
    for i, j, k, angle, strength in map(force.getAngleParameters, range(force.getNumAngles())):
        yield i, j, k, angle._value, strength._value


def _pairs(force: openmm.CustomBondForce) -> Iterator[tuple[float, ...]]:
    for i, j, (charges, sigma, epsilon) in map(force.getBondParameters, range(force.getNumBonds())):
        yield i, j, COULOMB * charges, sigma, epsilon


def _arrays(terms: list[tuple[float, ...]], particles: int, numbers: int) -> tuple[Indices, Array]:
    rows = np.array(terms, dtype=np.float64).reshape(len(terms), particles + numbers)
    return rows[:, :particles].astype(np.int64), np.ascontiguousarray(rows[:, particles:])


def _torsions(forces: list[Any]) -> tuple[Indices, Array]:
    """Return particles (T, 4) and coefficients (T, 2, N) of cosines and sines; all terms of four particles are one."""
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
    coefficients = np.zeros((len(series), 2, highest))
    for row, terms in zip(coefficients, series.values(), strict=True):
        for n, a, b in terms:
            if n:  # a constant has no force
                row[:, n - 1] += a, b
    return np.array(list(series), dtype=np.int64).reshape(-1, 4), coefficients
