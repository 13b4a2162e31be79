"""What moves a system: a scheme of ours, or OpenMM's Verlet integrator, which is the baseline."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import openmm

from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.fit import fit
from openmm_exactrb.schemes import Scheme
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


def integrator_of(name: str, step: float, bodies: Sequence[Sequence[int]] | None) -> openmm.Integrator:
    """Return a new integrator for the name of a method, with a step in ps."""
    if name == VERLET:
        return openmm.VerletIntegrator(step)
    return ExactRigidBodyIntegrator(step, bodies=bodies, **options_of(name))


def options_of(name: str) -> dict[str, Any]:
    """Return scheme and nested forces of one of our integrators for the name of a method."""
    return {"scheme": name.removesuffix(_NESTED), "fast": "bonded" if is_nested(name) else None}


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
        """Make steps."""

    def energy(self) -> float:
        """Return the total energy at a full step in kJ/mol."""

    def seconds_per_evaluation(self, steps: int) -> float:
        """Make steps, and return the wall time that a force evaluation took."""


class Ours:
    """A scheme with the exact rotor."""

    def __init__(self, start: Start, method: Scheme | NestedScheme) -> None:
        scheme, fast = (method.scheme, "bonded") if isinstance(method, NestedScheme) else (method, None)
        self._start, self.stages = start, scheme.forces
        self._integrator = ExactRigidBodyIntegrator(1e-6, scheme=scheme, bodies=start.bodies, fast=fast, engine="host")
        self._context = start.context(self._integrator)

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
        self._integrator.step(steps)

    def energy(self) -> float:
        """Return the total energy in kJ/mol."""
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
        forces = self._context.getState(forces=True).getForces(asNumpy=True)._value
        self._context.setVelocities(self._start.velocities - 0.5 * h * forces * self._inverse_masses)
        self._context.applyVelocityConstraints(1e-10)

    def move(self, steps: int) -> None:
        """Make steps."""
        self._integrator.step(steps)

    def energy(self) -> float:
        """Return the total energy at a full step in kJ/mol.

        Forces move the velocities on by half a step. Constraint forces within a rigid body change neither its momentum
        nor its angular momentum, so that these give the kinetic energy exactly.
        """
        state = self._context.getState(positions=True, velocities=True, forces=True, energy=True)
        forces = state.getForces(asNumpy=True)._value
        v = state.getVelocities(asNumpy=True)._value + 0.5 * self._h * forces * self._inverse_masses
        fitted = fit(self._bodies, state.getPositions(asNumpy=True)._value, v)
        return float(state.getPotentialEnergy()._value + sum(self._bodies.kinetic_energies(fitted)))

    def seconds_per_evaluation(self, steps: int) -> float:
        """Make steps, and return the wall time that a force evaluation took."""
        begun = time.perf_counter()
        self._integrator.step(steps)
        self._context.getState(positions=True)  # waits for platforms that work in the background
        return (time.perf_counter() - begun) / steps
