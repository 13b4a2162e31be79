"""What was measured, and the advice, as text."""

from __future__ import annotations

import math
import textwrap

from openmm_exactrb.tuning.answers import UnreachableError, about_floor, cheapest, unreachable
from openmm_exactrb.tuning.curves import Point
from openmm_exactrb.tuning.movers import VERLET, is_nested
from openmm_exactrb.tuning.record import Choice, Record


def summary(record: Record) -> str:
    """Return a table of all methods, and what follows from it."""
    lines = [
        f"{record.n_bodies} bodies on {record.platform}. Error: standard deviation of the total energy in kJ/mol per "
        f"body, within {record.horizon:.3g} ps",
        f"(measured over {record.duration:.3g} ps and carried on). Cost: wall time in s per ps.",
    ]
    wrapped = (textwrap.fill(answer, 120) for answer in _answers(record))
    return "\n".join([*lines, "", table(record), "", *wrapped])


def table(record: Record) -> str:
    """Return the errors of all methods over the time a force evaluation, those of nested schemes by themselves."""
    nested = [method for method in record.seconds if is_nested(method)]
    plain = [method for method in record.seconds if not is_nested(method)]
    return "\n\n".join(_block(record, methods) for methods in (plain, nested) if methods)


def _block(record: Record, methods: list[str]) -> str:
    stable = {method: record.largest_stable(method) or math.nan for method in methods}
    rows = [
        ["fs per evaluation", *methods],
        *_rows_of_errors(record, methods),
        ["largest step, fs", *(f"{1e3 * stable[method]:.4g}" for method in methods)],
        ["ms per evaluation", *(f"{1e3 * record.seconds[method]:.3g}" for method in methods)],
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows)


def _rows_of_errors(record: Record, methods: list[str]) -> list[list[str]]:
    refuted = _refuted(record)
    errors = {(p.method, record.interval(p)): _cell(p, refuted) for p in record.points}
    rows = []
    for interval in sorted({interval for _, interval in errors}, reverse=True):
        cells = [errors.get((method, interval), "") for method in methods]
        if any(cells):
            rows.append([f"{1e3 * interval:.4g}", *cells])
    return rows


def _cell(point: Point, refuted: set[Point]) -> str:
    if math.isinf(point.error):
        return "unstable"
    return f"({point.error:.1e})" if point in refuted else f"{point.error:.1e}"


def _refuted(record: Record) -> set[Point]:
    """Return the points whose step was stable, but whose error a longer run showed to be too small."""
    kept = {p for name in record.seconds for p in record.curve(name)}
    stable = {name: record.largest_stable(name) or 0.0 for name in record.seconds}
    return {p for p in record.points if p.step <= stable.get(p.method, 0.0)} - kept


def _answers(record: Record) -> list[str]:
    answers = []
    if _refuted(record):
        answers.append("In brackets: a longer run of a smaller step had a larger error.")
    if record.floor is not None and (record.target is None or record.chosen is not None):
        answers.append(about_floor(record.floor))
    if record.target is not None:
        answers.append(f"target {record.target:.3g}: {record.chosen or unreachable(record, record.target)}")
    if record.chosen is not None:
        answers += _comparison(record, record.chosen)
    return answers + [f"note: {note}" for note in record.notes]


def _comparison(record: Record, chosen: Choice) -> list[str]:
    """Return a line that compares a choice with OpenMM's Verlet integrator."""
    if VERLET not in record.seconds or not record.curve(VERLET):
        return []
    try:
        cost, about = cheapest(record, chosen.error, VERLET).cost, ""
    except UnreachableError:  # carry its order 2 on
        last = record.curve(VERLET)[-1]
        cost, about = last.cost * (last.error / chosen.error) ** 0.5, "about "
    ratio, step = cost / chosen.cost, 1e3 * record.seconds[VERLET] / cost
    if ratio < 1.0:
        return [f"{VERLET} is cheaper here: the same error at {about}{ratio:.2g} times the cost ({step:.3g} fs)"]
    return [f"{VERLET} needs {about}{ratio:.2g} times the cost for the same error ({step:.3g} fs)"]
