"""Vectors of an OpenMM State as numpy arrays, without units.

`State.getForces(asNumpy=True)` and similar methods spend about 12 microseconds on units and attributes, which matters
if a force evaluation takes 40 microseconds. This module therefore calls the inner methods directly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.support.types import Array, Indices


def positions(state: openmm.State) -> Array:
    """Return the positions (n_particles, 3) in nm."""
    return _vectors(state, openmm.State.Positions)


def velocities(state: openmm.State) -> Array:
    """Return the velocities (n_particles, 3) in nm/ps."""
    return _vectors(state, openmm.State.Velocities)


def forces(state: openmm.State) -> Array:
    """Return the forces (n_particles, 3) in kJ/mol/nm."""
    return _vectors(state, openmm.State.Forces)


def surroundings(state: openmm.State) -> tuple[tuple[float, ...], dict[str, float]]:
    """Return the box and the parameters of a State, on which forces depend in addition to positions."""
    return box(state), dict(state.getParameters())


def take_parameters(context: openmm.Context, state: openmm.State) -> None:
    """Set parameters of a Context to those of a State, omitting parameters that only one of them has."""
    theirs = state.getParameters()
    for name in context.getParameters():
        if name in theirs:
            context.setParameter(name, theirs[name])


def take_surroundings(context: openmm.Context, state: openmm.State) -> None:
    """Set the box and the parameters of a Context to those of a State."""
    context.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    take_parameters(context, state)


def box(state: openmm.State) -> tuple[float, ...]:
    """Return the nine components of the vectors of the periodic box in nm."""
    return tuple(x for vector in state.getPeriodicBoxVectors()._value for x in vector)


def periodic_box(source: openmm.System | openmm.Context) -> Array | None:
    """Return the box vectors (3, 3) of a Context, or the defaults of a System, in nm; None without a periodic box."""
    system = source if isinstance(source, openmm.System) else source.getSystem()
    if not system.usesPeriodicBoundaryConditions():
        return None
    if isinstance(source, openmm.System):
        return np.array([vector.value_in_unit(unit.nanometer) for vector in source.getDefaultPeriodicBoxVectors()])
    return np.reshape(box(source.getState()), (3, 3))


def alike(rows: NDArray[Any]) -> tuple[Indices, Indices]:
    """Return the index of the first row of each group of bit-identical rows, in order, and the group of each row."""
    rows = np.ascontiguousarray(rows)
    keys = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1])))[:, 0]
    _, first, group = np.unique(keys, return_index=True, return_inverse=True)
    return np.sort(first), np.argsort(np.argsort(first))[group]


def _vectors(state: openmm.State, kind: int) -> Array:
    values = np.empty((state._getNumParticles(), 3))  # noqa: SLF001  # OpenMM has no public method without units
    state._getVectorAsNumpy(kind, values)  # noqa: SLF001
    return values
