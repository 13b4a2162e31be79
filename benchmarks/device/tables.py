"""Tables of on_gpu.py, device_drift.py and operations.py: speed on a GPU, and energy drifts on a device."""

from __future__ import annotations

import math

from benchmarks.common.markdown import rows, table

_NAMES = {
    "water": "{} TIP3P",
    "free": "{} TIP3P without forces",
    "dipoles": "{} dipoles",
    "peptide": "alanine dipeptide in water",
    "villin": "villin in water",
    "5dfr_solv-cube_equil": "DHFR in water",
    "membrane": "128 POPC in water",
}
_SCHEMES = ("S2_2", "W2_1", "S6_10", "BAOA")
_PROTEINS = ("peptide", "villin", "5dfr_solv-cube_equil", "membrane")
_OF_PROTEINS = {"LangevinMiddle": 4, "BAOA native": 4, "W2_3m native": 8}  # fs between two evaluations


def _by_system() -> dict[tuple[str, str], dict[str, dict[str, str]]]:
    found: dict[tuple[str, str], dict[str, dict[str, str]]] = {}
    for row in rows("device_costs"):
        found.setdefault((row["system"], row["molecules"]), {})[row["integrator"]] = row
    return found


def device_costs() -> str:
    """Return times of a force evaluation of rigid bodies, to Verlet's and with a thermostat to LangevinMiddle's."""
    body = [
        (
            _NAMES[system].format(molecules),
            f"{float(found['Verlet']['ms']):.3f}",
            *(f"{float(found[f'{scheme} native']['ratio']):.2f}" for scheme in _SCHEMES),
        )
        for (system, molecules), found in _by_system().items()
        if system not in _PROTEINS
    ]
    return table(("system", "Verlet, ms", *(f"`{scheme}`" for scheme in _SCHEMES)), body)


def device_proteins() -> str:
    """Return times of a force evaluation and ns a day of proteins, and the gain at 8 fs over LangevinMiddle at 4 fs."""
    body = []
    for (system, molecules), found in _by_system().items():
        if system not in _PROTEINS:
            continue
        some = [found[name] for name in _OF_PROTEINS]
        theirs, ours = (float(found[name]["ns/day"]) for name in ("LangevinMiddle", "W2_3m native"))
        cells = (f"{float(row['ms']):.3f}, {float(row['ns/day']):.0f}" for row in some)
        body.append((_NAMES[system].format(molecules), *cells, f"{ours / theirs:.2f}"))
    names = (f"`{name.removesuffix(' native')}`, {fs} fs" for name, fs in _OF_PROTEINS.items())
    return table(("ms per evaluation, ns per day", *names, "throughput of `W2_3m`"), body)


def device_precision() -> str:
    """Return the energy drift of a droplet with forces without a cutoff, with the native engine."""
    names = ("precision", "drift_kJ_per_mol_ns_molecule", "drift_error", "spread_kJ_per_mol_molecule")
    found = [row for row in rows("device_precision") if row["engine"] == "native"]
    body = [[row[name].replace("-", "−").replace("e−0", "e-") for name in names] for row in found]
    return table(("precision", "drift", "its error", "spread"), body)


def shares_of_operations() -> dict[str, float]:
    """Return the percentage of a force evaluation that operations in double precision take, where it is known."""
    shares: dict[str, float] = {}
    for row in rows("device_operations"):
        shares[row["system"]] = shares.get(row["system"], 0.0) + float(row["percent of a force"])
    return {system: share for system, share in shares.items() if not math.isnan(share)}
