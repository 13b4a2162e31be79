"""What was measured, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import openmm

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.tuning.curves import Point, stable, stable_curve, step_at
from openmm_exactrb.tuning.movers import VERLET, options_of


@dataclass(frozen=True)
class Choice:
    """A scheme and a step.

    Attributes
    ----------
    method : str
        The name of a scheme, with " nested" behind it where bonded forces are nested, or "VerletIntegrator".
    step : float
        Size of a whole step in ps.
    error : float
        Standard deviation of the total energy in kJ/mol per body to expect over the horizon.
    cost : float
        Wall time in s per ps.
    confirmed : bool
        Whether this very setting was run; else it lies between two that were.
    bodies : list of lists of int, optional
        For the integrator.
    scheme : Scheme, optional
        That of the method, where it is not of the catalogue.
    groups : int
        Bits of the force groups that act.
    """

    method: str
    step: float
    error: float
    cost: float
    confirmed: bool
    bodies: list[list[int]] | None = None
    scheme: Scheme | None = None
    groups: int = -1

    def integrator(self) -> openmm.Integrator:
        """Return a new integrator with this scheme and step."""
        if self.method == VERLET:
            integrator = openmm.VerletIntegrator(self.step)
        else:
            integrator = ExactRigidBodyIntegrator(self.step, bodies=self.bodies, **self.options())
        integrator.setIntegrationForceGroups(self.groups)
        return integrator

    def options(self) -> dict[str, Any]:
        """Return the arguments `scheme` and `fast` that an integrator of this package has with this setting."""
        return options_of(self.method, self.scheme)

    def __str__(self) -> str:
        return (
            f"{self.method} with a step of {1e3 * self.step:.4g} fs: error {self.error:.1e} kJ/mol per body, "
            f"{self.cost:.3g} s per ps ({86.4 / self.cost:.3g} ns per day)"
        )


@dataclass(frozen=True)
class Record:
    """What was measured.

    Attributes
    ----------
    points : tuple of Point
    seconds : mapping
        Wall time of a force evaluation in s by method; with that of the nested ones about it, at a short step.
    stages : mapping
        Force evaluations per step by method, without those of nested forces.
    n_bodies : int
    platform : str
    duration, horizon : float
        Length in ps of the runs of the survey, and of the runs for which errors are promised.
    target : float, optional
        In kJ/mol per body.
    chosen : Choice, optional
        For the target, where it was reached.
    floor : float, optional
        The error below which smaller steps do not bring it, in kJ/mol per body.
    notes : tuple of str
    bodies : list of lists of int, optional
    schemes : mapping
        Those that are not of the catalogue, by method.
    groups : int
        Bits of the force groups that act.
    """

    points: tuple[Point, ...]
    seconds: Mapping[str, float]
    stages: Mapping[str, int]
    n_bodies: int
    platform: str
    duration: float
    horizon: float
    target: float | None = None
    chosen: Choice | None = None
    floor: float | None = None
    notes: tuple[str, ...] = ()
    bodies: list[list[int]] | None = field(default=None, repr=False)
    schemes: Mapping[str, Scheme] = field(default_factory=dict, repr=False)
    groups: int = -1

    def methods(self, method: str | None = None) -> list[str]:
        """Return one method, if it was measured, or all schemes.

        Raises
        ------
        ValueError
            If the method was not measured.
        """
        if method is None:
            return [name for name in self.seconds if name != VERLET]
        if method not in self.seconds:
            raise ValueError(f"{method!r} was not measured: choose one of {', '.join(self.seconds)}")
        return [method]

    def largest_stable(self, method: str) -> float | None:
        """Return the largest step in ps of a method that was stable; None if none was."""
        return max((p.step for p in stable([p for p in self.points if p.method == method])), default=None)

    def curve(self, method: str) -> list[Point]:
        """Return the points of a method beyond its last unstable one that no longer run refutes, cheapest first."""
        return stable_curve([p for p in self.points if p.method == method])

    def interval(self, point: Point) -> float:
        """Return the time a force evaluation in ps, equal for points of one level."""
        return float(f"{point.step / self.stages[point.method]:.6g}")

    def choice(self, method: str, cost: float, error: float, measured: bool) -> Choice:
        """Return the setting of a method that has a cost."""
        step = step_at(self.curve(method), cost)
        return Choice(method, step, error, cost, measured, self.bodies, self.schemes.get(method), self.groups)
