"""The state of bodies to and from the program's variables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context import ledger
from openmm_exactrb.device import names
from openmm_exactrb.device.noise import streams
from openmm_exactrb.kernels.plain.bodies import turned
from openmm_exactrb.motion.bodies import Kind, RigidBodies
from openmm_exactrb.motion.state import BodyState, State
from openmm_exactrb.quaternions import matrix
from openmm_exactrb.rotors.exact import constants

Array = NDArray[np.float64]


def write(integrator: openmm.CustomIntegrator, bodies: RigidBodies, state: State) -> None:
    """Give every particle a replica of its body's state, whose low parts are dropped, and the body's constants."""
    values = {name: np.zeros((bodies.n_particles, 3)) for name in names.STATE + names.CONSTANTS + names.FORCES}
    for kind in bodies.kinds:
        for name, rows in _of_bodies(kind, bodies, state.rounded).items():
            values[name][kind.particles] = rows[:, None]
        values["s"][kind.particles] = kind.sites
        if kind.turns:
            attitudes = matrix(state.q[0][:, kind.bodies]).transpose(2, 0, 1)
            values["d"][kind.particles] = turned(attitudes, kind.sites)
    if _has(integrator, names.DISPLACED[0]):
        values |= dict(
            zip(names.DISPLACED, (values["q"], values["w"], 0.0 * values["q"], 0.0 * values["q"]), strict=True)
        )
    for name, rows in values.items():
        integrator.setPerDofVariableByName(name, rows)
    for name, value in ((names.KNOWN, 0.0), (names.LOADED, names.HELD), (names.CHANGED, 1.0)):
        integrator.setGlobalVariableByName(name, value)


def _has(integrator: openmm.CustomIntegrator, name: str) -> bool:
    """Tell whether an integrator has a per-DOF variable."""
    return name in map(integrator.getPerDofVariableName, range(integrator.getNumPerDofVariables()))


def seed(integrator: openmm.CustomIntegrator, bodies: RigidBodies, number: int, drawn: int) -> None:
    """Have the generators of the bath stand where a seed, and how many numbers were drawn, say."""
    for name, begin in zip(names.STREAMS, streams(len(bodies), number, drawn), strict=True):
        rows = np.ones((bodies.n_particles, 3))
        for kind in bodies.kinds:
            rows[kind.particles] = begin[kind.bodies][:, None]
        integrator.setPerDofVariableByName(name, rows)
    integrator.setGlobalVariableByName(names.SEEDED, float(number))


def _of_bodies(kind: Kind, bodies: RigidBodies, state: BodyState) -> Mapping[str, Array]:
    """Return what all particles of a body have in common, (n, 3)."""
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

    Raises
    ------
    ValueError
        If a checkpoint of the other engine is in the variables.
    """
    loaded = integrator.getGlobalVariableByName(names.LOADED)
    if loaded not in (0.0, names.HELD):
        raise ValueError(ledger.OTHER_ENGINE.format("host"))
    if not loaded:
        return None
    first, k = bodies.first_particle, bodies.n_turning
    R, image, P, L, q, w = (
        np.array(integrator.getPerDofVariableByName(name), dtype=np.float64)[first].T
        for name in ("R", "image", "P", "L", "q", "w")
    )
    attitudes = np.concatenate([w[:1, :k], q[:, :k]])
    if not attitudes.any(axis=0).all():  # `reinitialize` keeps numbers, but no vectors
        return None
    return State.of(BodyState(*map(np.ascontiguousarray, (R + image, P, attitudes, L[:, :k]))))


def fastest(bodies: RigidBodies, state: BodyState) -> float:
    """Return b norm(m) of the body that turns fastest in 1/ps, which the rotor's range limits: as the program sums it.

    So a run has the same rotations, whether a call goes on from another one or from a State.
    """
    if not bodies.n_turning:
        return 0.0
    b = constants(np.ascontiguousarray(bodies.inertia.T))[0]
    rates = b * np.sqrt(np.einsum("in,in->n", state.m, state.m))
    numbers = np.concatenate([np.full(len(k.particles), 3 * k.particles.shape[1]) for k in bodies.kinds if k.turns])
    most = float(rates.max())
    return most * float(numbers @ (rates / most) ** names.POWER) ** (1.0 / names.POWER) if most else 0.0
