"""How large and how fast a system is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.tuning.start import Start

Array = NDArray[np.float64]

# What a particle that does not turn has for a size, in nm.
_SIZE = 0.1


class Scales(NamedTuple):
    """How large and how fast a system is.

    Attributes
    ----------
    n_bodies : int
        Rigid bodies and particles beside them.
    time : float
        1/omega in ps, where omega² is the mean square of force over mass, and of torque over moment of inertia, over
        kT: the root mean square frequency in equilibrium. Over the start and the instants before it that are known, and
        not above `free`: bodies that are far apart now may meet later.
    free : float
        Time in ps in which free bodies turn by a radian, and particles without a shape fly over 0.1 nm.
    kinetic : float
        Kinetic energy in kJ/mol per body.
    """

    n_bodies: int
    time: float
    free: float
    kinetic: float


def scales_of(start: Start) -> Scales:
    """Return the scales of a system at its start.

    Raises
    ------
    ValueError
        If the System has no rigid bodies, positions do not fit, or nothing moves.
    """
    integrator = ExactRigidBodyIntegrator(1e-6, scheme="V2", bodies=start.bodies, engine="host")
    context = start.context(integrator)
    frequencies = [frequency_of(integrator, context), *start.before]
    time = 1.0 / math.sqrt(np.square(frequencies).mean())
    bodies, state = integrator.bodyState()
    kinetic = sum(bodies.kinetic_energies(state))
    free = _free_time(bodies, kinetic)
    return Scales(len(bodies), min(time, free), free, kinetic / len(bodies))


def frequency_of(integrator: ExactRigidBodyIntegrator, context: openmm.Context) -> float:
    """Return the root mean square frequency in 1/ps at an instant; see `Scales`.

    Raises
    ------
    ValueError
        If nothing moves, or forces are zero or not finite.
    """
    bodies, state = integrator.bodyState()
    context.computeVirtualSites()
    groups = integrator.getIntegrationForceGroups()
    forces = context.getState(forces=True, groups=groups).getForces(asNumpy=True)._value
    if not np.isfinite(forces).all():
        raise ValueError("the forces at the start are not finite: minimise the energy first")
    (force, torque), kinetic = bodies.forces(state, forces), sum(bodies.kinetic_energies(state))
    moments = np.broadcast_to(bodies.inertia.T, torque.shape)
    turning = torque[moments > 0.0] ** 2 / moments[moments > 0.0]
    square = float((force**2 / bodies.mass).sum() + turning.sum())
    if not kinetic > 0.0 or not square > 0.0:
        raise ValueError("nothing moves or no force acts: there is no energy error to measure")
    return math.sqrt(square / (2.0 * kinetic))


def _free_time(bodies: RigidBodies, kinetic: float) -> float:
    """Return the time of a turn by a radian or a flight over a size, from the mean square of its inverse."""
    kT = 2.0 * kinetic / (bodies.translational_freedom + bodies.rotational_freedom)
    moments = np.broadcast_to(bodies.inertia, (bodies.n_turning, 3))
    moments = moments[moments > 0.0]
    inverse = np.concatenate([1.0 / moments, 1.0 / (bodies.mass[bodies.n_turning :] * _SIZE**2)])
    return float(1.0 / math.sqrt(kT * inverse.mean()))
