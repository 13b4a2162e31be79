"""The result of tuning: all measurements, and the recommended settings."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import openmm

from openmm_exactrb.errors import UnreachableError
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.schemes import CATALOGUE, Scheme
from openmm_exactrb.support.checks import positive
from openmm_exactrb.tuning.benchmark import NESTED, VERLET, Method
from openmm_exactrb.tuning.measurements import Point, cost_at, stable_curve, step_at


@dataclass(frozen=True)
class Choice:
    """A scheme and a step, with their error and cost."""

    #: Name of a scheme, followed by " nested" if bonded forces are nested, or "VerletIntegrator".
    method: str
    #: Step size in ps.
    step: float
    #: Promised standard deviation of the total energy over the horizon, in kJ/mol per body.
    error: float
    #: Wall time in s per ps.
    cost: float
    #: Whether this setting itself was run over the horizon; otherwise the setting follows from the survey.
    confirmed: bool
    #: The argument `bodies` of the integrator.
    bodies: list[list[int]] | None = None
    #: The scheme of the method if it is not in `SCHEMES`.
    scheme: Scheme | None = None
    #: Bit mask of the active force groups.
    groups: int = -1
    #: Force evaluations per ps of `Simulation.step`, if reports are at least ten steps apart.
    evaluations: float = math.nan

    def integrator(self) -> openmm.Integrator:
        """Return a new integrator with this scheme and step."""
        if self.method == VERLET:
            integrator = openmm.VerletIntegrator(self.step)
        else:
            integrator = ExactRigidBodyIntegrator(self.step, bodies=self.bodies, **self.options())
        integrator.setIntegrationForceGroups(self.groups)
        return integrator

    def options(self) -> dict[str, Any]:
        """Return the arguments `scheme` and `fast` of an integrator of this package with this setting."""
        nested = self.method.endswith(NESTED)
        return {"scheme": self.scheme or self.method.removesuffix(NESTED), "fast": "bonded" if nested else None}

    def __str__(self) -> str:
        unsure = "" if self.confirmed else ", by the survey alone"
        return (
            f"{self.method} with a step of {1e3 * self.step:.4g} fs: error {self.error:.1e} kJ/mol per body{unsure}, "
            f"{self.evaluations:.4g} force evaluations and {self.cost:.3g} s per ps ({86.4 / self.cost:.3g} ns per day)"
        )


@dataclass(frozen=True)
class Tuning:
    """The measured points of all methods, and the recommended setting."""

    points: tuple[Point, ...]
    #: The measured methods, by name.
    methods: Mapping[str, Method]
    n_bodies: int
    platform: str
    #: Length of a survey run in ps.
    duration: float
    #: Length in ps of the production runs for which errors are promised.
    horizon: float
    #: Target of the error in kJ/mol per body.
    target: float | None = None
    #: The cheapest setting that meets the target.
    chosen: Choice | None = None
    #: Error due to the noise of the forces, in kJ/mol per body, which smaller steps do not reduce.
    floor: float | None = None
    #: Settings of the System that may cause this noise.
    causes: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    bodies: list[list[int]] | None = field(default=None, repr=False)
    #: Bit mask of the active force groups.
    groups: int = -1

    def best(self, target: float | None = None, method: str | None = None) -> Choice:
        """Return the cheapest scheme and step size for a given energy error.

        Parameters
        ----------
        target : float, optional
            Standard deviation of the total energy in kJ/mol per body within the horizon. By default, the target of
            `tune`, for which runs over the horizon confirmed the setting. For other targets, the setting is
            interpolated between points of the survey.
        method : str, optional
            A scheme, or "VerletIntegrator"; by default all schemes.

        Raises
        ------
        UnreachableError
            If no measured setting reaches the target; the message states the smallest error found.
        ValueError
            If the method was not measured, or the target is not positive or missing.
        """
        target = self.target if target is None else positive(target, "target", "kJ/mol per body")
        if target is None:
            raise ValueError("best() needs a target, because tune() was called without target=: pass target= to best()")
        found = self.chosen if target == self.target and method is None else self.surveyed(target, method)
        if found is None:
            raise UnreachableError(self._why_unreachable(target, method))
        return found

    def largest_stable_step(self, method: str) -> float:
        """Return the largest step (ps) at which the energy error of a scheme is below a tenth of the kinetic energy.

        The next longer step, at most 42 % longer, was unstable, or was not tried because it exceeds the first step of
        the search, at which free bodies turn by at most a radian between two force evaluations.

        Raises
        ------
        ValueError
            If the method was not measured, or none of its steps was stable.
        """
        (name,) = self._methods(method)
        if math.isnan(step := self._largest_stable(name)):
            raise UnreachableError(f"{name} is not stable at any step that was tried: choose another method")
        return step

    def curve(self, method: str) -> list[Point]:
        """Return the stable points of a method, cheapest first, without those that a longer run contradicted."""
        return stable_curve(self.points, method)

    def choice(self, point: Point, confirmed: bool = True) -> Choice:
        """Return the setting of a point; `confirmed` states whether this setting was run over the horizon."""
        method = self.methods[point.method]
        own = None if method.scheme in CATALOGUE.values() else method.scheme
        evaluations = method.evaluations / point.step
        setting = point.method, point.step, point.error, point.cost, confirmed
        return Choice(*setting, self.bodies, own, self.groups, evaluations)

    def surveyed(self, target: float, method: str | None = None) -> Choice | None:
        """Return the cheapest setting of a method or of all schemes in the survey; None if all miss the target."""
        found = []
        for name in self._methods(method):
            curve = self.curve(name)
            if (cost := cost_at(curve, target)) is not None:
                error = min(curve[0].error, target)  # the error of the largest stable step may be below the target
                found.append(Point(name, step_at(curve, cost), error, cost, self.duration))
        cheapest = min(found, key=lambda point: point.cost, default=None)
        return None if cheapest is None else self.choice(cheapest, confirmed=False)

    def _methods(self, method: str | None) -> list[str]:
        """Return one method, which must have been measured, or all schemes."""
        if method is None:
            return [name for name in self.methods if name != VERLET]
        if method not in self.methods:
            raise ValueError(f"the method {method!r} was not measured: choose one of {', '.join(self.methods)}")
        return [method]

    def _largest_stable(self, method: str) -> float:
        own = [p for p in self.points if p.method == method]
        limit = min((p.step for p in own if math.isinf(p.error)), default=math.inf)
        return max((p.step for p in own if p.step < limit), default=math.nan)

    def _why_unreachable(self, target: float, method: str | None = None) -> str:
        points = [p for name in self._methods(method) for p in self.curve(name)]
        if not points and self.floor is not None:
            return f"an error of {target:.3g} kJ/mol per body is out of reach. {self._about_floor()}"
        if not self.points:
            return "the budget was spent before a run ended: use a larger budget"
        if not points:
            return "no run was stable: equilibrate the start, pass a larger budget, or use energy-conserving forces"
        least, why = min(points, key=lambda p: p.error), "not reached: the smallest found is"
        failed = [p for p in points if p.duration >= self.horizon and p.error > target]
        if least.error <= target and failed:
            least = min(failed, key=lambda p: p.error)
            why = f"not held: the smallest in runs of {self.horizon:.3g} ps was"
        elif least.error <= target:  # but not by the margin that an unconfirmed setting needs
            why = "not confirmed within the budget: the smallest that the survey found is"
        text = (
            f"an error of {target:.3g} kJ/mol per body was {why} {least.error:.2g}, with {least.method} and a step of "
        )
        text = f"{text}{1e3 * least.step:.3g} fs"
        if self.floor is not None:
            return f"{text}. {self._about_floor()}"
        return text + (f". The forces may limit it: {'; '.join(self.causes)}" if self.causes else "")

    def __str__(self) -> str:
        head = (
            f"{self.n_bodies} bodies on {self.platform}. Error: standard deviation of the total energy in kJ/mol per "
            f"body, within {self.horizon:.3g} ps\n"
            f"(extrapolated from {self.duration:.3g} ps). Cost: wall time in s per ps."
        )
        kinds = ([name for name, method in self.methods.items() if method.nested == nested] for nested in (False, True))
        tables = ["\n".join(self._table(methods)) + "\n" for methods in kinds if methods and self.points]
        return "\n".join([f"{head}\n", *tables, *(textwrap.fill(line, 120) for line in self._conclusions())])

    def _table(self, methods: list[str]) -> Iterable[str]:
        """Yield the rows of a table of errors: a row for each time per force evaluation, a column for each method."""
        cells: dict[tuple[float, str], str] = {}
        for p in self.points:
            if p.method in methods:
                interval = float(f"{1e3 * p.step / self.methods[p.method].stages:.4g}")
                cells[interval, p.method] = "unstable" if math.isinf(p.error) else f"{p.error:.1e}{self._star(p)}"
        rows = [
            ["fs per evaluation", *methods],
            *(
                [f"{interval:g}", *(cells.get((interval, method), "") for method in methods)]
                for interval in sorted({interval for interval, _ in cells}, reverse=True)
            ),
            ["largest step, fs", *(f"{1e3 * self._largest_stable(method):.4g}" for method in methods)],
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return ("  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows)

    def _star(self, point: Point) -> str:
        return "*" * (point.duration >= self.horizon)

    def _conclusions(self) -> Iterable[str]:
        if any(map(self._star, self.points)):
            yield "*: run over the whole horizon, up to the first start that misses the target."
        if self.floor is not None and (self.target is None or self.chosen is not None):
            yield self._about_floor()
        if self.target is not None:
            yield f"target {self.target:.3g}: {self.chosen or self._why_unreachable(self.target)}"
        yield from (f"note: {note}" for note in self.notes)

    def _about_floor(self) -> str:
        known = "; ".join(self.causes) or "single precision; use the Reference platform or double precision"
        return (
            f"Below {self.floor:.1e} kJ/mol per body smaller steps do not lower the error: the rest comes from the "
            f"forces, not from the scheme ({known}). See the documentation: Why is my energy error not smaller?"
        )
