"""A minimum of the potential energy: rigid bodies stay rigid, clusters keep their constraints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.chart import Chart, OutOfReachError
from openmm_exactrb.motion.state import BodyState
from openmm_exactrb.quaternions import exponential, multiply

Array = NDArray[np.float64]

# Coordinates of Systems with clusters are in this unit (nm) at first, which the first trial step of a search is long;
# in the last one, a step that still leaves the chart is an error.
_FIRST, _LEAST = 1e-2, 1e-6

#: landscape(state) -> potential energy, forces (3, N), body-frame torques (3, K).
Landscape = Callable[[BodyState], tuple[float, Array, Array]]


def minimised(
    bodies: RigidBodies, start: BodyState, landscape: Landscape, tolerance: float, iterations: int
) -> BodyState:
    """Return the bodies at a minimum of their potential energy, with the momenta of the start.

    Coordinates are displacements and turns exp(theta) of each body from where it starts, turns in units of its radius
    of gyration; the method is that of Zhu, Byrd, Lu and Nocedal, doi:10.1145/279232.279236. Atoms of clusters have the
    coordinates of a `Chart`. Where a search leaves it, another one starts at the best place that was found.

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
    best, reach = [(np.inf, start)], _FIRST if len(bodies.clusters) else 1.0
    while True:
        before = best[-1][0]
        try:
            return _searched(bodies, best, landscape, tolerance, iterations, reach)
        except OutOfReachError:
            reach *= 1.0 if best[-1][0] < before < np.inf else 0.1
            if reach < _LEAST:
                raise


def _searched(
    bodies: RigidBodies,
    best: list[tuple[float, BodyState]],
    landscape: Landscape,
    tolerance: float,
    iterations: int,
    unit: float,
) -> BodyState:
    """Search from the last of the best places, with coordinates in a unit (nm); better ones are added to them.

    Raises
    ------
    OutOfReachError
        If the search leaves the chart of the clusters.
    """
    from scipy.optimize import minimize  # here, for a short import of the package

    start = best[-1][1]
    chart = Chart(bodies.clusters, start.R[:, bodies.clustered])
    n, k = len(bodies), bodies.n_turning
    radius = np.sqrt(np.broadcast_to(bodies.inertia.mean(axis=1), (k,)) / bodies.mass[:k])

    def split(x: Array) -> tuple[Array, Array]:
        return unit * x[: 3 * n].reshape(3, n), unit * x[3 * n :].reshape(3, k) / radius

    def placed(x: Array) -> BodyState:
        shift, turn = split(x)
        R = start.R + shift
        R[:, bodies.clustered] = chart.placed(shift[:, bodies.clustered])
        return start._replace(R=R, q=multiply(start.q, exponential(turn)))

    def value(x: Array) -> tuple[float, Array]:
        state = placed(x)
        energy, force, torque = landscape(state)
        if energy < best[-1][0]:
            best[:] = [(energy, state)]
        force[:, bodies.clustered] = chart.slope(state.R[:, bodies.clustered], force[:, bodies.clustered])
        slope = _along_turns(split(x)[1], torque) / radius
        return energy, -unit * np.concatenate([force.ravel(), slope.ravel()])

    options: Any = {
        "gtol": unit * tolerance,
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
