"""Velocities that a Context draws, ``Context.setVelocitiesToTemperature``, where its integrator is one of this package.

OpenMM draws those of particles, and its solver of constraints makes them fit. The momenta of rigid bodies are canonical
then, for no impulse along a constraint changes them. But where constraints are redundant the solver does not converge,
or leaves a straight or flat body motions that bend it; it does not know what the box has split, nor the bodies that a
user named; and it sets the centre of mass in motion, which a CMMotionRemover stops.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.detection.whole import constraints
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.openmm_access.units import gas_constant_times

Array = NDArray[np.float64]
# Of the thermal speed of the lightest particle, what a solver that converged may leave along a constraint.
_LEFT = 1e-3
# A constraint that is missed by this part of its length is one that the box has split.
_SPLIT = 0.5
# The least pivot of independent constraints, whose directions are unit vectors.
_DEPENDENT = 1e-6


def draw_by_integrators(kind: type[Any]) -> None:
    """Have integrators of a class draw the velocities that OpenMM cannot, by their method of the same name.

    The method of all Contexts is replaced, since one may be asked for velocities before its integrator knows it.
    """
    method = openmm.Context.setVelocitiesToTemperature

    @functools.wraps(method)
    def draw(context: Any, *arguments: Any) -> None:
        integrator: Any = context.getIntegrator()
        if not isinstance(integrator, kind):
            method(context, *arguments)
            return
        before = context.getState(velocities=True).getVelocities()
        if not integrator.getNamedBodies():
            method(context, *arguments)
            if _fit(context, *arguments):
                _stop(context)
                return
        context.setVelocities(before)
        integrator.setVelocitiesToTemperature(*arguments)

    openmm.Context.setVelocitiesToTemperature = draw


def _masses(system: openmm.System) -> Array:
    return np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])


def _fit(context: Any, temperature: Any, *_: Any) -> bool:
    """Return whether OpenMM can draw here: its velocities are finite, and have nothing along the constraints.

    Where the box has split molecules their directions are wrong, and where constraints follow from others there are
    motions across all of them that a rigid body does not have.
    """
    system, state = context.getSystem(), context.getState(positions=True, velocities=True)
    x, v, masses = arrays.positions(state), arrays.velocities(state), _masses(system)
    pairs, lengths = constraints(system)
    i, j = pairs.T
    apart = x[i] - x[j]
    distance = np.linalg.norm(apart, axis=1)
    slow = _LEFT * math.sqrt(gas_constant_times(temperature) / np.min(masses, where=masses > 0.0, initial=math.inf))
    if not np.isfinite(v).all() or not (np.abs(distance - lengths) <= _SPLIT * lengths).all():
        return False
    along = np.abs(np.einsum("ij,ij->i", v[i] - v[j], apart)) / distance
    return bool((along <= slow).all()) and not _redundant(apart / distance[:, None], pairs, len(x))


def _redundant(directions: Array, pairs: NDArray[np.intp], n_particles: int) -> bool:
    """Return whether velocities along some constraints (m, 3) follow from those along others."""
    from scipy.sparse import csr_array  # here, for a short import of the package
    from scipy.sparse.linalg import splu

    if not len(pairs):
        return False
    columns = (3 * pairs[:, :, None] + np.arange(3)).reshape(len(pairs), 6)
    entries = np.hstack([directions, -directions])
    J = csr_array(
        (entries.ravel(), columns.ravel(), 6 * np.arange(len(pairs) + 1)), shape=(len(pairs), 3 * n_particles)
    )
    try:
        pivots = splu((J @ J.T).tocsc()).U.diagonal()
    except RuntimeError:  # exactly singular
        return True
    return bool(np.abs(pivots).min() < _DEPENDENT)


def _stop(context: Any) -> None:
    """Bring the centre of mass to rest if the System has a CMMotionRemover, which does so at the first step."""
    system = context.getSystem()
    if any(isinstance(force, openmm.CMMotionRemover) for force in system.getForces()):
        v, masses = arrays.velocities(context.getState(velocities=True)), _masses(system)
        context.setVelocities(v - np.where(masses[:, None] > 0.0, masses @ v / masses.sum(), 0.0))
