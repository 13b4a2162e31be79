"""The search: all methods at decreasing step sizes, then runs of the production length near the target."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass

from openmm_exactrb.schemes import CATALOGUE
from openmm_exactrb.tuning.benchmark import VERLET, Method
from openmm_exactrb.tuning.budget import BudgetSpentError
from openmm_exactrb.tuning.error import expected_error
from openmm_exactrb.tuning.measurements import Measurements, Point, cost_at, step_at

#: Time per force evaluation of the first step size, over the characteristic time, of plain and of nested schemes.
COARSE, COARSE_NESTED = 1.6, 8.0
#: From one step size to the next it falls by this.
RATIO = 2.0**0.5
# Scheme of the probe for the noise of the forces, its time per evaluation over the characteristic one, its length over
# that of the survey, the part of an error that is left where it is the scheme's, and the part of the kinetic energy
# that is a hundred times what the scheme leaves.
_PROBE, _FINE, _PROBED, _FALLING, _LARGE = "W4_4", 0.05, 0.3, 0.35, 1e-4
# The first step sizes at which a method need not be stable, and how far behind the best one it may then fall.
_SEARCHED, _BEHIND = 16, 10.0
# Methods that are run for the production length at a time, the settings of one that are run, the least rise of the cost
# from one to the next, and the part of the target that is aimed at.
_TRIED, _RUNS, _RISE, _AIM = 3, 5, 1.05, 0.8


@dataclass
class Outcome:
    """The outcome of a search."""

    #: The cheapest point that meets the target.
    chosen: Point | None = None
    #: The error due to the noise of the forces, if it was reached.
    floor: float | None = None
    #: Whether the budget ended it.
    cut: bool = False


def search(measured: Measurements, target: float | None, levels: int) -> Outcome:
    """Measure all methods at decreasing steps, until the target is met, errors stop falling or the budget is spent."""
    outcome = Outcome()
    try:
        _descend(measured, target, levels, outcome)
    except BudgetSpentError:
        outcome.cut = True
    outcome.cut |= measured.cut
    outcome.floor = _floor(measured) or outcome.floor
    return outcome


def probed(measured: Measurements) -> float | None:
    """Return the error due to the noise of the forces, from two runs at short steps; None if it is smaller.

    From the first to the second step, the error of the scheme alone would fall to a quarter.
    """
    benchmark, errors = measured.benchmark, []
    method, duration = Method(CATALOGUE[_PROBE]), _PROBED * measured.duration
    with contextlib.suppress(BudgetSpentError):
        for part in (_FINE * RATIO, _FINE):
            step = method.stages * part * benchmark.characteristics.time
            run = benchmark.run(method, step, duration, benchmark.state)
            errors.append(math.inf if run is None else expected_error(run.values, run.interval, measured.horizon))
    if len(errors) < 2 or not math.isfinite(max(errors)):
        return None
    noise = errors[1] > min(_FALLING * errors[0], _LARGE * benchmark.characteristics.kinetic)
    return min(errors) if noise else None


def _descend(measured: Measurements, target: float | None, levels: int, outcome: Outcome) -> None:
    scales = measured.benchmark.characteristics
    live, last = set(measured.methods), _SEARCHED
    coarsest = {
        name: min((COARSE_NESTED if method.nested else COARSE) * scales.time, scales.free)
        for name, method in measured.methods.items()
    }
    level, interval = 0, max(coarsest.values())
    while level < last and live - {VERLET}:
        for name in measured.methods:
            if name in live and interval <= coarsest[name] * 1.001:
                measured.at(name, interval)
        if measured.schemes():
            last = min(last, level + levels) if last == _SEARCHED else last
        live = _survivors(measured, live)
        if target is not None:
            outcome.chosen = _confirmed(measured, target, outcome.chosen)
            if outcome.chosen is not None:
                return
        if _floor(measured) is not None:
            return
        level, interval = level + 1, interval / RATIO


def _survivors(measured: Measurements, live: set[str]) -> set[str]:
    """Return the methods to try at smaller steps: all but those far behind one of the same or higher order."""
    finest = {name: curve[-1].error for name in live - {VERLET} if len(curve := measured.curve(name)) > 2}
    methods = measured.methods
    behind = {
        name
        for name, error in finest.items()
        if any(error > _BEHIND * e and methods[o].order >= methods[name].order for o, e in finest.items())
    }
    return live - behind


def _floor(measured: Measurements) -> float | None:
    """Return the smallest error if the errors of two schemes, or of the only one, stopped falling close to it."""
    names = measured.schemes()
    least = min((p.error for name in names for p in measured.curve(name)), default=math.inf)
    at_floor = [name for name in names if measured.is_flat(name) and measured.curve(name)[-1].error < 2.0 * least]
    return least if at_floor and len(at_floor) >= min(2, len(names)) else None


def _confirmed(measured: Measurements, target: float, chosen: Point | None) -> Point | None:
    """Run the cheapest settings near the target for the production length, and return the cheapest that meets it."""
    reached = {name: cost_at(measured.curve(name), _AIM * target) for name in measured.schemes()}
    costs = {name: cost for name, cost in reached.items() if cost is not None}
    for name in sorted(costs, key=costs.__getitem__)[:_TRIED]:
        if chosen is None or costs[name] < min(0.98 * chosen.cost, 1.3 * min(costs.values())):
            chosen = _approached(measured, name, _RISE * costs[name], target, chosen) or chosen
    return chosen


def _approached(measured: Measurements, name: str, cost: float, target: float, chosen: Point | None) -> Point | None:
    """Raise the cost of a method until its production runs meet the target or another one is cheaper."""
    curve = measured.curve(name)  # before longer runs turn out unstable
    for _ in range(_RUNS):
        if chosen is not None and cost > 0.98 * chosen.cost:
            return None
        step = step_at(curve, cost)
        point = measured.promised(name, step, target)
        if point.error <= target:
            return point
        cost *= min(max((point.error / (_AIM * target)) ** (1.0 / measured.methods[name].order), _RISE), RATIO)
    return None
