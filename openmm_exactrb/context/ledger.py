"""The full state in variables of an OpenMM integrator, where checkpoints and States take it along.

The names and the layout are the format of checkpoints: they stay.
"""

from __future__ import annotations

import numpy as np
import openmm

from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.state import State

# Per-DOF variables, on the first particle of each body: high parts, then low parts of the sums.
_NAMES = tuple(f"exactrb_{name}{part}" for part in ("", "_low") for name in "RPmqw")
# Whether there is a state in them, and whether Python is at work.
_STORED = "exactrb_stored"
_NOTHING, _WRITTEN, _STEPPING = 0.0, 1.0, 2.0
#: What is said of a checkpoint in the variables of another engine than its own.
OTHER_ENGINE = (
    'the checkpoint that was loaded is of a run with engine="{0}": make the integrator with engine="{0}" or "auto"'
)


def declare(integrator: openmm.CustomIntegrator) -> None:
    """Give a new integrator its variables, and the program that lets OpenMM do its own part of a step.

    A copy that OpenMM makes, from XML or within a CompoundIntegrator, has no Python: its steps would let the clock run
    while nothing moves. So positions and velocities become nan unless a step comes from Python.
    """
    for name in _NAMES:
        integrator.addPerDofVariable(name, 0.0)
    integrator.addGlobalVariable(_STORED, _NOTHING)
    integrator.beginIfBlock(f"{_STORED} < {_STEPPING}")
    integrator.addComputePerDof("x", f"x + log({_STORED} - 3)")
    # Forces at such positions are an error where the platform looks at them: Reference does not.
    integrator.addComputePerDof("v", f"v + f + log({_STORED} - 3)")
    integrator.endBlock()
    integrator.addUpdateContextState()


def step(integrator: openmm.CustomIntegrator, steps: int) -> None:
    """Let OpenMM make steps of its own: it counts them, and barostats and thermostats of the System do their part."""
    before = integrator.getGlobalVariableByName(_STORED)
    integrator.setGlobalVariableByName(_STORED, _STEPPING)
    try:
        openmm.CustomIntegrator.step(integrator, steps)
    finally:
        integrator.setGlobalVariableByName(_STORED, before)


def write(integrator: openmm.CustomIntegrator, bodies: RigidBodies, state: State) -> None:
    """Write the sums of a state."""
    R, P, q, m = state
    first, turning = bodies.first_particle, bodies.first_particle[: bodies.n_turning]
    full = np.zeros((2, 5, bodies.n_particles, 3))
    full[:, 0, first], full[:, 1, first] = R.swapaxes(1, 2), P.swapaxes(1, 2)
    full[:, 2, turning], full[:, 3, turning] = m.swapaxes(1, 2), q[:, 1:].swapaxes(1, 2)
    full[:, 4, turning, 0] = q[:, 0]
    for name, values in zip(_NAMES, full.reshape(-1, bodies.n_particles, 3), strict=True):
        integrator.setPerDofVariableByName(name, values)
    integrator.setGlobalVariableByName(_STORED, _WRITTEN)


def read(integrator: openmm.CustomIntegrator, bodies: RigidBodies) -> State | None:
    """Read the sums of a state, if one was written.

    Raises
    ------
    ValueError
        If a checkpoint of the other engine is in the variables.
    """
    stored = integrator.getGlobalVariableByName(_STORED)
    if stored not in (_NOTHING, _WRITTEN, _STEPPING):
        raise ValueError(OTHER_ENGINE.format("device"))
    if not stored:
        return None
    first, k = bodies.first_particle, bodies.n_turning
    columns = [np.array(integrator.getPerDofVariableByName(name), dtype=np.float64)[first].T for name in _NAMES]
    R, P, m, vector, w = np.array(columns).reshape(2, 5, 3, len(first)).swapaxes(0, 1)
    q = np.concatenate([w[:, :1, :k], vector[:, :, :k]], axis=1)
    if not q[0].any(axis=0).all():  # `reinitialize` keeps numbers, but no vectors
        return None
    return State(*map(np.ascontiguousarray, (R, P, q, m[:, :, :k])))
