"""Answers out of what was measured: the cheapest setting for an error, the least error at a cost."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from openmm_exactrb.tuning.curves import Point, cost_at
from openmm_exactrb.tuning.record import Choice, Record


class UnreachableError(ValueError):
    """No setting that was measured has an error or a cost so small."""


def cheapest(record: Record, target: float, method: str | None) -> Choice:
    """Return the cheapest setting for an energy error; see `Tuning.cheapest`."""
    curves = [record.curve(name) for name in record.methods(method)]
    found = [choice for choice in (_at_error(record, curve, target) for curve in curves) if choice is not None]
    if not found:
        raise UnreachableError(unreachable(record, target, method))
    return min(found, key=lambda choice: choice.cost)


def least_error(record: Record, cost: float, method: str | None) -> Choice:
    """Return the setting with the least energy error at a cost; see `Tuning.error_at`."""
    curves = [record.curve(name) for name in record.methods(method)]
    found = [choice for choice in (_at_cost(record, curve, cost) for curve in curves) if choice is not None]
    if not found:
        least = min((p.cost for curve in curves for p in curve), default=math.inf)
        raise UnreachableError(f"no stable setting costs {cost:.3g} s per ps or less: the cheapest costs {least:.3g}")
    return min(found, key=lambda choice: choice.error)


def unreachable(record: Record, target: float, method: str | None = None) -> str:
    """Return a sentence that says why there is no setting for an energy error."""
    points = [p for name in record.methods(method) for p in record.curve(name)]
    if not points:
        return "no run was stable: the start is far from equilibrium, or the forces are not those of a potential"
    least = min(points, key=lambda p: p.error)
    failed = [p for p in points if p.duration >= record.horizon and p.error > target]
    if least.error <= target and failed:
        nearest = min(failed, key=lambda p: p.error)
        return (
            f"an error of {target:.3g} kJ/mol per body was not held: runs of {record.horizon:.3g} ps came down to "
            f"{nearest.error:.2g}, with {nearest.method} and a step of {1e3 * nearest.step:.3g} fs"
        )
    text = (
        f"an error of {target:.3g} kJ/mol per body was not reached: the smallest found is {least.error:.2g}, with "
        f"{least.method} and a step of {1e3 * least.step:.3g} fs"
    )
    return text + ("; smaller steps were not tried" if record.floor is None else f". {about_floor(record.floor)}")


def about_floor(floor: float) -> str:
    """Return a sentence about the error below which smaller steps do not bring it."""
    return (
        f"Below {floor:.1e} kJ/mol per body smaller steps do not lower the error: what is left comes from the "
        "forces (single precision, a cutoff without a switch, a loose ewaldErrorTolerance), not from the scheme. "
        "Take the Reference platform or double precision, or smoother forces"
    )


def _at_error(record: Record, curve: Sequence[Point], target: float) -> Choice | None:
    cost = cost_at(curve, target)
    if cost is None:
        return None
    first = curve[0]
    measured = first.error <= target
    return record.choice(first.method, cost, first.error if measured else target, measured)


def _at_cost(record: Record, curve: Sequence[Point], cost: float) -> Choice | None:
    cheaper = [p for p in curve if p.cost <= cost]
    if not cheaper:
        return None
    last = min(cheaper, key=lambda p: p.error)
    beyond = curve[len(cheaper) :]
    if beyond and beyond[0].error < last.error and last is cheaper[-1]:
        logs = np.log([last.cost, beyond[0].cost, last.error, beyond[0].error])
        error = math.exp(float(np.interp(math.log(cost), logs[:2], logs[2:])))
        return record.choice(last.method, cost, error, cost == last.cost)
    return record.choice(last.method, last.cost, last.error, True)
