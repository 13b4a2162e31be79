"""Measured points of methods, and the curves of error against cost through them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from openmm_exactrb.errors import BudgetSpentError
from openmm_exactrb.tuning.benchmark import STARTS, VERLET, Benchmark, Method, RunEnergies
from openmm_exactrb.tuning.error import expected_error

Report = Callable[[str], None]

# The error from another start may equal the error at a step that is longer by this factor. Where the curve is steeper
# than the order of the method, that error exceeds the errors of the starts that were run.
_LONGER = 1.05
#: Factor for errors that are measured in fewer runs than a promised error requires.
UNSURE = 1.5


@dataclass(frozen=True)
class Point:
    """A method with a step, run from one or several initial states."""

    #: Name of a scheme, followed by " nested" if bonded forces are nested, or "VerletIntegrator".
    method: str
    #: Step size in ps.
    step: float
    #: Expected standard deviation over the horizon in kJ/mol per body; infinite if a run failed or was unstable.
    error: float
    #: Wall time in s per ps.
    cost: float
    #: Length of a run in ps.
    duration: float


def stable_curve(points: Sequence[Point], method: str) -> list[Point]:
    """Return the points of a method with steps below its smallest unstable step, cheapest first.

    A point is omitted if a longer run with the same or a smaller step has a larger error.
    """
    own = [p for p in points if p.method == method]
    limit = min((p.step for p in own if math.isinf(p.error)), default=math.inf)
    below = [p for p in own if p.step < limit]
    return sorted((p for p in below if not any(_contradicts(q, p) for q in below)), key=lambda p: p.cost)


def _contradicts(longer: Point, point: Point) -> bool:
    return longer.duration > point.duration and longer.step <= point.step and longer.error > point.error


def cost_at(curve: Sequence[Point], error: float) -> float | None:
    """Return the cost at which a curve, log-linear between points, reaches an error, or None if it does not."""
    i = next((i for i, point in enumerate(curve) if point.error <= error), None)
    if not i:
        return None if i is None else curve[0].cost
    a, b = curve[i - 1], curve[i]
    part = math.log(a.error / error) / math.log(a.error / b.error) if b.error < a.error else 1.0
    return math.exp(math.log(a.cost) + min(max(part, 0.0), 1.0) * math.log(b.cost / a.cost))


def step_at(curve: Sequence[Point], cost: float) -> float:
    """Return the step with a given cost, assuming that a force evaluation takes as long as at the nearest point."""
    nearest = min(curve, key=lambda p: abs(math.log(p.cost / cost)))
    return nearest.step * (nearest.cost / cost)


class Measurements:
    """Points of methods, which are measured on request and stored.

    The baseline is added to the methods if it moves the same bodies. Survey runs last `duration` and production runs
    `horizon`, in ps. `report` receives a line of text per point.
    """

    def __init__(
        self, benchmark: Benchmark, methods: Sequence[Method], duration: float, horizon: float, report: Report
    ) -> None:
        self.benchmark, self.duration, self.horizon, self._report = benchmark, duration, horizon, report
        self.methods = {method.name: method for method in (*methods, *[Method()] * benchmark.has_baseline)}
        #: Whether the budget ended a search, or the runs for a promised error.
        self.cut = False
        self._points: list[Point] = []
        # By method and step: wall time in s of a force evaluation and its nested evaluations, and the number of the
        # latter.
        self._taken: dict[tuple[str, float], tuple[float, float]] = {}

    @property
    def points(self) -> list[Point]:
        """All points, with the costs measured so far."""
        return [replace(p, cost=self._cost(p)) for p in self._points]

    def at(self, name: str, interval: float) -> Point:
        """Return the survey point of a method at a given interval between force evaluations in ps."""
        method = self.methods[name]
        step = method.stages * interval
        run = self._run(method, step, self.duration, 0)
        error = math.inf if run is None else expected_error(run.values, run.interval, self.horizon)
        return self._kept(Point(name, step, error, math.nan, self.duration))

    def promised(self, name: str, step: float, target: float) -> Point:
        """Return the point of production runs, with their largest error and a margin where the curve is steep.

        The runs end with the first one that misses the target. If the budget ends the runs earlier, the error is
        increased by a margin for the missing runs.
        """
        steeper = max(self.slope(name, step) - self.methods[name].order, 0.0)
        errors, margin = [0.0], _LONGER**steeper
        try:
            for k in range(STARTS):
                run = self._run(self.methods[name], step, self.horizon, k)
                errors.append(math.inf if run is None else float(np.std(run.values)))
                if errors[-1] * margin > target:
                    break
        except BudgetSpentError:
            if len(errors) == 1:
                raise
            margin, self.cut = margin * UNSURE, True
        starts = f" over {self.horizon:.3g} ps from {len(errors) - 1} of {STARTS} starts"
        return self._kept(Point(name, step, max(errors) * margin, math.nan, self.horizon), starts)

    def _run(self, method: Method, step: float, duration: float, start: int) -> RunEnergies | None:
        state = self.benchmark.starts[start] if start else self.benchmark.state
        run = self.benchmark.run(method, step, duration, state)
        if run is not None:
            before = self._taken.get((method.name, step), (math.inf, 0.0))
            self._taken[method.name, step] = min(run.seconds, before[0]), run.nested
        return run

    def _kept(self, point: Point, starts: str = "") -> Point:
        self._points.append(point)
        shown = "unstable" if math.isinf(point.error) else f"{point.error:.1e} kJ/mol per body"
        interval = 1e3 * point.step / self.methods[point.method].stages
        self._report(f"{point.method}, {interval:.3g} fs per evaluation{starts}: {shown}")
        return replace(point, cost=self._cost(point))

    def _cost(self, point: Point) -> float:
        if (point.method, point.step) not in self._taken:
            return math.nan
        return self._seconds(point.method, point.step) * self.methods[point.method].evaluations / point.step

    def _seconds(self, name: str, step: float) -> float:
        """Return the wall time of a force evaluation and its inner steps, assumed to be equal in all schemes.

        The minimum over all runs is used, because any excess is due to other processes on the machine.
        """
        own = [seconds for (other, _), (seconds, _) in self._taken.items() if other == name]
        if name == VERLET:
            return min(own)
        runs = [taken for (other, _), taken in self._taken.items() if other != VERLET]
        plain = min((seconds for seconds, nested in runs if not nested), default=min(own))
        nested = min(((seconds - plain) / count for seconds, count in runs if count), default=0.0)
        return plain + self._taken[name, step][1] * max(nested, 0.0)

    def schemes(self) -> list[str]:
        """Return the schemes that were stable at some step."""
        return [name for name in self.methods if name != VERLET and self.curve(name)]

    def curve(self, name: str) -> list[Point]:
        """Return the stable points of a method, cheapest first, without those that a longer run contradicts."""
        return stable_curve(self.points, name)

    def slope(self, name: str, step: float) -> float:
        """Return the exponent with which the error of the survey depends on the step around a given step.

        The exponent is computed from the nearest step on each side; with a single step it is the order of the method.
        """
        curve = [p for p in self.curve(name) if p.duration == self.duration]
        if len(curve) < 2:
            return float(self.methods[name].order)
        after = next((i for i, p in enumerate(curve) if p.step <= step), len(curve) - 1)
        a, b = curve[max(after, 1) - 1], curve[max(after, 1)]
        return math.log(a.error / b.error) / math.log(a.step / b.step)
