"""The search: all methods at ever smaller step sizes, then runs of the production length near the target."""

from __future__ import annotations

import math
from collections.abc import Mapping

from openmm_exactrb.tuning.benchmark import VERLET
from openmm_exactrb.tuning.measurements import Measurements, Point, cost_at, step_at

# Time per force evaluation at level 0, and the one at which wall times are measured, in units of the characteristic
# time. From one level to the next it falls by the ratio.
_COARSE, _TIMED_AT, _RATIO = 0.4, 0.1, 2.0**0.5
_SEARCHED = 8  # levels on either side of 0 at which a method may become unstable
_UNCERTAIN = 4  # stable points of a method before it may be given up


def search(measured: Measurements, target: float | None, levels: int) -> tuple[float | None, Point | None]:
    """Measure all methods at so many levels of step sizes, until the target is met or nothing is gained.

    Return the error due to the noise of the forces if it was reached, and the cheapest point that meets the target.
    """
    first = {name: level for name in measured.methods if (level := _first_stable(measured, name)) is not None}
    if not first:
        return None, None
    time = measured.benchmark.characteristics.time
    measured.time(min(_TIMED_AT * time, _interval(measured, max(first.values()))))
    live, floor, chosen = set(first), None, None
    for level in range(min(first.values()), min(first.values()) + levels):
        for name in measured.methods:
            if name in live and level >= first[name]:
                measured.at(name, _interval(measured, level))
        chosen = None if target is None else _confirmed(measured, target, chosen)
        live = _survivors(measured, live, target)
        floor = _floor(measured) or floor
        if chosen is not None or not live - {VERLET}:
            break
    return floor, chosen


def _interval(measured: Measurements, level: float) -> float:
    """Return the time per force evaluation at a level in ps."""
    return float(_COARSE * measured.benchmark.characteristics.time * _RATIO**-level)


def _first_stable(measured: Measurements, name: str) -> int | None:
    """Return the coarsest stable level of a method, after a run half a level coarser."""
    level = 0
    if _is_stable(measured, name, level):
        while level > -_SEARCHED and _is_bounded(measured, level - 1) and _is_stable(measured, name, level - 1):
            level -= 1
    else:
        while level < _SEARCHED and not _is_stable(measured, name, level + 1):
            level += 1
        level += 1
    if level > _SEARCHED:
        return None
    if _is_bounded(measured, level - 0.5):
        _is_stable(measured, name, level - 0.5)
    return level


def _is_stable(measured: Measurements, name: str, level: float) -> bool:
    return math.isfinite(measured.at(name, _interval(measured, level)).error)


def _is_bounded(measured: Measurements, level: float) -> bool:
    """Return whether free bodies turn by at most a radian between two forces: in longer steps they miss each other."""
    return _interval(measured, level) <= measured.benchmark.characteristics.free


def _survivors(measured: Measurements, live: set[str], target: float | None) -> set[str]:
    """Return the methods that are worth smaller steps."""
    last = {name: curve[-1] for name in live if len(curve := measured.curve(name)) >= 2}
    least = min((p.error for p in measured.points if p.method != VERLET), default=math.inf)
    flat = {name for name in last if name != VERLET and measured.is_flat(name) and last[name].error < 2.0 * least}
    done = flat | {name for name in last if target is not None and measured.holds(name, target)}
    return live - done - _beaten(measured, {name: last[name] for name in last.keys() - done - {VERLET}})


def _beaten(measured: Measurements, last: Mapping[str, Point]) -> set[str]:
    """Return the methods that will not win: three times the error of one of their order or above, falling no faster.

    Close to the largest stable step errors fall much faster than the order says, so the first points prove nothing.
    """
    beaten = set()
    for name, mine in last.items():
        for other in last.keys() - {name}:
            theirs = last[other]
            worse = mine.error > 3.0 * theirs.error and mine.cost > 0.9 * theirs.cost
            sure = len(measured.curve(name)) > _UNCERTAIN and measured.slope(name) <= measured.slope(other) + 0.5
            if worse and sure and measured.methods[name].order <= measured.methods[other].order:
                beaten.add(name)
    return beaten


def _floor(measured: Measurements) -> float | None:
    """Return the smallest error if the errors of two schemes, or of the only one, stopped falling close to it."""
    names = measured.schemes()
    least = min((p.error for name in names for p in measured.curve(name)), default=math.inf)
    at_floor = [name for name in names if measured.is_flat(name) and measured.curve(name)[-1].error < 2.0 * least]
    return least if len(at_floor) >= min(2, len(names)) else None


def _confirmed(measured: Measurements, target: float, chosen: Point | None) -> Point | None:
    """Run the cheapest settings near the target for the production length, and return the cheapest that meets it."""
    reached = {name: cost_at(measured.curve(name), target) for name in measured.schemes()}
    costs = {name: cost for name, cost in reached.items() if cost is not None}
    for name in sorted(costs, key=costs.__getitem__)[:3]:
        if chosen is None or costs[name] < min(0.98 * chosen.cost, 1.3 * min(costs.values())):
            chosen = _approached(measured, name, 1.02 * costs[name], target, chosen) or chosen
    return chosen


def _approached(measured: Measurements, name: str, cost: float, target: float, chosen: Point | None) -> Point | None:
    """Raise the cost of a method until a run of the production length meets the target or another one is cheaper."""
    slope = max(measured.slope(name), float(measured.methods[name].order))
    curve = measured.curve(name)  # before longer runs turn out unstable
    for _ in range(5):
        if chosen is not None and cost > 0.98 * chosen.cost:
            return None
        point = measured.at(name, step_at(curve, cost) / measured.stages[name], measured.horizon)
        if point.error <= target:
            return point
        cost *= min(max(1.02 * (point.error / target) ** (1.0 / slope), 1.03), _RATIO)
    return None
