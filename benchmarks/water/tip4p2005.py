"""Density and enthalpy of TIP4P/2005 at 1 bar as functions of the step: a picture and tables of three records.

The runs are those of equipartition.py at constant pressure. With 216 molecules, records/equipartition.csv contains runs
at 298.15 K, and records/water_densities.csv runs at another temperature and with other integrators.
records/water_densities_512.csv contains runs of 512 molecules. The enthalpy is computed as a user would: the sum of the
potential energy, the kinetic energy of the velocities of a State, and the product of pressure and volume. Corrections
for the step are those of corrected_water.py.

    python benchmarks/water/equipartition.py --models tip4p2005 --ensembles NPT \
        --record benchmarks/records/water_densities.csv
    python benchmarks/water/equipartition.py --models tip4p2005 --ensembles NPT \
        --record benchmarks/records/water_densities.csv --methods hybrid --intervals 4 --kelvin 277.15
    python benchmarks/water/equipartition.py --models tip4p2005 --ensembles NPT \
        --record benchmarks/records/water_densities_512.csv --methods W2_3m --intervals 4 --molecules 512
    python benchmarks/water/tip4p2005.py
"""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import product

import numpy as np

from benchmarks.common.markdown import table, with_error
from benchmarks.common.pictures import plt
from benchmarks.common.records import PICTURES, RECORDS
from benchmarks.common.starts import R
from benchmarks.water import corrected_water
from benchmarks.water.corrected_water import BAR, MOLAR_MASS
from benchmarks.water.equipartition_record import AGAIN, FRICTION, KELVIN, LFM, RECORD, mean_and_error, read

LARGER = RECORDS / "water_densities_512.csv"
MOLECULES = 216  # in the other records
STEPS = (0.5, 1.0, 2.0, 4.0)  # fs per force evaluation, in the picture
SHOWN = (0.5, 2.0, 4.0)  # in the table
QUANTITIES = {"density": ("density (kg/m³)", 1), "enthalpy": ("enthalpy (kJ/mol per molecule)", 2)}
ROWS = {
    LFM: "`LangevinMiddleIntegrator`",
    "BAOAB": "BAOAB, at the end of a step",
    "NoseHoover": "`NoseHooverIntegrator`",
    "NoseHoover/W2_3m": "Nosé-Hoover chains, `W2_3m`",
    "W2_3m": "`W2_3m`",
    "hybrid": "hybrid Monte Carlo",
}
LINES = {LFM: ("#D55E00", "o"), "BAOAB": ("#009E73", "v"), "W2_3m": ("#0072B2", "D")}
Found = dict[tuple[float, str, float], dict[str, tuple[float, float]]]


def enthalpy(means: dict[str, float]) -> float:
    """Return the enthalpy of a run (kJ/mol per molecule) with the kinetic energy of the velocities in a State."""
    kinetic = 1.5 * R * (2.0 * means["T_tr"] + means["T_rot - T_tr"])
    return means["U"] + kinetic + BAR * MOLAR_MASS / means["density"]


def measured() -> Found:
    """Return density and enthalpy with their errors by temperature, method and time per force evaluation."""
    groups: dict[tuple[float, str, float], list[dict[str, float]]] = defaultdict(list)
    newer = read(AGAIN)
    again = {(run.kelvin, run.method, run.interval) for run in newer}
    for run, means in {**read(RECORD), **newer, **read(LARGER)}.items():
        method = run.method if run.molecules == MOLECULES else f"{run.method}, {run.molecules}"
        point = run.kelvin, method, run.interval
        if (run.model, run.ensemble) != ("tip4p2005", "NPT") or run.friction not in (FRICTION, 1.0):
            continue
        if run in newer or point not in again:
            groups[point].append({"density": means["density"], "enthalpy": enthalpy(means)})
    return {
        point: {name: mean_and_error(np.array([run[name] for run in runs])) for name in QUANTITIES}
        for point, runs in groups.items()
        if len(runs) > 1
    }


def corrected(name: str, method: str | None = None) -> tuple[float, float]:
    """Return density or enthalpy at 298.15 K, corrected for the step: of a method at 4 fs, or of all up to 4 fs."""
    mean, error = corrected_water.at_small_steps("tip4p2005", "NPT", name, method) or (math.nan, math.nan)
    return mean + 3.0 * R * KELVIN * (name == "enthalpy"), error


def tip4p2005() -> str:
    """Return densities, and enthalpies of three integrators at 298.15 K, as a table of a page."""
    found, body = measured(), []
    for name, (label, digits) in QUANTITIES.items():
        reference = with_error(*corrected(name), digits)
        body.append([f"**{label}**, corrected mean of all", reference, *[""] * (len(SHOWN) - 1)])
        rows = product((KELVIN, 277.15), ROWS) if name == "density" else ((KELVIN, method) for method in LINES)
        for kelvin, method in rows:
            cells = [_cell(found, (kelvin, method, fs), name, digits) for fs in SHOWN]
            if any(cells):
                body.append([ROWS[method] + f", {kelvin:g} K" * (kelvin != KELVIN), *cells])
    return table((f"{KELVIN:g} K, 1 bar", *(f"{fs:g} fs" for fs in SHOWN)), body)


def _cell(found: Found, point: tuple[float, str, float], name: str, digits: int) -> str:
    return with_error(*found[point][name], digits) if point in found else ""


def draw() -> None:
    """Draw density and enthalpy at 298.15 K against the time per force evaluation."""
    found = measured()
    figure, panels = plt.subplots(2, figsize=(5.6, 6.2), sharex=True, layout="constrained")
    for axes, (name, (label, _)) in zip(panels, QUANTITIES.items(), strict=True):
        mean, error = corrected(name)
        axes.axhspan(mean - error, mean + error, color="0.8", lw=0.0, label="all averages, corrected for the step")
        for shift, (method, (colour, marker)) in enumerate(LINES.items()):
            x, y, errors = np.array([(fs, *found[KELVIN, method, fs][name]) for fs in STEPS]).T
            text = ROWS[method].replace("`", "")
            axes.errorbar(
                x * 1.02 ** (shift - 1), y, errors, color=colour, marker=marker, capsize=3, lw=1.2, label=text
            )
        one = corrected(name, corrected_water.AT_END)
        axes.errorbar(4.3, *one, color=LINES["W2_3m"][0], marker="D", mfc="white", capsize=3, label="W2_3m, corrected")
        axes.set_ylabel(label.replace(" (kJ", "\n(kJ"))
    panels[0].set_title("216 TIP4P/2005 at 298 K and 1 bar, 1 ns each", fontsize=11)
    panels[1].set_xscale("log", base=2)
    panels[1].set_xticks(STEPS)
    panels[1].xaxis.set_major_formatter("{x:g}")
    panels[1].set_xlabel("time per force evaluation (fs)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)
    figure.savefig(PICTURES / "tip4p2005.png", dpi=150)


if __name__ == "__main__":
    draw()
    print(tip4p2005())
