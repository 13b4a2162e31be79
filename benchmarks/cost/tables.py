"""Tables of one_line.py and small_systems.py: what steps cost, compared with those of OpenMM's integrators."""

from __future__ import annotations

import re

from benchmarks.common.markdown import distinct, rows, table
from benchmarks.common.records import Row


def cost_at_8_fs() -> float:
    """Return the cost of a force every 8 fs over that of OpenMM's at 4 fs, for villin on one thread."""
    found = rows("one_line")
    (row,) = [row for row in found if row["system"].startswith("villin") and _point(row) == ("1", "BAOA, 8 fs")]
    return float(row["median"])


def _point(row: Row) -> tuple[str, str]:
    return row["threads"], row["run"]


def one_line() -> str:
    """Return the times of steps over those of each of OpenMM's integrators, medians and quartiles.

    Those of alanine dipeptide, which are between those of the others, are left out.
    """
    found = [row for row in rows("one_line") if not row["system"].startswith("alanine dipeptide")]
    theirs, body = [name for (name,) in distinct(found, "relative_to")], []
    for point in distinct(found, "system", "threads", "run"):
        times = {
            row["relative_to"]: "{median:.2f} ({lower_quartile:.2f} to {upper_quartile:.2f})".format(
                **{name: float(row[name]) for name in ("median", "lower_quartile", "upper_quartile")}
            )
            for row in found
            if (row["system"], row["threads"], row["run"]) == point
        }
        system, _, _ = point[0].partition(" in water")
        label = system + (", two threads" if point[1] == "2" else "")
        body.append((label, _quoted(point[2]), *(times.get(name, "") for name in theirs)))
    return table(("system", "integrator", *map(_quoted, theirs)), body)


def small_systems() -> str:
    """Return ratios of times to those of OpenMM's integrator of the same kind, except those that others resemble."""
    return _by_platform([row for row in rows("small_systems") if row["unit"] == "ratio" and not _like_others(row)])


def _like_others(row: Row) -> bool:
    return (
        row["system"] in ("27 TIP3P", "64 TIP3P", "216 TIP3P", "895 TIP3P")  # at most 1.03
        or bool(re.match("S2_2|BAOA, 8|.*two threads", row["run"]))  # what W2_1 and W2_3m cost; the host engine
        or (row["run"].startswith("the default") and "Langevin" in row["beside"])  # at constant energy
        or _fades(row)
    )


def more_for_a_call() -> tuple[float, float]:
    """Return by how many microseconds a call of one step exceeds a step within a call, at least and at most."""
    more = [float(row["median"]) for row in rows("small_systems") if row["unit"] == "us"]
    return min(more), max(more)


def alchemical_systems() -> dict[tuple[str, str], str]:
    """Return ratios of times of alchemical Systems to those of OpenMM's integrator, by platform and scheme."""
    return {
        (row["platform"], row["run"].partition(",")[0]): f"{float(row['median']):.2f}"
        for row in rows("small_systems")
        if _fades(row)
    }


def _fades(row: Row) -> bool:
    return row["system"].startswith("alchemical")


def _by_platform(found: list[Row]) -> str:
    platforms, body = [name for (name,) in distinct(found, "platform")], []
    for system, run, beside in distinct(found, "system", "run", "beside"):
        of_run = {row["platform"]: row for row in found if (row["system"], row["run"]) == (system, run)}
        cells = (_shown(of_run[name]) if name in of_run else "" for name in platforms)
        body.append((system.replace("_", " "), _quoted(run), _quoted(beside.removeprefix("nothing")), *cells))
    return table(("system", "run", "relative to", *platforms), body)


def _shown(row: Row) -> str:
    value = float(row["median"])
    return {"ratio": f"{value:.2f}", "us": f"{value:.0f} µs", "s": f"{value:.2f} s"}[row["unit"]]


def _quoted(text: str) -> str:
    """Return a text with its names of integrators, schemes and functions as code."""
    return re.sub(r"\w+Integrator|AllBonds|BAOA|W\d_\w+|step\(1\)", r"`\g<0>`", text)
