"""Tables of splittings: roundoff.py."""

from __future__ import annotations

from benchmarks.common.markdown import distinct, rows, table

_SYSTEMS = {"top": "heavy tops", "dipoles": "27 dipoles, Reference"}
_STATES = {"sums": "sums", "rounded": "rounded at every stage", "settle": "V2 with SETTLE (OpenMM)"}


def roundoff_errors() -> str:
    """Return the errors of the last step of each system, by what its state is kept in."""
    found, body = rows("roundoff"), []
    for system, variant in distinct(found, "system", "variant"):
        some = [row for row in found if (row["system"], row["variant"]) == (system, variant)]
        last = max(int(row["step"]) for row in some)
        at_end = {row["quantity"]: row for row in some if int(row["step"]) == last}
        errors = (
            f"{float(at_end[name]['rms']):.1e}" if name in at_end else ""
            for name in ("energy", "direction", "momentum")
        )
        steps = f"{last:.0e}".replace("e+0", "e")
        body.append((_SYSTEMS[system], _STATES[variant], at_end["energy"]["starts"], steps, *errors))
    return table(("system", "state", "starts", "steps", "energy", "angular momentum", "linear momentum"), body)
