"""The parameters of a System and its forces as arrays.

OpenMM's functions are called below the layer that creates Quantities, which takes several times as long: a membrane has
a million bonds. The parameters of a term of a custom force are in the order of their names.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm

from openmm_exactrb.support.types import Array, Indices

#: Whole numbers of terms, particles among them (n, k), and other numbers (n, m), as OpenMM has them, in its units.
Rows = tuple[Indices, Array]

# What the terms of a force are called, and how many whole and other numbers they have: no count for those of a tuple.
_TERMS = {
    openmm.HarmonicBondForce: ("Bond", 2, 2),
    openmm.HarmonicAngleForce: ("Angle", 3, 2),
    openmm.PeriodicTorsionForce: ("Torsion", 5, 2),
    openmm.RBTorsionForce: ("Torsion", 4, 6),
    openmm.CMAPTorsionForce: ("Torsion", 9, 0),
    openmm.CustomBondForce: ("Bond", 2, None),
    openmm.CustomAngleForce: ("Angle", 3, None),
    openmm.CustomTorsionForce: ("Torsion", 4, None),
}


def terms(force: Any) -> Rows:
    """Return the bonds, angles or torsions of a bonded force."""
    name, whole, others = _TERMS[type(force)]
    rows = _rows(force, f"get{name}Parameters", getattr(force, f"getNum{name}s")())
    if others is None:
        rows = [[*row[:whole], *row[whole]] for row in rows]
        others = getattr(force, f"getNumPer{name}Parameters")()
    return _divided(rows, whole, others)


def exceptions(force: openmm.NonbondedForce) -> Rows:
    """Return particles, and product of charges, sigma and epsilon of the exceptions of a force."""
    return _divided(_rows(force, "getExceptionParameters", force.getNumExceptions()), 2, 3)


def constraints(system: openmm.System) -> Rows:
    """Return the particles (n, 2) of constraints, and their lengths (n,) in nm."""
    particles, lengths = _divided(_rows(system, "getConstraintParameters", system.getNumConstraints()), 2, 1)
    return particles, lengths[:, 0]


def masses(system: openmm.System) -> Array:
    """Return the masses of all particles in dalton."""
    return np.array(_rows(system, "getParticleMass", system.getNumParticles()), dtype=np.float64)


def _rows(source: Any, function: str, count: int) -> list[Any]:
    """Return the results of a method for each index, without units."""
    get = getattr(openmm._openmm, f"{type(source).__name__}_{function}")  # noqa: SLF001
    return [get(source, i) for i in range(count)]


def _divided(rows: list[Any], whole: int, others: int) -> Rows:
    particles = np.array([row[:whole] for row in rows], dtype=np.int64).reshape(-1, whole)
    return particles, np.array([row[whole:] for row in rows], dtype=np.float64).reshape(len(rows), others)
