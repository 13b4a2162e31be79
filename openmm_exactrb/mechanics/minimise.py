"""Minimisation of the potential energy of rigid bodies."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from openmm_exactrb.errors import MinimisationWarning, NonFiniteError
from openmm_exactrb.mathematics.quaternions import exponential, multiply
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.images import closest_pair
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.support.types import Array
from openmm_exactrb.support.warn import warn

# The unit (nm) of the coordinates in the last search, which is the length of its first trial step.
_LEAST = 1e-6
# The relative resolution of an energy in single precision. A smaller decrease is ignored.
_GAINED = 1e-7

#: landscape(state) -> potential energy, forces (3, N), body-frame torques (3, K).
Landscape = Callable[[BodyState], tuple[float, Array, Array]]


@dataclass
class _Search:
    """The data that one search passes to the next: the best position with its energy, and the number of iterations."""

    state: BodyState
    energy: float = math.inf
    iterations: int = 0


def minimised(
    bodies: RigidBodies,
    start: BodyState,
    landscape: Landscape,
    tolerance: float,
    iterations: int,
    box: Array | None = None,
) -> BodyState:
    """Return the state at a minimum of the potential energy, with the momenta of `start`.

    Coordinates are the displacement and the rotation exp(theta) of each body relative to `start`, where theta is
    multiplied by the radius of gyration. The method is L-BFGS-B: Zhu, Byrd, Lu and Nocedal, doi:10.1145/279232.279236.
    If a search ends above the tolerance, for example because overlapping bodies cause huge forces, another search
    starts at the best position found. The tolerance, in kJ/mol/nm, limits the largest component of a force, and of a
    torque divided by the radius of gyration. The argument `iterations` limits the number of iterations of all searches
    together; 0 means no limit. A NonFiniteError is raised if the energy or a force at `start` is not finite. A
    MinimisationWarning is issued if the energy stops falling before a search reaches the tolerance.
    """
    if not all(np.isfinite(np.sum(part)) for part in landscape(start)):
        closest = f" (the closest are {closest_pair(start, box)})" if len(bodies) > 1 else ""
        raise NonFiniteError(
            f"the energy or a force at the start of the minimisation is not finite{closest}: set positions in which no "
            "particles overlap"
        )
    search, reach = _Search(start), 1.0
    while True:
        before = search.energy
        state, force = _searched(bodies, search, landscape, tolerance, iterations, reach)
        if force <= tolerance or 0 < iterations <= search.iterations:
            return state
        if before < math.inf and not search.energy < before - _GAINED * abs(before):
            if reach < 10.0 * _LEAST:
                break
            reach *= 0.1
    warn(
        f"the minimisation ended at a force of {force:.3g} kJ/mol/nm, above the tolerance of {tolerance:.3g}, "
        "because the energy stopped decreasing: use a larger tolerance, or forces in double precision",
        MinimisationWarning,
    )
    return search.state


def _searched(
    bodies: RigidBodies,
    search: _Search,
    landscape: Landscape,
    tolerance: float,
    iterations: int,
    unit: float,
) -> tuple[BodyState, float]:
    """Search from the best position, with coordinates in a unit (nm); return the last state and its largest force."""
    from scipy.optimize import minimize  # imported here, because it is slow to import

    start = search.state
    n, k = len(bodies), bodies.n_turning
    radius = np.sqrt(np.broadcast_to(bodies.inertia.mean(axis=1), (k,)) / bodies.mass[:k])

    def split(x: Array) -> tuple[Array, Array]:
        return unit * x[: 3 * n].reshape(3, n), unit * x[3 * n :].reshape(3, k) / radius

    def placed(x: Array) -> BodyState:
        shift, turn = split(x)
        return start._replace(R=start.R + shift, q=multiply(start.q, exponential(turn)))

    def value(x: Array) -> tuple[float, Array]:
        state = placed(x)
        energy, force, torque = landscape(state)
        if energy < search.energy:
            search.energy, search.state = energy, state
        slope = _along_turns(split(x)[1], torque) / radius
        return energy, -unit * np.concatenate([force.ravel(), slope.ravel()])

    def count(xk: Array) -> None:
        search.iterations += 1

    options: Any = {
        "gtol": unit * tolerance,
        "ftol": 0.0,
        "maxiter": iterations - search.iterations if iterations else 1_000_000,
        "maxfun": 10_000_000,
        "maxls": 50,
    }
    found = minimize(value, np.zeros(3 * (n + k)), jac=True, method="L-BFGS-B", callback=count, options=options)
    return placed(found.x), float(np.abs(found.jac).max(initial=0.0)) / unit


def _along_turns(turn: Array, torque: Array) -> Array:
    """Return the torque (3, K) conjugate to theta, J^T torque, where omega = J d(theta)/dt in the body frame."""
    angle = np.sqrt((turn * turn).sum(axis=0))
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    across = np.cross(turn, torque, axis=0)
    along: Array = torque + first * across + second * np.cross(turn, across, axis=0)
    return along
