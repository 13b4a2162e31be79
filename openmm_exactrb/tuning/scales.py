"""How large and how fast a system is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.tuning.start import Start

Array = NDArray[np.float64]


class Scales(NamedTuple):
    """How large and how fast a system is.

    Attributes
    ----------
    n_bodies : int
        Rigid bodies and particles beside them.
    time : float
        1/omega in ps, where omega² is the mean square of force over mass, and of torque over moment of inertia, over
        kT: the root mean square frequency in equilibrium.
    kinetic : float
        Kinetic energy in kJ/mol per body.
    """

    n_bodies: int
    time: float
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
    bodies, state = integrator.bodyState()
    context.computeVirtualSites()
    forces = context.getState(forces=True).getForces(asNumpy=True)._value
    if not np.isfinite(forces).all():
        raise ValueError("the forces at the start are not finite: minimise the energy first")
    kinetic = sum(bodies.kinetic_energies(state))
    time = _time_scale(bodies, *bodies.forces(state, forces), kinetic)
    return Scales(len(bodies), time, kinetic / len(bodies))


def _time_scale(bodies: RigidBodies, force: Array, torque: Array, kinetic: float) -> float:
    moments = np.broadcast_to(bodies.inertia.T, torque.shape)
    turning = torque[moments > 0.0] ** 2 / moments[moments > 0.0]
    square = float((force**2 / bodies.mass).sum() + turning.sum())
    if not kinetic > 0.0 or not square > 0.0:
        raise ValueError("nothing moves or no force acts: there is no energy error to measure")
    return math.sqrt(2.0 * kinetic / square)
