"""The parameters of a System and its forces as arrays, read through OpenMM's C interface.

A call from Python takes several microseconds per bond, and a membrane may have a million bonds. The parameters of a
custom force are in the order of its parameter names.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.support.types import Array, Indices

#: Integers (n, k) of terms, such as particles, and real numbers (n, m), in the order and the units of OpenMM.
TermRows = tuple[Indices, Array]

# For each force: the name of its terms, and their numbers of integers and of real numbers (None if OpenMM returns the
# real numbers in an array).
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
_MOST = 10


def terms(force: Any) -> TermRows:
    """Return the bonds, angles or torsions of a bonded force."""
    name, whole, others = _TERMS[type(force)]
    count = getattr(force, f"getNum{name}s")()
    if others is None:
        others = getattr(force, f"getNumPer{name}Parameters")()
        return _rows_of_arrays(force, f"get{name}Parameters", count, whole, others)
    return _rows(force, f"get{name}Parameters", count, whole, others)


def exceptions(force: openmm.NonbondedForce) -> TermRows:
    """Return particles (n, 2) of the exceptions of a force, and their charge products, sigma and epsilon (n, 3)."""
    return _rows(force, "getExceptionParameters", force.getNumExceptions(), 2, 3)


def exception_offsets(force: openmm.NonbondedForce) -> tuple[list[str], Indices, Array]:
    """Return the offsets of exceptions: their parameters, the indices of their exceptions, and their scales (n, 3)."""
    found = [force.getExceptionParameterOffset(i) for i in range(force.getNumExceptionParameterOffsets())]
    places = np.array([exception for _, exception, *_ in found], dtype=np.int64)
    return [name for name, *_ in found], places, np.array([scales for _, _, *scales in found]).reshape(-1, 3)


def constraints(system: openmm.System) -> TermRows:
    """Return the particles (n, 2) of constraints, and their lengths (n,) in nm."""
    particles, lengths = _rows(system, "getConstraintParameters", system.getNumConstraints(), 2, 1)
    return particles, lengths[:, 0]


def masses(system: openmm.System) -> Array:
    """Return the masses of all particles in dalton."""
    out = np.empty(system.getNumParticles())
    _loops().values(_address("System_getParticleMass"), int(system.this), out)
    return out


def _rows(source: Any, function: str, count: int, whole: int, others: int) -> TermRows:
    particles, numbers = np.empty((count, whole), dtype=np.int64), np.empty((count, others))
    row, real = np.empty(whole, dtype=np.int32), np.empty(others)
    targets = _targets(*_places(row), *_places(real))
    address = _address(f"{type(source).__name__}_{function}")
    _loops().rows(address, int(source.this), *targets, row, real, particles, numbers)
    return particles, numbers


def _rows_of_arrays(source: Any, function: str, count: int, whole: int, others: int) -> TermRows:
    particles, numbers = np.empty((count, whole), dtype=np.int64), np.empty((count, others))
    row = np.empty(whole, dtype=np.int32)
    create, destroy = (_library()[f"OpenMM_DoubleArray_{name}"] for name in ("create", "destroy"))
    create.restype = ctypes.c_void_p
    array = create(others)
    try:
        address, element = _address(f"{type(source).__name__}_{function}"), _address("DoubleArray_get")
        targets = _targets(*_places(row), array)
        _loops().rows_of_arrays(address, element, array, int(source.this), *targets, row, particles, numbers)
    finally:
        destroy(ctypes.c_void_p(array))
    return particles, numbers


def _places(row: NDArray[Any]) -> tuple[int, ...]:
    """Return the addresses of the elements of an array."""
    return tuple(row.ctypes.data + row.itemsize * i for i in range(len(row)))


def _targets(*addresses: int) -> tuple[int, tuple[int, ...]]:
    """Return the number of target addresses, and the addresses padded to the number for which loops are compiled."""
    return len(addresses), addresses + (0,) * (_MOST - len(addresses))


def _loops() -> Any:
    from openmm_exactrb.openmm_access import loops  # imported here, because numba is slow to import

    return loops


@cache
def _library() -> Any:
    """Return OpenMM's library, which is found through the Python module that is linked to it."""
    return ctypes.CDLL("OpenMM.dll" if sys.platform == "win32" else openmm._openmm.__file__)  # noqa: SLF001


def _address(function: str) -> int:
    return int(ctypes.cast(_library()[f"OpenMM_{function}"], ctypes.c_void_p).value or 0)
