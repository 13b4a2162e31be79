"""Tables of roundoff.py, search.py and exactness.py, of the tops of the paper, and of schemes with a heat exchange."""

from __future__ import annotations

import json
import math

import numpy as np

from benchmarks.common.markdown import distinct, rows, table
from benchmarks.common.records import DOCS, Row
from openmm_exactrb.schemes import WITH_THERMOSTAT

_SYSTEMS = {"top": "heavy tops", "dipoles": "27 dipoles"}
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
        body.append((_SYSTEMS[system], _STATES[variant], *errors))
    return table(("system", "state", "energy", "angular momentum", "linear momentum"), body)


def heat_exchanges() -> str:
    """Return the schemes with a heat exchange within a step."""
    body = [
        (f'`"{name}"`', " ".join(str(substep) for substep, _ in scheme.sequence), f"{scheme.forces}")
        for name, scheme in reversed(WITH_THERMOSTAT.items())
    ]
    return table(("scheme", "a step", "forces"), body)


def small_potentials() -> str:
    """Return errors on the tops of the paper with a small potential: two evaluations per unit of time, T0 = 1."""
    found = json.loads((DOCS / "paper" / "data" / "tops.json").read_text(encoding="utf-8"))
    at = found["h"].index(5.0)
    errors = {key.split()[0]: line[at][0][2] for key, line in found["lines"].items() if key.endswith(" exact")}
    several = {name: error for name, error in errors.items() if name not in ("V2", "S4_6", "S6_10", "SRKN6_14a")}
    body = [(f"`{name}`", f"{error:.1e}") for name, error in sorted(several.items(), key=lambda pair: pair[1])]
    body[-1] = (f"{body[-1][0]}, the best scheme with a single order", body[-1][1])
    return table(("scheme", "energy error"), body)


def droplets_of_models() -> str:
    """Return by how much errors of droplets of four water models are below Verlet's: search.py."""
    found = _of_droplets()
    models, body = list(dict.fromkeys(key[0] for key in found)), []
    for rate, scheme in dict.fromkeys((key[1], key[2]) for key in found):
        cells = [_gain(found, model, rate, scheme) for model in models]
        if scheme != "V2" and all(cells):
            body.append((f"`{scheme}`, {rate}", *cells))
    labels = {"tip3p": "TIP3P", "spce": "SPC/E", "tip4pew": "TIP4P-Ew", "tip5p": "TIP5P"}
    return table(("scheme, evaluations per ps", *(labels[model] for model in models)), body)


def _of_droplets() -> dict[tuple[str, str, str], Row]:
    return {(row["model"], row["forces_per_ps"], row["scheme"]): row for row in rows("droplet_models")}


def _gain(found: dict[tuple[str, str, str], Row], model: str, rate: str, scheme: str) -> str:
    """Return Verlet's error over that of a scheme over the whole run."""
    if (model, rate, scheme) not in found:
        return ""
    verlet, ours = (float(found[model, rate, name]["std_all"]) for name in ("V2", scheme))
    return f"{verlet / ours:.3g}" if verlet / ours >= 100 else f"{verlet / ours:.2g}"


def rotors_compared() -> str:
    """Return the energy errors of schemes with either rotor: exactness.py."""
    found = rows("exactness")
    rates, body = [rate for (rate,) in distinct(found, "forces_per_ps")], []
    for scheme, rotor in distinct(found, "scheme", "rotor"):
        cells = []
        for rate in rates:
            of = scheme, rotor, rate
            stds = [row["std"] for row in found if (row["scheme"], row["rotor"], row["forces_per_ps"]) == of]
            known = [float(std) for std in stds if std != "unstable"]
            cells.append(f"{math.sqrt(np.mean(np.square(known))):.1e}" if len(known) == len(stds) else "unstable")
        body.append((f"`{scheme}`", rotor, *cells))
    return table(("scheme", "rotor", *(f"{rate} per ps" for rate in rates)), body)
