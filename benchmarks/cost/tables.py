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
    """Return the times of steps over those of OpenMM's integrators, medians and quartiles.

    Those of alanine dipeptide, which are between those of the others, are left out.
    """
    body = []
    for row in (row for row in rows("one_line") if not row["system"].startswith("alanine dipeptide")):
        time = f"{float(row['median']):.2f} ({float(row['lower_quartile']):.2f} to {float(row['upper_quartile']):.2f})"
        system = row["system"] + (", two threads" if row["threads"] == "2" else "")
        body.append((system, _quoted(row["run"]), _quoted(row["relative_to"]), time))
    return table(("system", "integrator", "relative to", "time"), body)


def small_systems() -> str:
    """Return times beside OpenMM's integrators, by platforms, without S2_2, which costs what W2_1 does, and others."""
    return _by_platform([row for row in rows("small_systems") if not (_like_others(row) or _fades(row))])


def _like_others(row: Row) -> bool:
    """Return whether a row shows what others show: sizes between two, further schemes, and the host engine."""
    return row["system"] in ("27 TIP3P", "895 TIP3P") or bool(re.match("S2_2|BAOA, 8|.*two threads", row["run"]))


def alchemical_systems() -> str:
    """Return times of alchemical Systems beside OpenMM's integrator, by platforms."""
    return _by_platform([row for row in rows("small_systems") if _fades(row)])


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
