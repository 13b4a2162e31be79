"""Measured points of methods, and the curves of error against cost through them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from openmm_exactrb.tuning.benchmark import VERLET, Benchmark, Method

Report = Callable[[str], None]

# A force evaluation with its drift and kick is the same work in all schemes: times above the least one times this are
# noise.
_SAME_WORK = 1.15


@dataclass(frozen=True)
class Point:
    """One measured run."""

    #: Name of a scheme, followed by " nested" if bonded forces are nested, or "VerletIntegrator".
    method: str
    #: Step of the whole scheme in ps.
    step: float
    #: Standard deviation in kJ/mol per body to expect over the horizon; infinite if the run was unstable.
    error: float
    #: Wall time in s per ps.
    cost: float
    #: Length of the run in ps.
    duration: float


def stable_points(points: Sequence[Point], method: str) -> list[Point]:
    """Return the points of a method with steps below its smallest unstable one."""
    own = [p for p in points if p.method == method]
    limit = min((p.step for p in own if math.isinf(p.error)), default=math.inf)
    return [p for p in own if p.step < limit]


def stable_curve(points: Sequence[Point], method: str) -> list[Point]:
    """Return the stable points of a method that no longer run contradicts, cheapest first.

    A longer run with no larger step but a larger error contradicts a point: the shorter run did not show that error.
    """
    below = stable_points(points, method)
    return sorted((p for p in below if not any(_contradicts(q, p) for q in below)), key=lambda p: p.cost)


def _contradicts(longer: Point, point: Point) -> bool:
    return longer.duration > point.duration and longer.step <= point.step and longer.error > point.error


def cost_at(curve: Sequence[Point], error: float) -> float | None:
    """Return the cost at which a curve reaches an error, log-linear between points; None if it does not reach it."""
    i = next((i for i, point in enumerate(curve) if point.error <= error), None)
    if not i:
        return None if i is None else curve[0].cost
    a, b = curve[i - 1], curve[i]
    part = math.log(a.error / error) / math.log(a.error / b.error) if b.error < a.error else 1.0
    return math.exp(math.log(a.cost) + min(max(part, 0.0), 1.0) * math.log(b.cost / a.cost))


def step_at(curve: Sequence[Point], cost: float) -> float:
    """Return the step with a cost, if a force evaluation takes as long as at the nearest point."""
    nearest = min(curve, key=lambda p: abs(math.log(p.cost / cost)))
    return nearest.step * (nearest.cost / cost)


class Measurements:
    """Points of methods, each run on request and kept.

    The baseline is added to the methods if it moves the same bodies. Survey runs take `duration`, production runs the
    `horizon`, in ps. `report` gets a line of text per run.
    """

    def __init__(
        self, benchmark: Benchmark, methods: Sequence[Method], duration: float, horizon: float, report: Report
    ) -> None:
        self.benchmark, self.duration, self.horizon, self._report = benchmark, duration, horizon, report
        self.methods = {method.name: method for method in (*methods, *[Method()] * benchmark.has_baseline)}
        self.stages = {name: method.stages for name, method in self.methods.items()}
        #: Wall time of a force evaluation in s by method, measured by `time`.
        self.seconds: dict[str, float] = {}
        #: Force evaluations of a step by method, as `Simulation.step` calls it in the whole System; set by `time`.
        self.evaluations: dict[str, float] = {}
        self.points: list[Point] = []
        self._shares: dict[tuple[str, float], float] = {}  # nested evaluations per other evaluation, at a step
        self._plain_seconds = self._nested_seconds = math.nan  # per force evaluation, and per nested one

    def at(self, name: str, interval: float, duration: float | None = None) -> Point:
        """Return the point of a method at a time per force evaluation in ps; it is run if no run was as long."""
        method, step = self.methods[name], self.stages[name] * interval
        duration = self.duration if duration is None else duration
        for known in self.points:
            if known.method == name and math.isclose(known.step, step, rel_tol=1e-9):
                if known.duration >= duration or math.isinf(known.error):
                    return known
                self.points.remove(known)
                break
        error = self.benchmark.error(method, step, duration, self.horizon)
        self._shares[name, step] = self.benchmark.under_test(method).fast_share
        point = self._with_cost(Point(name, step, error, math.nan, duration))
        self.points.append(point)
        shown = "unstable" if math.isinf(error) else f"{error:.1e} kJ/mol per body"
        self._report(f"{name}, {1e3 * interval:.3g} fs per evaluation: {shown}")
        return point

    def time(self, interval: float) -> None:
        """Measure the wall time of all methods at a time per force evaluation in ps, and set the costs of the points.

        The time of a nested evaluation is the least that the excess over plain schemes allows.
        """
        times = self.benchmark.seconds_per_evaluation(list(self.methods.values()), interval)
        self.seconds = dict(zip(self.methods, times, strict=True))
        nested = [name for name, method in self.methods.items() if method.nested]
        plain = [name for name in self.methods if name != VERLET and name not in nested]
        least = min(self.seconds[name] for name in plain)
        for name in plain:
            self.seconds[name] = min(self.seconds[name], _SAME_WORK * least)
        shares = {name: self.benchmark.under_test(self.methods[name]).fast_share for name in nested}
        excess = [max(0.0, self.seconds[name] - least) / shares[name] for name in nested]
        self._plain_seconds, self._nested_seconds = least, min(excess, default=0.0)
        for name in nested:
            self.seconds[name] = least + shares[name] * self._nested_seconds
        self.evaluations = {
            name: self.benchmark.under_test(method).evaluations_per_step(method.stages * interval)
            for name, method in self.methods.items()
        }
        self.points = [self._with_cost(p) for p in self.points]

    def _with_cost(self, point: Point) -> Point:
        """Return a point with the cost of its force evaluations, nested ones included."""
        seconds = self.seconds.get(point.method, math.nan)
        if self.methods[point.method].nested:
            seconds = self._plain_seconds + self._shares[point.method, point.step] * self._nested_seconds
        return replace(point, cost=seconds * self.evaluations.get(point.method, math.nan) / point.step)

    def schemes(self) -> list[str]:
        """Return the schemes that were stable at some step."""
        return [name for name in self.methods if name != VERLET and self.curve(name)]

    def curve(self, name: str) -> list[Point]:
        """Return the stable points of a method that no longer run contradicts, cheapest first."""
        return stable_curve(self.points, name)

    def slope(self, name: str) -> float:
        """Return the power by which the error falls with the cost at the finest points; the order, of one point."""
        curve = self.curve(name)
        if len(curve) < 2:
            return float(self.methods[name].order)
        a, b = curve[-2:]
        return math.log(a.error / b.error) / math.log(b.cost / a.cost)

    def is_flat(self, name: str) -> bool:
        """Return whether the survey's error stopped falling: by less than a third of the order, over two step sizes."""
        curve = [p for p in self.curve(name) if p.duration == self.duration]
        if len(curve) < 3:
            return False
        a, b = curve[-3], curve[-1]
        return math.log(a.error / b.error) < self.methods[name].order / 3.0 * math.log(b.cost / a.cost)

    def holds(self, name: str, target: float) -> bool:
        """Return whether the finest point of a method meets the target and no longer run of it misses it."""
        curve = self.curve(name)
        failed = any(p.error > target and p.duration > self.duration for p in curve)
        return bool(curve) and curve[-1].error <= target and not failed
