"""What moves a system: a scheme of ours, or OpenMM's Verlet integrator, which is the baseline."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import openmm

from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.fit import fit
from openmm_exactrb.motion.guard import NonFiniteError
from openmm_exactrb.schemes import CATALOGUE, Scheme
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.tuning.start import Start

#: The baseline: OpenMM's own leapfrog with constraints.
VERLET = "VerletIntegrator"
_NESTED = " nested"


@dataclass(frozen=True)
class NestedScheme:
    """A scheme with the bonded forces within its drifts."""

    scheme: Scheme

    @property
    def name(self) -> str:
        """What it is called among the methods."""
        return self.scheme.name + _NESTED

    @property
    def order(self) -> int:
        """Order in the step size."""
        return self.scheme.order


#: What is measured: a scheme, plain or nested, or `VERLET`.
Method = str | Scheme | NestedScheme


def is_nested(name: str) -> bool:
    """Tell whether the name of a method is that of a nested scheme."""
    return name.endswith(_NESTED)


def schemes_of(names: str | Scheme | Sequence[str | Scheme]) -> list[Scheme]:
    """Return the schemes that a user names, each once.

    Raises
    ------
    ValueError
        If there are none, one is unknown, or one of the user's own has the name of another method.
    """
    schemes = [look_up(name) for name in ([names] if isinstance(names, (str, Scheme)) else names)]
    if not schemes:
        raise ValueError(f"schemes is empty: name some of {', '.join(CATALOGUE)}")
    known: dict[str, Scheme] = {}
    for scheme in schemes:
        name = scheme.name
        if is_nested(name) or name == VERLET or known.setdefault(name, _by_name(name) or scheme) != scheme:
            raise ValueError(f"a scheme of your own has the name {name!r} of another method: give it one of its own")
    return list(known.values())


def own_scheme(method: Method) -> Scheme | None:
    """Return the scheme of a method, unless its name tells it."""
    scheme = method.scheme if isinstance(method, NestedScheme) else method
    return scheme if isinstance(scheme, Scheme) and _by_name(scheme.name) != scheme else None


def _by_name(name: str) -> Scheme | None:
    try:
        return look_up(name)
    except ValueError:
        return None


def options_of(name: str, own: Scheme | None = None) -> dict[str, Any]:
    """Return scheme and nested forces of one of our integrators for the name of a method, or for a scheme of a user."""
    return {"scheme": own or name.removesuffix(_NESTED), "fast": "bonded" if is_nested(name) else None}


@contextmanager
def blow_ups() -> Iterator[None]:
    """Raise NonFiniteError where OpenMM says that positions are not finite; its other errors are no blow-ups."""
    try:
        yield
    except openmm.OpenMMException as error:
        if "NaN" not in str(error):
            raise
        raise NonFiniteError(str(error)) from error


class Mover(Protocol):
    """What runs one method: a scheme of ours, or OpenMM's Verlet.

    Attributes
    ----------
    stages : int
        Force evaluations per step, but for those of nested forces.
    fast_share : float
        Evaluations of nested forces for one of the others, since the last `begin`.
    """

    stages: int

    @property
    def fast_share(self) -> float:
        """See above."""

    def begin(self, h: float) -> None:
        """Go back to the start, and take this step size in ps."""

    def move(self, steps: int) -> None:
        """Make steps.

        Raises
        ------
        NonFiniteError
            If they blow up.
        """

    def energy(self) -> float:
        """Return the total energy at a full step in kJ/mol; NonFiniteError if there is none any more."""

    def seconds_per_evaluation(self, steps: int) -> float:
        """Make steps, and return the wall time that a force evaluation took."""


class Ours:
    """A scheme with the exact rotor, on the engine that an integrator without further arguments has there."""

    def __init__(self, start: Start, method: Scheme | NestedScheme) -> None:
        scheme, fast = (method.scheme, "bonded") if isinstance(method, NestedScheme) else (method, None)
        self._start, self.stages = start, scheme.forces
        options: dict[str, Any] = {"scheme": scheme, "bodies": start.bodies, "fast": fast}
        self._integrator = ExactRigidBodyIntegrator(1e-6, **options)
        self._context = start.context(self._integrator)
        if self._integrator.getEngine() == "device":  # by name it keeps its program where the step changes
            self._integrator = ExactRigidBodyIntegrator(1e-6, **options, engine="device")
            own = copy.deepcopy(start.system)  # to which the device adds a force that others need not pay for
            self._context = replace(start, system=own).context(self._integrator)

    @property
    def engine(self) -> str:
        """Who carries the steps out, "host" or "device"."""
        return self._integrator.getEngine()

    @property
    def fast_share(self) -> float:
        """Evaluations of nested forces for one of the others, since the last `begin`."""
        timings = self._integrator.timings
        return timings.fast_evaluations / max(1, timings.evaluations)

    def begin(self, h: float) -> None:
        """Go back to the start, and take this step size in ps."""
        self._integrator.setStepSize(h)
        self._context.setPositions(self._start.positions)
        self._context.setVelocities(self._start.velocities)
        self._integrator.timings.reset()

    def move(self, steps: int) -> None:
        """Make steps."""
        with blow_ups():
            self._integrator.step(steps)

    def energy(self) -> float:
        """Return the total energy in kJ/mol."""
        with blow_ups():
            return float(self._integrator.totalEnergy()._value)

    def seconds_per_evaluation(self, steps: int) -> float:
        """Make steps, and return the wall time that a force evaluation took."""
        self._integrator.timings.reset()
        self._integrator.step(steps)
        return self._integrator.timings.total / self._integrator.timings.evaluations


class Verlet:
    """OpenMM's leapfrog, whose velocities are half a step late."""

    stages = 1
    fast_share = 0.0

    def __init__(self, start: Start) -> None:
        self._start = start
        self._integrator = openmm.VerletIntegrator(1e-6)
        self._integrator.setConstraintTolerance(1e-10)
        self._context = start.context(self._integrator)
        masses = [start.system.getParticleMass(i)._value for i in range(start.system.getNumParticles())]
        self._inverse_masses = np.array([[1.0 / m if m > 0.0 else 0.0] for m in masses])
        self._bodies = find_bodies(start.system, start.positions)
        fitted = fit(self._bodies, start.positions, start.velocities)
        self._x = self._bodies.positions(fitted, start.positions.copy())  # where ours starts too
        self._h = 0.0

    def begin(self, h: float) -> None:
        """Go back to the positions of the start, with the velocities of half a step before it."""
        self._h = h
        self._integrator.setStepSize(h)
        self._context.setPositions(self._x)
        self._context.computeVirtualSites()
        forces = self._state(forces=True).getForces(asNumpy=True)._value
        self._context.setVelocities(self._start.velocities - 0.5 * h * forces * self._inverse_masses)
        self._context.applyVelocityConstraints(1e-10)

    def move(self, steps: int) -> None:
        """Make steps."""
        with blow_ups():
            self._integrator.step(steps)

    def energy(self) -> float:
        """Return the total energy at a full step in kJ/mol.

        Forces move the velocities on by half a step. Constraint forces within a rigid body change neither its momentum
        nor its angular momentum, so that these give the kinetic energy exactly.
        """
        with blow_ups():
            state = self._state(positions=True, velocities=True, forces=True, energy=True)
        forces = state.getForces(asNumpy=True)._value
        v = state.getVelocities(asNumpy=True)._value + 0.5 * self._h * forces * self._inverse_masses
        try:
            fitted = fit(self._bodies, state.getPositions(asNumpy=True)._value, v)
        except ValueError as error:  # not finite, or constraints are no longer met
            raise NonFiniteError(str(error)) from error
        return float(state.getPotentialEnergy()._value + sum(self._bodies.kinetic_energies(fitted)))

    def _state(self, **what: bool) -> openmm.State:
        return self._context.getState(groups=self._start.groups, **what)

    def seconds_per_evaluation(self, steps: int) -> float:
        """Make steps, and return the wall time that a force evaluation took."""
        begun = time.perf_counter()
        self._integrator.step(steps)
        self._context.getState(positions=True)  # waits for platforms that work in the background
        return (time.perf_counter() - begun) / steps
