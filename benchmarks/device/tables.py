"""Tables of on_gpu.py: what a force evaluation costs on a device."""

from __future__ import annotations

from benchmarks.common.markdown import rows, table

_NAMES = {
    "water": "{} TIP3P",
    "free": "{} TIP3P without forces",
    "dipoles": "{} dipoles",
    "peptide": "peptide in water",
    "villin": "villin in water",
    "5dfr_solv-cube_equil": "DHFR in water",
    "membrane": "POPC in water",
}
_SCHEMES = ("S2_2", "W2_1", "S6_10", "BAOA", "W2_3m")


def device_costs() -> str:
    """Return times of a force evaluation, of rigid bodies to Verlet's and with a thermostat to LangevinMiddle's."""
    ratios: dict[str, dict[str, str]] = {}
    for row in rows("device_costs"):
        scheme, _, engine = row["integrator"].partition(" ")
        if engine == "device":
            name = _NAMES[row["system"]].format(row["molecules"])
            ratios.setdefault(name, {})[scheme] = f"{float(row['ratio']):.2f}"
    body = [(name, *(found.get(scheme, "") for scheme in _SCHEMES)) for name, found in ratios.items()]
    return table(("system", *(f"`{scheme}`" for scheme in _SCHEMES)), body)
