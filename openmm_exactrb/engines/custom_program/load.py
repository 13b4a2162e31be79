"""The state of bodies to and from the program's variables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context import variables
from openmm_exactrb.engines.custom_program import names
from openmm_exactrb.engines.custom_program.noise import streams
from openmm_exactrb.mathematics.quaternions import matrix, turned
from openmm_exactrb.mechanics.bodies import Kind, RigidBodies
from openmm_exactrb.mechanics.state import BodyState, State
from openmm_exactrb.rotors.exact import constants

Array = NDArray[np.float64]


def write(integrator: openmm.CustomIntegrator, bodies: RigidBodies, state: State) -> None:
    """Give every particle a copy of its body's state, whose low parts are dropped, and the body's constants.

    Forces that were remembered, which may not be finite, are forgotten.
    """
    values = {name: np.zeros((bodies.n_particles, 3)) for name in names.STATE + names.CONSTANTS + names.FORCES}
    for kind in bodies.kinds:
        for name, rows in _of_bodies(kind, bodies, state.rounded).items():
            values[name][kind.particles] = rows[:, None]
        values["s"][kind.particles] = kind.sites
        if kind.turns:
            attitudes = matrix(state.q[0][:, kind.bodies]).transpose(2, 0, 1)
            values["d"][kind.particles] = turned(attitudes, kind.sites)
    known, nothing = _variables(integrator), np.zeros((bodies.n_particles, 3))
    if names.DISPLACED[0] in known:
        values |= dict(zip(names.DISPLACED, (values["q"], values["w"], nothing), strict=True))
    if names.PENDING in known:
        values |= {names.PENDING: nothing, names.CLUSTERED: nothing.copy(), "y": nothing.copy()}
        values[names.CLUSTERED][bodies.clusters.particles] = 1.0
        bodies.velocities(state.rounded, values["y"])
    values |= {name: nothing for name in known if name.startswith(names.LAST_FORCES)}
    for name, rows in values.items():
        integrator.setPerDofVariableByName(name, rows)
    tell(integrator, {names.KNOWN: 0.0, names.LOADED: names.HELD, names.CHANGED: 1.0})
    variables.put(integrator, variables.COORDINATES, 0.0)  # an inner state that was kept is another one's


def _variables(integrator: openmm.CustomIntegrator) -> list[str]:
    return [integrator.getPerDofVariableName(i) for i in range(integrator.getNumPerDofVariables())]


def tell(integrator: openmm.CustomIntegrator, numbers: Mapping[str, float]) -> None:
    """Set global variables of the program."""
    for name, value in numbers.items():
        integrator.setGlobalVariableByName(name, float(value))


def seed(integrator: openmm.CustomIntegrator, bodies: RigidBodies, number: int, drawn: int) -> None:
    """Set the random number generators for a seed and the count of numbers already drawn."""
    for name, begin in zip(names.STREAMS, streams(len(bodies), number, drawn), strict=True):
        rows = np.ones((bodies.n_particles, 3))
        for kind in bodies.kinds:
            rows[kind.particles] = begin[kind.bodies][:, None]
        integrator.setPerDofVariableByName(name, rows)
    integrator.setGlobalVariableByName(names.SEEDED, float(number))


def flag(integrator: openmm.CustomIntegrator, bodies: RigidBodies, flexible: NDArray[np.bool_]) -> None:
    """Load whether bodies (n_bodies,) are in flexible molecules, to all of their particles."""
    rows = np.zeros((bodies.n_particles, 3))
    for kind in bodies.kinds:
        rows[kind.particles] = flexible[kind.bodies][:, None, None]
    integrator.setPerDofVariableByName(names.FLEXIBLE, rows)
    integrator.setGlobalVariableByName(names.FLAGGED, 1.0)


def _of_bodies(kind: Kind, bodies: RigidBodies, state: BodyState) -> Mapping[str, Array]:
    """Return the variables that all particles of a body share, (n, 3)."""
    some, n = kind.bodies, len(kind.particles)
    same = np.ones((n, 3))
    rows = {
        "R": state.R.T[some],
        "P": state.P.T[some],
        "L": 0.0 * same,
        "q": 0.0 * same,
        "w": same,
        "abc": same * (0.0, 0.0, 1.0),
        "inverse": same * (0.0, 1.0 / kind.mass, 1.0 / kind.particles.shape[1]),
        "shape": same * (kind.turns and not kind.linear, not kind.turns, 1.0),
    }
    if kind.turns:
        c = constants(np.ascontiguousarray(bodies.inertia.T))
        c = np.broadcast_to(c if c.shape[1] == 1 else c[:, some], (len(c), n))
        rows["L"], rows["q"], rows["w"] = state.m.T[some], state.q[1:].T[some], state.q[0][some, None] * same
        rows["abc"], rows["inverse"][:, 0] = c[:3].T, c[3]
    return rows


def read(integrator: openmm.CustomIntegrator, bodies: RigidBodies) -> State | None:
    """Return the state of the bodies, each where its first particle is; None if none was loaded.

    The momenta of clusters are those that are shown: the program's may have parts along the bonds.
    """
    if not integrator.getGlobalVariableByName(names.LOADED):
        return None
    first, k = bodies.first_particle, bodies.n_turning
    R, image, P, L, q, w, y = (
        np.array(integrator.getPerDofVariableByName(name), dtype=np.float64)[first].T
        for name in ("R", "image", "P", "L", "q", "w", "y")
    )
    P[:, bodies.clustered] = (bodies.mass * y)[:, bodies.clustered]
    attitudes = np.concatenate([w[:1, :k], q[:, :k]])
    if not attitudes.any(axis=0).all():  # `reinitialize` keeps numbers, but no vectors
        return None
    return State.of(BodyState(*map(np.ascontiguousarray, (R + image, P, attitudes, L[:, :k]))))


def fastest(bodies: RigidBodies, state: BodyState) -> float:
    """Return b norm(m) of the body that turns fastest in 1/ps, which the rotor's range limits: as the program sums it.

    Hence a call makes the same rotations after another call and from a loaded State.
    """
    if not bodies.n_turning:
        return 0.0
    b = constants(np.ascontiguousarray(bodies.inertia.T))[0]
    rates = b * np.sqrt(np.einsum("in,in->n", state.m, state.m))
    numbers = np.concatenate([np.full(len(k.particles), 3 * k.particles.shape[1]) for k in bodies.kinds if k.turns])
    most = float(rates.max())
    return most * float(numbers @ (rates / most) ** names.POWER) ** (1.0 / names.POWER) if most else 0.0
