"""Points of methods, each run when it is asked for and kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from openmm_exactrb.schemes import Scheme
from openmm_exactrb.tuning.bench import Bench
from openmm_exactrb.tuning.curves import Point, is_flat, slope, stable_curve
from openmm_exactrb.tuning.error import LOST
from openmm_exactrb.tuning.movers import VERLET, Method, NestedScheme

# An evaluation is the same work in all schemes, one force, drift and kick: what is further above the fastest is noise.
_SAME_WORK = 1.15


class Measurements:
    """Points of methods, each run when it is asked for and kept.

    Parameters
    ----------
    bench : Bench
    schemes : sequence of Scheme or NestedScheme
        OpenMM's Verlet integrator is measured beside them where it moves the same bodies.
    duration, horizon : float
        Length in ps of a run of the survey, and of those for which errors are promised.
    report : callable
        Gets a line of text for each run.

    Attributes
    ----------
    methods : dict
        Scheme, plain or nested, or `VERLET`, by name.
    stages : dict
        Force evaluations per step by name.
    seconds : dict
        Wall time of a force evaluation in s by name, once `time` was called.
    points : list of Point
    """

    def __init__(
        self,
        bench: Bench,
        schemes: Sequence[Scheme | NestedScheme],
        duration: float,
        horizon: float,
        report: Callable[[str], None],
    ) -> None:
        self.bench, self._report = bench, report
        self.duration, self.horizon = duration, horizon
        self.methods: dict[str, Method] = {s.name: s for s in schemes}
        if bench.has_baseline:
            self.methods[VERLET] = VERLET
        self.stages = {name: bench.mover(method).stages for name, method in self.methods.items()}
        self.seconds: dict[str, float] = {}
        self._shares: dict[tuple[str, float], float] = {}  # nested evaluations for one of the others, at a step
        self._plain_seconds = self._nested_seconds = math.nan  # of a force evaluation, and of a nested one
        self.points: list[Point] = []

    def at(self, name: str, interval: float, duration: float | None = None) -> Point:
        """Return the point of a method at a time a force evaluation in ps, run if it was not yet for as long.

        Parameters
        ----------
        name : str
        interval : float
        duration : float, optional
            Length of the run in ps, that of the survey unless given.
        """
        step, duration = self.stages[name] * interval, self.duration if duration is None else duration
        for known in self.points:
            if known.method == name and math.isclose(known.step, step, rel_tol=1e-9):
                if known.duration >= duration or math.isinf(known.error):
                    return known
                self.points.remove(known)
                break
        error = self.bench.run(self.methods[name], step, duration).error(self.horizon)
        self._shares[name, step] = self.bench.mover(self.methods[name]).fast_share
        error = error if error < LOST * self.bench.scales.kinetic else math.inf
        point = self._priced(Point(name, step, error, math.nan, duration))
        self.points.append(point)
        shown = "unstable" if math.isinf(error) else f"{error:.1e} kJ/mol per body"
        self._report(f"{name}, {1e3 * interval:.3g} fs per evaluation: {shown}")
        return point

    def time(self, interval: float) -> None:
        """Time all methods at a time a force evaluation in ps; points learn what they cost."""
        times = self.bench.seconds_per_evaluation(list(self.methods.values()), interval)
        self.seconds = dict(zip(self.methods, times, strict=True))
        nested = [name for name, method in self.methods.items() if isinstance(method, NestedScheme)]
        plain = [name for name in self.methods if name != VERLET and name not in nested]
        least = min(self.seconds[name] for name in plain)
        for name in plain:
            self.seconds[name] = min(self.seconds[name], _SAME_WORK * least)
        shares = {name: self.bench.mover(self.methods[name]).fast_share for name in nested}
        more = [max(0.0, self.seconds[name] - least) / shares[name] for name in nested]
        self._plain_seconds, self._nested_seconds = least, min(more, default=0.0)
        for name in nested:
            self.seconds[name] = least + shares[name] * self._nested_seconds
        self.points = [self._priced(p) for p in self.points]

    def _priced(self, point: Point) -> Point:
        """Return a point with its cost: that of its force evaluations, and of the nested ones that it had."""
        seconds = self.seconds.get(point.method, math.nan)
        if isinstance(self.methods[point.method], NestedScheme):
            seconds = self._plain_seconds + self._shares[point.method, point.step] * self._nested_seconds
        return replace(point, cost=seconds * self.stages[point.method] / point.step)

    def schemes(self) -> list[str]:
        """Return the schemes that were stable at some step."""
        return [name for name in self.methods if name != VERLET and self.curve(name)]

    def curve(self, name: str) -> list[Point]:
        """Return the stable points of a method that no longer run refutes, cheapest first."""
        return stable_curve([p for p in self.points if p.method == name])

    def order(self, name: str) -> int:
        """Return the order of a method."""
        method = self.methods[name]
        return 2 if isinstance(method, str) else method.order

    def slope(self, name: str) -> float:
        """Return the power with which the error of a method falls with the cost; see `curves.slope`."""
        return slope(self.curve(name), self.order(name))

    def is_flat(self, name: str) -> bool:
        """Tell whether the error of a method no longer falls from level to level; see `curves.is_flat`."""
        return is_flat([p for p in self.curve(name) if p.duration == self.duration], self.order(name))

    def holds(self, name: str, target: float) -> bool:
        """Tell whether the finest point of a method has an error of the target or less, and no longer run has more."""
        curve = self.curve(name)
        failed = any(p.error > target and p.duration > self.duration for p in curve)
        return bool(curve) and curve[-1].error <= target and not failed
