"""The search, which runs all methods at decreasing steps, then methods near the target for the production length."""

from __future__ import annotations

import math

import numpy as np

from openmm_exactrb.errors import BudgetSpentError
from openmm_exactrb.schemes import CATALOGUE
from openmm_exactrb.tuning.benchmark import VERLET, Method
from openmm_exactrb.tuning.error import expected_error
from openmm_exactrb.tuning.measurements import Measurements, Point, cost_at, step_at

#: Time per force evaluation at the first step size, in characteristic times, of plain and of nested schemes.
COARSE, COARSE_NESTED = 1.6, 8.0
#: Ratio of successive step sizes.
RATIO = 2.0**0.5
# Schemes of the probe for noise in the forces, their time per force evaluation in characteristic times, and the length
# of the probe relative to the survey. The energy deviation at the finer step is noise if it is below _APART times the
# smaller deviation of the two schemes and above _FALLING times the deviation at the coarser step. A deviation above the
# fraction _LARGE of the kinetic energy, a hundred times the error of a scheme, need not meet the second condition.
_PROBES, _FINE, _PROBED, _FALLING, _LARGE, _APART = ("W4_4", "SRKN4_6b"), 0.05, 0.3, 0.35, 1e-4, 5.0
# Number of step sizes, from the first, at which all methods may be unstable, and the ratio of an error to the noise
# below which smaller steps gain nothing.
_SEARCHED, _CLOSE = 16, 2.0
# Number of methods that are run for the production length at a time, number of settings of each, least ratio of costs
# of successive settings, and fraction of the target that is aimed at.
_TRIED, _RUNS, _RISE, _AIM = 3, 5, 1.05, 0.8


def probed(measured: Measurements) -> float | None:
    """Return the error due to noise in the forces, or None if two schemes with short steps show no such error.

    The steps are so short that the error of a scheme alone would fall to a quarter from the first step to the second.
    If a scheme loses its order, as processed schemes do with nonrigid constraints, its error falls less, but the other
    scheme has a smaller error.
    """
    try:
        runs = [_probed_by(Method(CATALOGUE[name]), measured) for name in _PROBES]
    except BudgetSpentError:
        return None
    finest = min(fine for _, fine, _ in runs)
    largest = _LARGE * measured.benchmark.characteristics.kinetic
    noise = [error for coarse, fine, error in runs if min(_FALLING * coarse, largest) < fine < _APART * finest]
    return min(noise, default=None)


def _probed_by(method: Method, measured: Measurements) -> tuple[float, float, float]:
    """Return the deviations of the energy with two short steps, and the smaller error; infinity for unstable runs."""
    benchmark, deviations, errors = measured.benchmark, [], []
    for part in (_FINE * RATIO, _FINE):
        step = method.stages * part * benchmark.characteristics.time
        run = benchmark.run(method, step, _PROBED * measured.duration, benchmark.state)
        deviations.append(math.inf if run is None else float(np.std(run.values)))
        errors.append(math.inf if run is None else expected_error(run.values, run.interval, measured.horizon))
    return deviations[0], deviations[1], min(errors)


def search(measured: Measurements, target: float | None, levels: int, floor: float | None) -> Point | None:
    """Measure all methods at decreasing steps; return the cheapest point that meets the target, or None.

    The search ends when the target is met, all errors are close to the floor, or the budget is spent.
    """
    scales, live = measured.benchmark.characteristics, dict(measured.methods)
    coarsest = {
        name: min((COARSE_NESTED if method.nested else COARSE) * scales.time, scales.free)
        for name, method in measured.methods.items()
    }
    level, last, interval = 0, _SEARCHED, max(coarsest.values())
    try:
        while level < last and live.keys() - {VERLET}:
            for name in live:
                if interval <= coarsest[name] * 1.001:
                    measured.at(name, interval)
            if target is not None and (chosen := _confirmed(measured, target)):
                return chosen
            if last == _SEARCHED and measured.schemes():
                last = min(last, level + levels)
            live = {name: method for name, method in live.items() if not _at_floor(measured, name, floor)}
            level, interval = level + 1, interval / RATIO
    except BudgetSpentError:
        measured.cut = True
    return None


def _at_floor(measured: Measurements, name: str, floor: float | None) -> bool:
    """Return whether the error of a method is so close to the floor that smaller steps gain nothing."""
    curve = measured.curve(name)
    return floor is not None and bool(curve) and curve[-1].error < _CLOSE * floor


def _confirmed(measured: Measurements, target: float) -> Point | None:
    """Run the cheapest settings near the target for the production length; return the cheapest that succeeds."""
    reached = {name: cost_at(measured.curve(name), _AIM * target) for name in measured.schemes()}
    costs = {name: cost for name, cost in reached.items() if cost is not None}
    chosen: Point | None = None
    for name in sorted(costs, key=costs.__getitem__)[:_TRIED]:
        if chosen is None or costs[name] < min(0.98 * chosen.cost, 1.3 * min(costs.values())):
            chosen = _approached(measured, name, _RISE * costs[name], target, chosen) or chosen
    return chosen


def _approached(measured: Measurements, name: str, cost: float, target: float, chosen: Point | None) -> Point | None:
    """Increase the cost of a method until its production runs meet the target or `chosen` is cheaper."""
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
