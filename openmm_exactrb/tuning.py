"""Advice for a user's own system: which scheme and step, at which energy error and cost."""

from __future__ import annotations

import json
import math
import os
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app, unit

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.schemes import CATALOGUE, Scheme
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.workprecision import VERLET, Bench, Start, conservative, thermalised

Array = NDArray[np.float64]

#: Schemes that are tried unless others are named: for each accuracy those that are the cheapest on some system. Schemes
#: made for a small potential are not among them, nor compositions of Verlet steps, which others beat.
CANDIDATES = ("V2", "S2_2", "S2_4", "W2_4", "W2_6", "W4_5", "SRKN4_6b", "SRKN6_11b", "SRKN6_14a")

# In units of the system's time scale: the time a force evaluation where the search begins, the length of the runs of
# the survey, and the length of the run for which errors are promised.
_COARSE, _SURVEY, _HORIZON = 0.4, 100.0, 1000.0
#: The recommended setting is run this much longer than those of the survey.
_CONFIRM = 5.0
_RATIO = 2.0**0.5
_TIMED_AT = 0.1
# An evaluation is the same work in all schemes, one force, drift and kick: what is further above the fastest is noise.
_SAME_WORK = 1.15
_UNCERTAIN = 4  # stable points of a method before it may be given up
_SEARCHED = 8  # levels on either side of _COARSE where a scheme may become unstable
# Of Okabe and Ito, and of Tol: told apart by colour-blind readers, with markers beside.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#999999", "#882255")
_MARKERS = "so^vDPX*"


@dataclass(frozen=True)
class Point:
    """One measured run.

    Attributes
    ----------
    method : str
        A scheme of the catalogue, or "VerletIntegrator".
    step : float
        Size of a whole step in ps.
    error : float
        Standard deviation in kJ/mol a body to expect over the horizon; infinite where the run was unstable.
    cost : float
        Wall time in s a ps.
    duration : float
        Length of the run in ps.
    """

    method: str
    step: float
    error: float
    cost: float
    duration: float


@dataclass(frozen=True)
class Choice:
    """A scheme and a step.

    Attributes
    ----------
    method : str
        A scheme of the catalogue, or "VerletIntegrator".
    step : float
        Size of a whole step in ps.
    error : float
        Standard deviation of the total energy in kJ/mol a body to expect over the horizon.
    cost : float
        Wall time in s a ps.
    confirmed : bool
        Whether this very setting was run; else it lies between two that were.
    bodies : list of lists of int, optional
        For the integrator.
    """

    method: str
    step: float
    error: float
    cost: float
    confirmed: bool
    bodies: list[list[int]] | None = None

    def integrator(self) -> openmm.Integrator:
        """Return a new integrator with this scheme and step."""
        if self.method == VERLET:
            return openmm.VerletIntegrator(self.step)
        return ExactRigidBodyIntegrator(self.step, scheme=self.method, bodies=self.bodies)

    def __str__(self) -> str:
        return (
            f"{self.method} with a step of {1e3 * self.step:.4g} fs: error {self.error:.1e} kJ/mol a body, "
            f"{self.cost:.3g} s a ps ({86.4 / self.cost:.3g} ns a day)"
        )


class UnreachableError(ValueError):
    """No setting that was measured has an error or a cost so small."""


@dataclass(frozen=True)
class Tuning:
    """What was measured, and the advice that follows.

    Attributes
    ----------
    points : tuple of Point
    seconds : mapping
        Wall time of a force evaluation in s by method.
    stages : mapping
        Force evaluations a step by method.
    n_bodies : int
    platform : str
    duration, horizon : float
        Length in ps of the runs of the survey, and of the runs for which errors are promised.
    target : float, optional
        In kJ/mol a body.
    chosen : Choice, optional
        For the target, where it was reached.
    floor : float, optional
        The error below which smaller steps do not bring it, in kJ/mol a body.
    notes : tuple of str
    bodies : list of lists of int, optional
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

    # -- answers ------------------------------------------------------------------------------------------------

    def best(self, target: float | None = None) -> Choice:
        """Return the cheapest scheme of the catalogue and its step for an energy error.

        Parameters
        ----------
        target : float, optional
            Standard deviation of the total energy in kJ/mol a body within a run as long as the horizon. For the
            target that was tuned for, and without one, the choice was confirmed by a longer run; others are
            interpolated with `cheapest`.

        Raises
        ------
        UnreachableError
            With the smallest error that was found.
        """
        target = self.target if target is None else _positive(target, "target", "kJ/mol a body")
        if target is None:
            raise ValueError("give best() a target: tune() was called without one")
        if self.chosen is not None and target == self.target:
            return self.chosen
        return self.cheapest(target)

    def cheapest(self, target: float, method: str | None = None) -> Choice:
        """Return the cheapest setting for an energy error, between those measured.

        Parameters
        ----------
        target : float
            As for `best`.
        method : str, optional
            A scheme, or "VerletIntegrator"; all schemes of the catalogue unless given.

        Raises
        ------
        UnreachableError
            With the smallest error that was found.
        ValueError
            If the method was not measured or the target is not positive.
        """
        target = _positive(target, "target", "kJ/mol a body")
        curves = [self._curve(name) for name in self._methods(method)]
        found = [c for c in (self._at_error(curve, target) for curve in curves if curve) if c is not None]
        if not found:
            raise UnreachableError(self._unreachable(target, method))
        return min(found, key=lambda choice: choice.cost)

    def error_at(self, cost: float, method: str | None = None) -> Choice:
        """Return the setting with the least energy error at a cost, and the error with it.

        Parameters
        ----------
        cost : float
            Wall time in s a ps.
        method : str, optional
            As for `cheapest`.

        Raises
        ------
        UnreachableError
            If every stable setting costs more.
        ValueError
            If the method was not measured or the cost is not positive.
        """
        cost = _positive(cost, "cost", "s a ps")
        curves = [self._curve(name) for name in self._methods(method)]
        found = [c for c in (self._at_cost(curve, cost) for curve in curves if curve) if c is not None]
        if not found:
            least = min((p.cost for curve in curves for p in curve), default=math.inf)
            raise UnreachableError(f"no stable setting costs {cost:.3g} s a ps or less: the cheapest costs {least:.3g}")
        return min(found, key=lambda choice: choice.error)

    def largest_stable_step(self, method: str) -> float:
        """Return the largest step in ps of a scheme that kept its energy to a tenth of the kinetic energy.

        Steps were tried up to the first unstable one, 19 % above it or less.

        Raises
        ------
        ValueError
            If the method was not measured, or no step of it was stable.
        """
        (name,) = self._methods(method)
        steps = [p.step for p in self._curve(name)]
        if not steps:
            raise UnreachableError(f"no step of {name} that was tried is stable")
        return max(steps)

    # -- print and keep -----------------------------------------------------------------------------------------

    def __str__(self) -> str:
        lines = [
            f"{self.n_bodies} bodies on {self.platform}. Error: standard deviation of the total energy in kJ/mol a "
            f"body, within {self.horizon:.3g} ps",
            f"(measured over {self.duration:.3g} ps and carried on). Cost: wall time in s a ps.",
        ]
        answers = []
        if self.floor is not None and (self.target is None or self.chosen is not None):
            answers.append(self._floor_message())
        if self.target is not None:
            answers.append(f"target {self.target:.3g}: {self.chosen or self._unreachable(self.target, None)}")
        if self.chosen is not None:
            answers += self._comparison(self.chosen)
        answers += [f"note: {note}" for note in self.notes]
        return "\n".join([*lines, "", self.table(), "", *(textwrap.fill(answer, 120) for answer in answers)])

    def table(self) -> str:
        """Return the errors of all methods over the time a force evaluation, as text."""
        methods = list(self.seconds)
        intervals = sorted({self._interval(p) for p in self.points}, reverse=True)
        errors = {(p.method, self._interval(p)): p.error for p in self.points}
        rows = [["fs an evaluation", *methods]]
        for interval in intervals:
            row = [errors.get((method, interval)) for method in methods]
            if any(e is not None for e in row):
                cells = ["" if e is None else "unstable" if math.isinf(e) else f"{e:.1e}" for e in row]
                rows.append([f"{1e3 * interval:.4g}", *cells])
        stable = {method: max((p.step for p in self._curve(method)), default=math.nan) for method in methods}
        rows.append(["largest step, fs", *(f"{1e3 * stable[method]:.4g}" for method in methods)])
        rows.append(["ms an evaluation", *(f"{1e3 * self.seconds[method]:.3g}" for method in methods)])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows)

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain numbers, strings and lists; errors of unstable runs are None."""
        content = asdict(self)
        for point in content["points"]:
            point["error"] = point["error"] if math.isfinite(point["error"]) else None
        steps = {name: [p.step for p in self._curve(name)] for name in self.seconds}
        content["largest_stable_steps"] = {name: max(s, default=None) for name, s in steps.items()}
        content["units"] = {"error": "kJ/mol a body", "step": "ps", "cost": "s a ps", "seconds": "s"}
        return content

    def to_json(self) -> str:
        """Return all of it as JSON."""
        return json.dumps(self.as_dict(), indent=1)

    def draw(self, file: str | os.PathLike[str]) -> None:
        """Draw energy error over cost; needs matplotlib.

        Parameters
        ----------
        file : str or path
            With the ending of a format that matplotlib writes.

        Raises
        ------
        ModuleNotFoundError
            Without matplotlib.
        """
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
            from matplotlib.ticker import LogLocator
        except ModuleNotFoundError:
            raise ModuleNotFoundError(
                "the picture needs matplotlib: install it, or openmm-exactrb[plot]", name="matplotlib"
            ) from None
        figure = Figure(figsize=(8.5, 5.0), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        self._plot(axes)
        axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        figure.savefig(file, dpi=150)

    def _plot(self, axes: Any) -> None:
        ours = 0
        for method in self.seconds:
            curve = self._curve(method)
            style = {"color": "black", "ls": "--", "marker": "o"}
            if method != VERLET:
                style = {
                    "color": _COLOURS[ours % len(_COLOURS)],
                    "ls": ("-", ":")[ours // len(_COLOURS) % 2],
                    "marker": _MARKERS[ours % len(_MARKERS)],
                }
                ours += 1
            if curve:
                values = np.array([(p.cost, p.error) for p in curve])
                axes.loglog(*values.T, label=method, ms=5, mec="black", mew=0.4, lw=1.2, **style)
        if self.target is not None:
            axes.axhline(self.target, color="0.4", lw=0.8, ls=(0, (6, 3)), label="target", zorder=0)
        if self.floor is not None:
            axes.axhspan(1e-3 * self.floor, self.floor, color="0.85", label="below the floor of the forces", zorder=0)
        if self.chosen is not None:
            at = self.chosen.cost, self.chosen.error
            label = f"chosen: {self.chosen.method}, {1e3 * self.chosen.step:.3g} fs"
            axes.loglog(*at, "o", ms=14, mfc="none", mec="black", mew=1.5, ls="", label=label)
        errors = [p.error for name in self.seconds for p in self._curve(name)]
        axes.set_ylim(bottom=0.4 * min([*errors, self.target or math.inf], default=1.0))
        axes.set_xlabel("wall time (s per ps)")
        axes.set_ylabel(f"std of total energy over {self.horizon:.3g} ps (kJ/mol per body)")
        axes.set_title(f"{self.n_bodies} bodies, {self.platform} platform")
        axes.grid(True, which="both", alpha=0.2)
        for kind in ("major", "minor"):
            getattr(axes.xaxis, f"set_{kind}_formatter")("{x:.3g}")
        axes.figure.legend(loc="outside right upper", fontsize=8)

    # -- within -------------------------------------------------------------------------------------------------

    def _methods(self, method: str | None) -> list[str]:
        if method is None:
            return [name for name in self.seconds if name != VERLET]
        if method not in self.seconds:
            raise ValueError(f"{method!r} was not measured: choose one of {', '.join(self.seconds)}")
        return [method]

    def _interval(self, point: Point) -> float:
        """Return the time a force evaluation in ps, equal for points of one level."""
        return float(f"{point.step / self.stages[point.method]:.6g}")

    def _curve(self, method: str) -> list[Point]:
        """Return the stable points of a method beyond its last unstable one, cheapest first."""
        return stable_curve([p for p in self.points if p.method == method])

    def _choice(self, method: str, cost: float, error: float, measured: bool) -> Choice:
        step = self.stages[method] * self.seconds[method] / cost
        return Choice(method, step, error, cost, measured, self.bodies)

    def _at_error(self, curve: list[Point], target: float) -> Choice | None:
        for i, point in enumerate(curve):
            if point.error <= target:
                if i == 0:
                    return self._choice(point.method, point.cost, point.error, True)
                cost = _between(curve[i - 1], point, target)
                return self._choice(point.method, cost, target, False)
        return None

    def _at_cost(self, curve: list[Point], cost: float) -> Choice | None:
        cheaper = [p for p in curve if p.cost <= cost]
        if not cheaper:
            return None
        last = min(cheaper, key=lambda p: p.error)
        beyond = curve[len(cheaper) :]
        if beyond and beyond[0].error < last.error and last is cheaper[-1]:
            logs = np.log([last.cost, beyond[0].cost, last.error, beyond[0].error])
            error = math.exp(float(np.interp(math.log(cost), logs[:2], logs[2:])))
            return self._choice(last.method, cost, error, cost == last.cost)
        return self._choice(last.method, last.cost, last.error, True)

    def _unreachable(self, target: float, method: str | None) -> str:
        curves = [self._curve(name) for name in self._methods(method)]
        points = [p for curve in curves for p in curve]
        if not points:
            return "no run was stable: the start is far from equilibrium, or the forces are not those of a potential"
        least = min(points, key=lambda p: p.error)
        text = (
            f"an error of {target:.3g} kJ/mol a body was not reached: the smallest found is {least.error:.2g}, with "
            f"{least.method} and a step of {1e3 * least.step:.3g} fs"
        )
        return text + (f". {self._floor_message()}" if self.floor is not None else "; smaller steps were not tried")

    def _floor_message(self) -> str:
        return (
            f"Below {self.floor:.1e} kJ/mol a body smaller steps do not lower the error: what is left comes from the "
            "forces (single precision, a cutoff without a switch, a loose ewaldErrorTolerance), not from the scheme. "
            "Take the Reference platform or double precision, or smoother forces"
        )

    def _comparison(self, chosen: Choice) -> list[str]:
        """Return a line that compares a choice with OpenMM's Verlet integrator."""
        if VERLET not in self.seconds or not self._curve(VERLET):
            return []
        try:
            cost, about = self.cheapest(chosen.error, VERLET).cost, ""
        except UnreachableError:  # carry its order 2 on
            last = self._curve(VERLET)[-1]
            cost, about = last.cost * (last.error / chosen.error) ** 0.5, "about "
        ratio, step = cost / chosen.cost, 1e3 * self.seconds[VERLET] / cost
        if ratio < 1.0:
            return [f"{VERLET} is cheaper here: the same error at {about}{ratio:.2g} times the cost ({step:.3g} fs)"]
        return [f"{VERLET} needs {about}{ratio:.2g} times the cost for the same error ({step:.3g} fs)"]


def stable_curve(points: Sequence[Point]) -> list[Point]:
    """Return the points of one method with steps below its smallest unstable one, cheapest first."""
    limit = min((p.step for p in points if math.isinf(p.error)), default=math.inf)
    return sorted((p for p in points if p.step < limit), key=lambda p: p.cost)


def _between(a: Point, b: Point, error: float) -> float:
    """Return the cost at an error between those of two points, on a straight line of the logarithms."""
    part = math.log(a.error / error) / math.log(a.error / b.error) if b.error < a.error else 1.0
    return math.exp(math.log(a.cost) + min(max(part, 0.0), 1.0) * math.log(b.cost / a.cost))


class _Search:
    """The survey, level by level of the time a force evaluation, and the confirmation near the target."""

    def __init__(
        self,
        bench: Bench,
        schemes: Sequence[Scheme],
        target: float | None,
        duration: float,
        levels: int,
        report: Callable[[str], None],
    ) -> None:
        self.bench, self.target, self.duration, self.levels, self.report = bench, target, duration, levels, report
        self.methods: dict[str, str | Scheme] = {s.name: s for s in schemes}
        if bench.has_baseline:
            self.methods[VERLET] = VERLET
        self.stages = {name: bench.mover(method).stages for name, method in self.methods.items()}
        self.coarse = _COARSE * bench.time_scale
        self.horizon = _HORIZON / _SURVEY * duration
        self.points: list[Point] = []
        self.seconds: dict[str, float] = {}
        self.floor: float | None = None
        self.chosen: Point | None = None

    def everything(self) -> None:
        first = {name: self._stability(name) for name in self.methods}
        begin = min((k for k in first.values() if k is not None), default=None)
        if begin is None:
            return
        self._time(max(k for k in first.values() if k is not None))
        live = {name for name, k in first.items() if k is not None}
        for level in range(begin, begin + self.levels):
            for name in sorted(live, key=list(self.methods).index):
                if level >= (first[name] or 0):
                    self.measure(name, self.coarse * _RATIO**-level, self.duration)
            live = self._survivors(live)
            self._find_floor()
            reached = self.target is not None and self._confirm()
            if reached or not live - {VERLET}:
                break

    # -- one method ---------------------------------------------------------------------------------------------

    def measure(self, name: str, interval: float, duration: float) -> Point:
        """Return the point of a method at a time a force evaluation, run if it was not yet for as long."""
        step = self.stages[name] * interval
        for known in self.points:
            if known.method == name and math.isclose(known.step, step, rel_tol=1e-9):
                if known.duration >= duration or math.isinf(known.error):
                    return known
                self.points.remove(known)
                break
        series = self.bench.run(self.methods[name], step, duration)
        error = series.error(self.horizon)
        error = error if error < 0.1 * self.bench.kinetic else math.inf
        point = Point(name, step, error, self.seconds.get(name, math.nan) / interval, duration)
        self.points.append(point)
        shown = "unstable" if math.isinf(error) else f"{error:.1e} kJ/mol a body"
        self.report(f"{name}, {1e3 * interval:.3g} fs an evaluation: {shown}")
        return point

    def _stable(self, name: str, level: float) -> bool:
        return math.isfinite(self.measure(name, self.coarse * _RATIO**-level, self.duration).error)

    def _stability(self, name: str) -> int | None:
        """Find the first stable level of a method, and try half a level more."""
        level = 0
        if self._stable(name, level):
            while level > -_SEARCHED and self._stable(name, level - 1):
                level -= 1
        else:
            while level < _SEARCHED and not self._stable(name, level + 1):
                level += 1
            level += 1
        if level > _SEARCHED:
            return None
        self._stable(name, level - 0.5)
        return level

    def _time(self, level: int) -> None:
        interval = min(_TIMED_AT * self.bench.time_scale, self.coarse * _RATIO**-level)
        times = self.bench.seconds_per_evaluation(list(self.methods.values()), interval)
        ours = [t for name, t in zip(self.methods, times, strict=True) if name != VERLET]
        limit = {name: math.inf if name == VERLET else _SAME_WORK * min(ours) for name in self.methods}
        self.seconds = {name: min(t, limit[name]) for name, t in zip(self.methods, times, strict=True)}
        self.points = [
            Point(p.method, p.step, p.error, self.seconds[p.method] * self.stages[p.method] / p.step, p.duration)
            for p in self.points
        ]

    # -- all methods --------------------------------------------------------------------------------------------

    def curve(self, name: str) -> list[Point]:
        return stable_curve([p for p in self.points if p.method == name])

    def _slope(self, name: str) -> float:
        """Return how fast the error falls with the cost at the fine end: the power."""
        curve = self.curve(name)
        if len(curve) < 2:
            return float(self._order(name))
        a, b = curve[-2:]
        return math.log(a.error / b.error) / math.log(b.cost / a.cost)

    def _ours(self) -> list[str]:
        return [name for name in self.methods if name != VERLET and self.curve(name)]

    def _survivors(self, live: set[str]) -> set[str]:
        """Return the methods that are worth smaller steps."""
        known = {name for name in live if len(self.curve(name)) >= 2}
        last = {name: self.curve(name)[-1] for name in known}
        least = min((p.error for p in self.points if p.method != VERLET), default=math.inf)
        flat = {name for name in known - {VERLET} if self._flat(name) and last[name].error < 2.0 * least}
        done = flat | {name for name in known if self.target is not None and last[name].error <= self.target}
        return live - done - self._beaten(known - done - {VERLET}, last)

    def _flat(self, name: str) -> bool:
        """Whether the error of a method no longer falls: by less than a third of its order, over two levels."""
        curve, order = self.curve(name), self._order(name)
        if len(curve) < 3:
            return False
        a, b = curve[-3], curve[-1]
        return math.log(a.error / b.error) < order / 3.0 * math.log(b.cost / a.cost)

    def _beaten(self, names: set[str], last: Mapping[str, Point]) -> set[str]:
        """Return the methods that will not overtake: three times the error of one of their order, falling no faster.

        Next to the largest stable step errors fall much faster than by their order: the first points say nothing.
        """
        beaten = set()
        for name in names:
            for other in names - {name}:
                mine, theirs = last[name], last[other]
                worse = mine.error > 3.0 * theirs.error and mine.cost > 0.9 * theirs.cost
                known = len(self.curve(name)) > _UNCERTAIN and self._slope(name) <= self._slope(other) + 0.5
                if worse and known and self._order(name) <= self._order(other):
                    beaten.add(name)
        return beaten

    def _order(self, name: str) -> int:
        return look_up(self.methods[name]).order

    def _find_floor(self) -> None:
        names = [name for name in self._ours() if self._flat(name)]
        least = min((p.error for name in self._ours() for p in self.curve(name)), default=math.inf)
        at_floor = [name for name in names if self.curve(name)[-1].error < 2.0 * least]
        if len(at_floor) >= min(2, len(self._ours())):
            self.floor = least

    def _confirm(self) -> bool:
        """Run the cheapest settings near the target longer, and choose the cheapest that holds it."""
        assert self.target is not None
        reached = {name: self._crossing(name) for name in self._ours()}
        costs = {name: cost for name, cost in reached.items() if cost is not None}
        for name in sorted(costs, key=costs.__getitem__)[:3]:
            if self.chosen is None or costs[name] < min(0.98 * self.chosen.cost, 1.3 * min(costs.values())):
                self._approach(name, 1.02 * costs[name])
        return self.chosen is not None

    def _crossing(self, name: str) -> float | None:
        """Return the cost at which a method meets the target, or None."""
        curve, target = self.curve(name), self.target or 0.0
        met = [i for i, p in enumerate(curve) if p.error <= target]
        if not met:
            return None
        i = met[0]
        return curve[i].cost if i == 0 else _between(curve[i - 1], curve[i], target)

    def _approach(self, name: str, cost: float) -> None:
        """Run a method longer at a cost, and at higher ones until it holds the target or is no longer the best."""
        assert self.target is not None
        slope = max(self._slope(name), float(self._order(name)))
        for _ in range(5):
            if self.chosen is not None and cost > 0.98 * self.chosen.cost:
                return
            point = self.measure(name, self.seconds[name] / cost, _CONFIRM * self.duration)
            if point.error <= self.target:
                self.chosen = point
                return
            cost *= min(max(1.02 * (point.error / self.target) ** (1.0 / slope), 1.03), _RATIO)


# -- what a user calls ------------------------------------------------------------------------------------------


def tune(
    system: openmm.System | app.Simulation,
    start: Any = None,
    *,
    target: float | None = None,
    schemes: Sequence[str | Scheme] | None = None,
    velocities: Any = None,
    temperature: float | unit.Quantity | None = None,
    platform: str | openmm.Platform | None = None,
    properties: Mapping[str, str] | None = None,
    bodies: Sequence[Sequence[int]] | None = None,
    duration: float | unit.Quantity | None = None,
    levels: int = 10,
    seed: int = 0,
    report: Callable[[str], None] | None = None,
) -> Tuning:
    """Measure energy error and wall time of schemes on a system, and find the cheapest for a wanted error.

    The error is the standard deviation of the total energy, its swing and its wandering or drift alike, in kJ/mol a
    body (rigid bodies, and particles beside them), within an NVE run as long as the horizon: ten times the runs of the
    survey. These run `duration`; how their variance grows from 1/8 of a run to all of it tells how it goes on, and the
    recommended setting is run five times longer. A wandering energy is known badly from one run, so that its error is
    raised by up to a half. Short swings alone would not do: near hard cores the energy of
    high-order schemes wanders as a random walk does, and their advantage is lost in longer runs.

    Parameters
    ----------
    system : openmm.System or openmm.app.Simulation
        A Simulation gives its state, platform and bodies named by hand too. Thermostats, barostats and motion removers
        are left out of the measurements.
    start : openmm.State or (n, 3) array or Quantity, optional
        A State with positions and velocities, best of an equilibrated run; or positions, in nm if without a unit.
    target : float, optional
        Wanted standard deviation of the total energy in kJ/mol a body. Without one all levels are measured, and the
        result is asked.
    schemes : sequence of str or Scheme, optional
        `CANDIDATES` unless given. OpenMM's VerletIntegrator is measured beside them where constraints hold all bodies.
    velocities : (n, 3) array or Quantity, optional
        Beside positions, in nm/ps if without a unit.
    temperature : float or Quantity, optional
        In K: minimise positions that come without velocities, draw momenta and let them mix with the positions, 20
        times within some periods. Needed where all velocities are zero.
    platform : str or openmm.Platform, optional
        The fastest one here unless given.
    properties : mapping, optional
        Of the platform.
    bodies : sequence of sequences of int, optional
        As in `ExactRigidBodyIntegrator`; those of the integrator of a Simulation unless given.
    duration : float or Quantity, optional
        Length of the runs of the survey, in ps if without a unit; 100 over the root mean square frequency of the
        system unless given (1.5 ps for water).
    levels : int, optional
        Most levels of the time a force evaluation, each sqrt(2) below the one before, from the largest stable one.
    seed : int, optional
        Of the momenta.
    report : callable, optional
        Gets a line of text for each run, such as `print`.

    Returns
    -------
    Tuning

    Raises
    ------
    ValueError
        If something is missing or does not fit, all velocities are zero without a temperature, or a scheme is unknown
        or cannot serve.
    """
    wanted = None if target is None else _positive(target, "target", "kJ/mol a body")
    chosen = _schemes(schemes)
    if not (isinstance(levels, int) and levels >= 3):
        raise ValueError(f"levels must be a whole number of at least 3, not {levels!r}")
    begin, notes = _start(system, start, velocities, platform, properties, bodies)
    if temperature is not None:
        kelvin = _positive(temperature, "temperature", "K", unit.kelvin)
        begin = thermalised(begin, kelvin, seed, minimise=not begin.velocities.any())
        notes.append(
            f"the start was brought to {kelvin:g} K in a short run: the State of an equilibrated one is better"
        )
    elif not begin.velocities.any():
        raise ValueError(
            "all velocities of the start are zero, and the energy error of a system at rest says nothing about one in "
            "motion: give a State of an equilibrated run with velocities=True, or a temperature in K"
        )
    bench = Bench(begin)
    length = _SURVEY * bench.time_scale
    if duration is not None:
        length = _positive(duration, "duration", "ps", unit.picosecond)
    search = _Search(bench, chosen, wanted, length, levels, report or (lambda line: None))
    search.everything()
    return _result(search, begin, notes)


def _result(search: _Search, begin: Start, notes: list[str]) -> Tuning:
    own = None if begin.bodies is None else [list(map(int, body)) for body in begin.bodies]
    found = search.chosen
    if search.floor is not None and found is not None and found.error < 1.5 * search.floor:
        notes.append("the chosen setting is at the floor of the forces: nothing is gained by asking for less")
    return Tuning(
        points=tuple(search.points),
        seconds=search.seconds,
        stages=search.stages,
        n_bodies=search.bench.n_bodies,
        platform=begin.platform,
        duration=search.duration,
        horizon=search.horizon,
        target=search.target,
        chosen=None if found is None else Choice(found.method, found.step, found.error, found.cost, True, own),
        floor=search.floor,
        notes=tuple(notes),
        bodies=own,
    )


def _schemes(names: Sequence[str | Scheme] | None) -> list[Scheme]:
    if isinstance(names, (str, Scheme)):
        names = [names]
    schemes = [look_up(name) for name in (CANDIDATES if names is None else names)]
    if not schemes:
        raise ValueError(f"schemes is empty: name some of {', '.join(CATALOGUE)}")
    for scheme in schemes:
        if scheme.c:
            raise ValueError(f"scheme {scheme.name} needs force gradients, which OpenMM has not: leave it out")
        if scheme.processor:
            raise ValueError(
                f"scheme {scheme.name} is processed: each look at the energy costs {scheme.processing} forces, and a "
                "step has no cost of its own: leave it out"
            )
    return list({scheme.name: scheme for scheme in schemes}.values())


def _start(
    system: Any, start: Any, velocities: Any, platform: Any, properties: Any, bodies: Any
) -> tuple[Start, list[str]]:
    """Return where the runs begin, of what a user gave, and what is worth a note."""
    if isinstance(system, app.Simulation):
        context = system.context
        platform = context.getPlatform() if platform is None else platform
        start = context.getState(positions=True, velocities=True, parameters=True) if start is None else start
        if bodies is None and isinstance(system.integrator, ExactRigidBodyIntegrator):
            bodies = system.integrator.getNamedBodies()
        system = system.system
    if not isinstance(system, openmm.System):
        raise ValueError(f"the first argument must be an openmm.System or a Simulation, not {type(system).__name__}")
    box: Any = None
    parameters: dict[str, float] = {}
    if isinstance(start, openmm.State):
        start, velocities, box, parameters = _from_state(start, velocities)
    if start is None:
        raise ValueError("there is no start: give a State or positions, or a Simulation")
    twin, left_out = conservative(system)
    x = _coordinates(start, system, unit.nanometer, "positions")
    v = np.zeros_like(x)
    if velocities is not None:
        v = _coordinates(velocities, system, unit.nanometer / unit.picosecond, "velocities")
    notes = [f"{', '.join(left_out)} of the System left out of the measurements"] if left_out else []
    if parameters:  # not those of the forces left out
        known = openmm.Context(twin, openmm.VerletIntegrator(0.001), _named("Reference")).getParameters()
        parameters = {name: value for name, value in parameters.items() if name in known}
    named = _fastest() if platform is None else platform
    named = named if isinstance(named, str) else named.getName()
    _named(named)
    return Start(twin, x, v, box, parameters, named, dict(properties or {}), bodies), notes


def _from_state(state: openmm.State, velocities: Any) -> tuple[Any, Any, Any, dict[str, float]]:
    kinds = state.getDataTypes()
    if not kinds & openmm.State.Positions:
        raise ValueError("the State has no positions: make it with getState(positions=True, velocities=True)")
    if velocities is None and kinds & openmm.State.Velocities:
        velocities = state.getVelocities(asNumpy=True)
    parameters = dict(state.getParameters()) if kinds & openmm.State.Parameters else {}
    return state.getPositions(asNumpy=True), velocities, state.getPeriodicBoxVectors(), parameters


def _coordinates(values: Any, system: openmm.System, in_unit: unit.Unit, what: str) -> Array:
    if unit.is_quantity(values):
        if not values.unit.is_compatible(in_unit):
            raise ValueError(f"{what} have the unit {values.unit}: give them in {in_unit}")
        values = values.value_in_unit(in_unit)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be numbers of shape (n, 3), not {type(values).__name__}") from None
    if array.shape != (system.getNumParticles(), 3):
        raise ValueError(
            f"{what} have the shape {array.shape}, but the System has {system.getNumParticles()} particles"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{what} are not finite")
    return array


def _named(platform: str) -> openmm.Platform:
    names = [openmm.Platform.getPlatform(i).getName() for i in range(openmm.Platform.getNumPlatforms())]
    if platform not in names:
        raise ValueError(f"there is no platform {platform!r} here: choose one of {', '.join(names)}")
    return openmm.Platform.getPlatform(platform)


def _fastest() -> openmm.Platform:
    platforms = [openmm.Platform.getPlatform(i) for i in range(openmm.Platform.getNumPlatforms())]
    return max(platforms, key=lambda platform: platform.getSpeed())


def _positive(value: Any, name: str, symbol: str, in_unit: unit.Unit | None = None) -> float:
    if unit.is_quantity(value) and in_unit is not None and value.unit.is_compatible(in_unit):
        value = value.value_in_unit(in_unit)
    number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if not number or not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be a positive number of {symbol}, not {value!r}")
    return float(value)
