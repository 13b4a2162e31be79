"""A minimum of the potential energy of rigid bodies, which stay rigid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.state import BodyState
from openmm_exactrb.quaternions import exponential, multiply

Array = NDArray[np.float64]

#: landscape(state) -> potential energy, forces (3, N), body-frame torques (3, K).
Landscape = Callable[[BodyState], tuple[float, Array, Array]]


def minimised(
    bodies: RigidBodies, start: BodyState, landscape: Landscape, tolerance: float, iterations: int
) -> BodyState:
    """Return the bodies at a minimum of their potential energy, with the momenta of the start.

    Coordinates are displacements and turns exp(theta) of each body from where it starts, turns in units of its radius
    of gyration; the method is that of Zhu, Byrd, Lu and Nocedal, doi:10.1145/279232.279236.

    Parameters
    ----------
    bodies : RigidBodies
    start : BodyState
    landscape : callable
    tolerance : float
        The largest component of a force, and of a torque over the radius of gyration, that may be left, in kJ/mol/nm.
    iterations : int
        At most as many; 0 for as many as it takes.
    """
    from scipy.optimize import minimize  # here, for a short import of the package

    n, k = len(bodies), bodies.n_turning
    radius = np.sqrt(np.broadcast_to(bodies.inertia.mean(axis=1), (k,)) / bodies.mass[:k])

    def split(x: Array) -> tuple[Array, Array]:
        return x[: 3 * n].reshape(3, n), x[3 * n :].reshape(3, k) / radius

    def placed(x: Array) -> BodyState:
        shift, turn = split(x)
        return start._replace(R=start.R + shift, q=multiply(start.q, exponential(turn)))

    def value(x: Array) -> tuple[float, Array]:
        energy, force, torque = landscape(placed(x))
        slope = _along_turns(split(x)[1], torque) / radius
        return energy, -np.concatenate([force.ravel(), slope.ravel()])

    options: Any = {
        "gtol": tolerance,
        "ftol": 0.0,
        "maxiter": iterations or 1_000_000,
        "maxfun": 10_000_000,
        "maxls": 50,
    }
    found = minimize(value, np.zeros(3 * (n + k)), jac=True, method="L-BFGS-B", options=options)
    return placed(found.x)


def _along_turns(turn: Array, torque: Array) -> Array:
    """Return the torque (3, K) in the body along the coordinates theta: J^T torque, where omega = J d(theta)/dt."""
    angle = np.sqrt((turn * turn).sum(axis=0))
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    across = np.cross(turn, torque, axis=0)
    along: Array = torque + first * across + second * np.cross(turn, across, axis=0)
    return along
