"""Declaration of the persistent variables in checkpoints, States with integratorParameters=True, and XML.

Their names and order define the format of checkpoints. All integrators of the package have the numbers in `_NUMBERS`,
so that an integrator can load a checkpoint of another kind of integrator. Further numbers of a thermostat are declared
last, and change the format. An OpenMM checkpoint contains numbers without names, and OpenMM loads them into the
variables of any integrator. The first number therefore also identifies the format.
"""

from __future__ import annotations

import weakref
import zlib
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import openmm

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import Force, Remembered, State
from openmm_exactrb.support.types import Array

#: The first part of the names of all variables.
PREFIX = "exactrb_"
# Per-DOF variables, on the first particle of each body: high parts, then low parts of the double-doubles.
_VECTORS = tuple(f"{name}{part}" for part in ("", "_low") for name in "RPmqw")
#: Prefixes of the state that the Context shows, and of the state in the inner coordinates of a processed scheme.
SHOWN, INNER = "", "inner_"
# Whether there is a state, and whether Python performs a step. Values from _WRITTEN to below _STEPPING mean that the
# variables hold a state, and identify its format; see `written`. _LIBRARY or _NATIVE is added to such a value if the
# library's integrator stores the state of the host, or if it stores the state of the native engine.
_STORED = "stored"
NOTHING, _WRITTEN, _STEPPING, _LIBRARY, _NATIVE = 0.0, 1.0, 2.0, 2.0, 4.0
#: What identifies that to which the inner state belongs (0 without an inner state), a sum of the forces at the saved
#: positions, and the numbers of forces and of differences of displaced forces that are stored with the inner state.
COORDINATES, FORCES, REMEMBERED, DIFFERENCES = "coordinates", "forces", "remembered", "differences"
#: The seed of the noise, and the number of its stream.
SEED, STREAM = "seed", "stream"
#: The heat that thermostats have exchanged, and the numbers of accepted and of all proposals in the Metropolis test.
HEAT, HEAT_OF_FRICTION, ACCEPTED, PROPOSED = "heat", "heat_of_friction", "accepted", "proposed"
_NUMBERS = (SEED, STREAM, HEAT, HEAT_OF_FRICTION, ACCEPTED, PROPOSED, COORDINATES, FORCES, REMEMBERED, DIFFERENCES)
# Error of steps that OpenMM's C++ tries to perform.
_NOT_BY_OPENMM = (
    "OpenMM alone cannot perform the steps of this integrator of openmm_exactrb: import openmm_exactrb before reading "
    "the integrator from XML, and do not add the integrator to a CompoundIntegrator"
)
#: Message about a checkpoint that another engine wrote.
OTHER_ENGINE = (
    'the loaded checkpoint is from a run with engine="{0}": create the integrator with engine="{0}" or "auto"'
)
#: Message about a checkpoint of the host engine from a process with the library in one without it, or the reverse.
OTHER_STORAGE = (
    "the loaded checkpoint or State was saved {0} the library of openmm_exactrb, but this integrator stores its state "
    "{1} the library: continue the run {0} the library (exactrb info shows whether there is one), or load only "
    "positions and velocities of a State into a new Context with openmm_exactrb.loadState"
)
#: Message about a checkpoint that has another format.
OTHER_FORMAT = (
    "the loaded checkpoint or State is from another kind of integrator, or from a thermostat with other variables "
    "(such as a chain of another length): create the same integrator as in the run that wrote it, or load only "
    "positions and velocities into a new Context with openmm_exactrb.loadState"
)


def declare(integrator: openmm.CustomIntegrator, own: Sequence[str] = (), memory: int | None = None) -> None:
    """Give a new integrator its variables, and the program with which OpenMM performs its own part of a step.

    An integrator that OpenMM read without this package, or that is part of a CompoundIntegrator, has no Python part.
    Its steps would advance the clock without moving the bodies. Therefore, the program raises an error unless Python
    performs the step. `own` lists the names of numbers that only some integrators have. For a processed scheme, which
    also has an inner state, `memory` is the number of stored forces.
    """
    stored = PREFIX + _STORED
    for name in _VECTORS:
        integrator.addPerDofVariable(PREFIX + name, 0.0)
    if memory is not None:
        for name in (*(INNER + name for name in _VECTORS), *(name for k in range(memory) for name in _last(k))):
            integrator.addPerDofVariable(PREFIX + name, 0.0)
    integrator.addGlobalVariable(stored, NOTHING)
    integrator.beginIfBlock(f"{stored} != {_STEPPING}")
    integrator.addComputePerDof(_NOT_BY_OPENMM, "0")  # not a variable: an error with this name on Reference and CPU
    integrator.addComputeGlobal("dt", "-1")  # a negative step size: an error on the other platforms
    integrator.endBlock()
    integrator.addUpdateContextState()
    declare_numbers(integrator, own)


def declare_numbers(integrator: openmm.CustomIntegrator, own: Sequence[str] = ()) -> None:
    """Give a new integrator the numbers that all integrators have, and those named by `own`, with values of zero."""
    for name in (*_NUMBERS, *own):
        integrator.addGlobalVariable(PREFIX + name, 0.0)


def written(own: Sequence[str]) -> float:
    """Return the first number, from 1 to below 2, of an integrator that holds a state and has the numbers `own`."""
    return _WRITTEN + (1 + zlib.crc32(" ".join(own).encode())) / 2**33 if own else _WRITTEN


def by_library(own: Sequence[str]) -> float:
    """Return the first number, from 3 to below 4, of an integrator of the library that stores a state of the host."""
    return written(own) + _LIBRARY


def marks(own: Sequence[str] = ()) -> tuple[float, float, float]:
    """Return the possible first numbers of an integrator that holds a state of the host and has the numbers `own`."""
    return written(own), by_library(own), _STEPPING


def declared(integrator: openmm.CustomIntegrator) -> bool:
    """Return whether an integrator has the variables of `declare`."""
    return bool(integrator.getNumGlobalVariables()) and integrator.getGlobalVariableName(0) == PREFIX + _STORED


def native(own: Sequence[str]) -> float:
    """Return the first number, from 5 to below 6, of an integrator that stores the state of the native engine."""
    return written(own) + _NATIVE


def declare_native(integrator: openmm.CustomIntegrator, own: Sequence[str] = ()) -> None:
    """Give the first number and the numbers of `declare_numbers` to a new integrator that stores the state itself."""
    integrator.addGlobalVariable(PREFIX + _STORED, NOTHING)
    declare_numbers(integrator, own)


def own_numbers(integrator: openmm.CustomIntegrator) -> list[str]:
    """Return the names of the numbers that an integrator has in addition to those of all integrators."""
    names = range(1 + len(_NUMBERS), integrator.getNumGlobalVariables())
    return [integrator.getGlobalVariableName(k).removeprefix(PREFIX) for k in names]


def get(integrator: openmm.CustomIntegrator, name: str) -> float:
    """Return the number with a given name."""
    return float(integrator.getGlobalVariableByName(PREFIX + name))


def put(integrator: openmm.CustomIntegrator, name: str, value: float) -> None:
    """Set the number with a given name."""
    integrator.setGlobalVariableByName(PREFIX + name, value)


def step_openmm(integrator: openmm.CustomIntegrator, steps: int) -> None:
    """Let OpenMM perform its own part of the given steps, in which barostats and thermostats of the System act."""
    before = get(integrator, _STORED)
    put(integrator, _STORED, _STEPPING)
    try:
        openmm.CustomIntegrator.step(integrator, steps)
    finally:
        put(integrator, _STORED, before)


class Numbers:
    """Numbers that the substeps of a call change; the changes take effect when the step is accepted."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self.present: dict[str, float] = {}
        self._kept: dict[str, float] = {}

    def load(self, integrator: openmm.CustomIntegrator) -> None:
        """Read the numbers at the start of a call."""
        self.present = {name: get(integrator, name) for name in self._names}
        self.keep()

    def keep(self) -> None:
        """Keep the present numbers, which `store` writes."""
        self._kept = dict(self.present)

    def store(self, integrator: openmm.CustomIntegrator) -> None:
        """Write the kept numbers at the end of a call."""
        for name, value in self._kept.items():
            put(integrator, name, value)


def mark(integrator: openmm.CustomIntegrator, value: float) -> None:
    """Set the first number of an integrator to one of its `marks`."""
    put(integrator, _STORED, value)


def marked(integrator: openmm.CustomIntegrator) -> bool:
    """Return whether the variables of an integrator hold a state."""
    return get(integrator, _STORED) != NOTHING


class Storage(Protocol):
    """Where an integrator stores the state of the bodies for checkpoints and States."""

    @property
    def mark(self) -> float:
        """The first number of an integrator that holds a state in this storage."""

    def write(self, state: State, which: str = SHOWN) -> None:
        """Write the double-doubles of a state."""

    def read(self, which: str = SHOWN) -> State | None:
        """Return the double-doubles of a state, or None if there are none."""

    def write_forces(self, memory: Sequence[Force]) -> None:
        """Write forces (3, N) and torques (3, K)."""

    def read_forces(self, count: int) -> list[Force] | None:
        """Return `count` forces and torques that `write_forces` wrote, or None if another scheme wrote them."""

    def forces_changed(self) -> bool | None:
        """Return whether parameters of forces have changed since the last call, or None if this is unknown."""


class PerDof:
    """The storage of an integrator without a library: its per-DOF variables, on the first particle of each body."""

    def __init__(self, integrator: openmm.CustomIntegrator, bodies: RigidBodies) -> None:
        self._reference, self._bodies = weakref.ref(integrator), bodies

    @property
    def mark(self) -> float:
        """The first number of an integrator that holds a state in this storage."""
        return written(own_numbers(self._integrator))

    @property
    def _integrator(self) -> Any:
        return self._reference()

    def write(self, state: State, which: str = SHOWN) -> None:
        """Write the double-doubles of a state."""
        (R, P, q, m), bodies = state, self._bodies
        first, turning = bodies.first_particle, bodies.first_particle[: bodies.n_turning]
        full = np.zeros((2, 5, bodies.n_particles, 3))
        full[:, 0, first], full[:, 1, first] = R.swapaxes(1, 2), P.swapaxes(1, 2)
        full[:, 2, turning], full[:, 3, turning] = m.swapaxes(1, 2), q[:, 1:].swapaxes(1, 2)
        full[:, 4, turning, 0] = q[:, 0]
        for name, values in zip(_VECTORS, full.reshape(-1, bodies.n_particles, 3), strict=True):
            self._integrator.setPerDofVariableByName(PREFIX + which + name, values)

    def read(self, which: str = SHOWN) -> State | None:
        """Return the double-doubles of a state, or None if there are none."""
        if not self._has(which + _VECTORS[-1]):
            return None
        first, k = self._bodies.first_particle, self._bodies.n_turning
        columns = [self._values(which + name).T for name in _VECTORS]
        R, P, m, vector, w = np.array(columns).reshape(2, 5, 3, len(first)).swapaxes(0, 1)
        q = np.concatenate([w[:, :1, :k], vector[:, :, :k]], axis=1)
        return State(*map(np.ascontiguousarray, (R, P, q, m[:, :, :k])))

    def write_forces(self, memory: Sequence[Force]) -> None:
        """Write forces (3, N) and torques (3, K)."""
        for k, values in enumerate(memory):
            for name, value in zip(_last(k), values, strict=True):
                full = np.zeros((self._bodies.n_particles, 3))
                full[self._bodies.first_particle[: value.shape[1]]] = value.T
                self._integrator.setPerDofVariableByName(PREFIX + name, full)

    def read_forces(self, count: int) -> list[Force] | None:
        """Return `count` forces and torques that `write_forces` wrote, or None if another scheme wrote them."""
        if count and not self._has(_last(count - 1)[1]):
            return None
        pairs = ([self._values(name).T for name in _last(k)] for k in range(count))
        k = self._bodies.n_turning
        return [(np.ascontiguousarray(force), np.ascontiguousarray(torque[:, :k])) for force, torque in pairs]

    def forces_changed(self) -> bool | None:
        """Return None: OpenMM informs only an integrator's C++ part of changed parameters."""
        return None

    def _values(self, name: str) -> Array:
        values = np.array(self._integrator.getPerDofVariableByName(PREFIX + name), dtype=np.float64)
        return values[self._bodies.first_particle]

    def _has(self, name: str) -> bool:
        """Return whether the integrator has a per-DOF variable with this name."""
        integrator = self._integrator
        return PREFIX + name in map(integrator.getPerDofVariableName, range(integrator.getNumPerDofVariables()))


def read(integrator: openmm.CustomIntegrator, storage: Storage, which: str = SHOWN) -> State | None:
    """Return the double-doubles of a state, or None if no state was written.

    A ValueError is raised if the state is in the other storage of the host, whose values are not there.
    """
    if not marked(integrator):
        return None
    of_library = by_library(own := own_numbers(integrator))
    if {get(integrator, _STORED), storage.mark} == {written(own), of_library}:
        raise ValueError(OTHER_STORAGE.format(*("without", "with")[:: 1 if storage.mark == of_library else -1]))
    state = storage.read(which)
    if state is None or not state.q[0].any(axis=0).all():  # `reinitialize` keeps numbers, but not vectors
        return None
    return state


def write_forces(integrator: openmm.CustomIntegrator, storage: Storage, memory: Remembered) -> None:
    """Write the stored forces, and how many there are."""
    storage.write_forces([*memory[0], *memory[1]])
    put(integrator, REMEMBERED, len(memory[0]))
    put(integrator, DIFFERENCES, len(memory[1]))


def read_forces(integrator: openmm.CustomIntegrator, storage: Storage) -> Remembered:
    """Read the forces that `write_forces` wrote; empty lists if another scheme wrote them."""
    n, differences = int(get(integrator, REMEMBERED)), int(get(integrator, DIFFERENCES))
    memory = storage.read_forces(n + differences) or []
    return memory[:n], memory[n:]


def _last(k: int) -> tuple[str, str]:
    return f"last{k}_F", f"last{k}_N"
