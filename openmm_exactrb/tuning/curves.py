"""Error over cost: the measured points of a method, and the curve through those where it is stable."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """One measured run.

    Attributes
    ----------
    method : str
        The name of a scheme, with " nested" behind it where bonded forces are nested, or "VerletIntegrator".
    step : float
        Size of a whole step in ps.
    error : float
        Standard deviation in kJ/mol per body to expect over the horizon; infinite where the run was unstable.
    cost : float
        Wall time in s per ps.
    duration : float
        Length of the run in ps.
    """

    method: str
    step: float
    error: float
    cost: float
    duration: float


def stable(points: Sequence[Point]) -> list[Point]:
    """Return the points of one method with steps below its smallest unstable one."""
    limit = min((p.step for p in points if math.isinf(p.error)), default=math.inf)
    return [p for p in points if p.step < limit]


def stable_curve(points: Sequence[Point]) -> list[Point]:
    """Return the stable points of one method that no other one refutes, cheapest first.

    A point is refuted by a longer run, of a step not above its own, with a larger error: it was too short to show that.
    """
    below = stable(points)
    return sorted((p for p in below if not any(_refutes(q, p) for q in below)), key=lambda p: p.cost)


def _refutes(longer: Point, point: Point) -> bool:
    return longer.duration > point.duration and longer.step <= point.step and longer.error > point.error


def cost_between(a: Point, b: Point, error: float) -> float:
    """Return the cost at an error between those of two points, on a straight line of the logarithms."""
    part = math.log(a.error / error) / math.log(a.error / b.error) if b.error < a.error else 1.0
    return math.exp(math.log(a.cost) + min(max(part, 0.0), 1.0) * math.log(b.cost / a.cost))


def cost_at(curve: Sequence[Point], error: float) -> float | None:
    """Return the cost at which a curve comes down to an error, or None if it does not."""
    for i, point in enumerate(curve):
        if point.error <= error:
            return point.cost if i == 0 else cost_between(curve[i - 1], point, error)
    return None


def step_at(curve: Sequence[Point], cost: float) -> float:
    """Return the step of a cost, where a force evaluation takes the time that it does at the nearest point."""
    nearest = min(curve, key=lambda p: abs(math.log(p.cost / cost)))
    return nearest.step * (nearest.cost / cost)


def slope(curve: Sequence[Point], order: int) -> float:
    """Return how fast the error falls with the cost at the fine end: the power; the order, of a single point."""
    if len(curve) < 2:
        return float(order)
    a, b = curve[-2:]
    return math.log(a.error / b.error) / math.log(b.cost / a.cost)


def is_flat(curve: Sequence[Point], order: int) -> bool:
    """Tell whether the error no longer falls: by less than a third of the order, over two levels."""
    if len(curve) < 3:
        return False
    a, b = curve[-3], curve[-1]
    return math.log(a.error / b.error) < order / 3.0 * math.log(b.cost / a.cost)
